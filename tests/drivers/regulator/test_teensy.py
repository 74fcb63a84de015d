"""Messages on the serial line: they survive encoding, and nothing else is accepted."""

import contextlib
import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from softarm.drivers.regulator.teensy import (
    Fault,
    Hello,
    RegulatorCommand,
    RegulatorState,
    Welcome,
    decode,
    encode,
    is_newer,
)

u32 = st.integers(0, 2**32 - 1)
f32 = st.floats(width=32, allow_nan=False, allow_infinity=False)
messages = st.one_of(
    st.just(Hello()),
    st.builds(Welcome, u32),
    st.builds(RegulatorCommand, u32, st.integers(0, 65535).map(lambda ms: ms / 1000), st.booleans(), f32),
    st.builds(RegulatorState, u32, st.booleans(), st.integers(0, 65535).map(Fault), f32),
)


@given(messages, u32, st.integers(0, 2**64))
def test_a_message_survives_encoding(message: object, sequence: int, time_us: int) -> None:
    assert decode(encode(message, sequence, time_us)) == (message, sequence)  # type: ignore[arg-type]


@pytest.mark.parametrize(("flags", "armed"), [(0x00, False), (0x01, True), (0xFE, False), (0xFF, True)])
def test_the_lowest_flag_arms_and_the_others_are_ignored(flags: int, armed: bool) -> None:
    command = encode(RegulatorCommand(1, 0.1, True, 1.0), 1, 1)
    assert decode(command[:16] + bytes([flags]) + command[17:])[0] == RegulatorCommand(1, 0.1, armed, 1.0)
    state = encode(RegulatorState(1, True, Fault(0), 1.0), 1, 1)
    assert decode(state[:14] + bytes([flags]) + state[15:])[0] == RegulatorState(1, armed, Fault(0), 1.0)


@given(st.binary(max_size=40))
def test_noise_is_a_message_or_a_value_error(body: bytes) -> None:
    with contextlib.suppress(ValueError):
        assert isinstance(decode(body)[0], Hello | Welcome | RegulatorCommand | RegulatorState)


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (b"\1\2\3", "3 bytes"),
        (b"\2" + encode(Hello(), 1, 1)[1:], "protocol version 2.*update the older side"),
        (encode(RegulatorCommand(1, 0.1, True, 1.0), 1, 1)[:-1], "type 0x02 with 10 bytes of payload: .* 11 bytes"),
        (encode(Hello(), 1, 1) + b"x", "type 0x01 with 1 bytes"),
        (b"\1\x77" + bytes(8), "type 0x77"),
        (encode(RegulatorState(1, True, Fault(0), 0.0), 1, 1)[:-4] + struct.pack("<f", math.nan), "pressure of nan"),
    ],
)
def test_an_error_states_the_cause(body: bytes, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        decode(body)


def test_every_fault_has_a_sentence() -> None:
    assert Fault(0).sentences() == ()
    assert not [sentence for fault in Fault for sentence in fault.sentences() if "unknown" in sentence]


def test_an_unknown_fault_bit_is_reported_with_its_number() -> None:
    body = encode(RegulatorState(1, True, Fault(0), 1.0), 1, 1)
    body = body[:15] + (1 << 2 | 1 << 15 | 1 << 9).to_bytes(2, "little") + body[17:]
    state, _ = decode(body)
    assert isinstance(state, RegulatorState)
    known, ninth, fifteenth = state.faults.sentences()
    assert known == "the command was out of range (allowed: -0.7 to 20.0 kPa, time to live up to 0.25 s)"
    assert "unknown fault bit 9" in ninth
    assert "unknown fault bit 15" in fifteenth
    assert len(Fault(0xFFFF).sentences()) == 16


@pytest.mark.parametrize(
    ("sequence", "than", "newer"),
    [
        (1, 0, True),
        (0, 0, False),
        (0, 1, False),
        (0, 2**32 - 1, True),
        (2**32 - 1, 0, False),
        (2**31, 0, False),
        (2**31 - 1, 0, True),
    ],
)
def test_a_counter_that_wraps_still_advances(sequence: int, than: int, newer: bool) -> None:
    assert is_newer(sequence, than) is newer
