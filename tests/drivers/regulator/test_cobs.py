"""Framing on the serial line: as in the standard, and robust against noise."""

import random

import pytest
from cobs import cobs as oracle
from hypothesis import example, given
from hypothesis import strategies as st

from softarm.drivers.regulator.cobs import DELIMITER, FRAME_MAX_BYTES, Deframer, frame, stuff, unstuff


@given(st.binary(max_size=700) | st.integers(250, 260).map(lambda n: b"\1" * n + b"\0" + b"\2" * n))
def test_agrees_with_the_cobs_package_and_holds_no_zero(data: bytes) -> None:
    assert stuff(data) == oracle.encode(data)
    assert 0 not in stuff(data)
    assert unstuff(stuff(data)) == data


@given(st.binary(max_size=60))
@example(b"\x03\x01\x00")  # a zero within a run
@example(b"\x01\x00\x01")
def test_rejects_the_blocks_that_the_cobs_package_rejects(block: bytes) -> None:
    try:
        expected = oracle.decode(block) if block else None
    except oracle.DecodeError:
        expected = None
    if expected is None:
        with pytest.raises(ValueError, match="COBS"):
            unstuff(block)
    else:
        assert unstuff(block) == expected


@given(st.lists(st.binary(min_size=1, max_size=40), max_size=8), st.data())
def test_frames_survive_any_splitting_of_the_stream(bodies: list[bytes], data: st.DataObject) -> None:
    stream = b"".join(map(frame, bodies))
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=10)))
    deframer = Deframer()
    pieces = [stream[a:b] for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True)]
    assert [body for piece in pieces for body in deframer.feed(piece)] == bodies
    assert deframer.dropped == 0


@pytest.mark.parametrize(
    ("line", "bodies", "dropped"),
    [
        (b"\x07noise without end\0" + frame(b"hello"), [b"hello"], 1),
        (b"\0\0" + frame(b"hello") + b"\0" + frame(b"again"), [b"hello", b"again"], 0),
        (frame(b""), [], 1),
    ],
    ids=["noise", "zeros", "an empty frame"],
)
def test_noise_is_dropped_and_zeros_between_frames_are_ignored(line: bytes, bodies: list[bytes], dropped: int) -> None:
    deframer = Deframer()
    assert deframer.feed(line) == bodies
    assert deframer.dropped == dropped


def test_noise_without_a_zero_does_not_accumulate() -> None:
    deframer = Deframer()
    for _ in range(100):
        assert deframer.feed(b"\x55" * FRAME_MAX_BYTES) == []
        assert len(deframer._pending) <= FRAME_MAX_BYTES
    assert deframer.dropped == 1
    assert deframer.feed(b"\0" + frame(b"hello")) == [b"hello"]
    assert deframer.dropped == 1


@pytest.mark.parametrize("cut", [0, 1, FRAME_MAX_BYTES, FRAME_MAX_BYTES + 1, 2 * FRAME_MAX_BYTES, -12, -1])
def test_after_too_much_noise_the_next_zero_starts_a_frame(cut: int) -> None:
    line = b"\x55" * 2 * FRAME_MAX_BYTES + frame(b"unheard") + frame(b"hello")
    deframer = Deframer()
    assert [*deframer.feed(line[:cut]), *deframer.feed(line[cut:])] == [b"hello"]
    assert deframer.dropped == 1
    for _ in range(2):
        assert deframer.feed(b"\x07" * 300) == []
    assert deframer.feed(frame(b"unheard") + frame(b"hello")) == [b"hello"]
    assert deframer.dropped == 2


def test_the_longest_frame_passes_whole_or_in_pieces_and_one_byte_more_does_not() -> None:
    longest, too_long = frame(bytes(FRAME_MAX_BYTES - 3)), frame(bytes(FRAME_MAX_BYTES - 2))
    assert len(longest) == FRAME_MAX_BYTES + len(DELIMITER)
    for cut in (1, FRAME_MAX_BYTES, len(longest)):
        deframer = Deframer()
        assert [*deframer.feed(longest[:cut]), *deframer.feed(longest[cut:])] == [bytes(FRAME_MAX_BYTES - 3)]
        assert deframer.dropped == 0
    deframer = Deframer()
    assert deframer.feed(too_long) == []
    assert deframer.dropped == 1


def test_no_flipped_bit_is_accepted() -> None:
    randomness = random.Random(1)
    for _ in range(60):
        body = randomness.randbytes(21)
        good = frame(body)
        for bit in range(8 * (len(good) - 1)):
            bad = bytearray(good)
            bad[bit // 8] ^= 1 << bit % 8
            assert Deframer().feed(bytes(bad)) == []
