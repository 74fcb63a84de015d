"""Faults of a wire and their effect on its messages."""

import json

import pytest

from softarm.drivers.regulator.cobs import Deframer, frame
from softarm.drivers.regulator.teensy import RegulatorState, decode, encode
from validation.matrix.wires import CLOCK_JUMP_S, SLOW_S, Fault, MocapWire, RegulatorWire, Wire


class Bare(Wire):
    def hang_up(self) -> None:
        pass


@pytest.mark.parametrize(
    ("fault", "out"),
    [
        (Fault.TIME_OUT, b""),
        (Fault.HALF_FRAME, b"ab"),
        (Fault.REPLAY, b"before"),
        (Fault.SLOW, b"abcd"),
        (Fault.CLOCK_JUMP, b"abcd"),  # this wire carries no clock
    ],
)
def test_a_fault_changes_messages_in_its_direction_only(fault, out):
    wire = Bare(0)
    assert wire.through(b"before", "read") == b"before"
    wire.spoil(fault, "read")
    assert wire.through(b"abcd", "read") == out
    assert wire.through(b"abcd", "write") == b"abcd"
    assert wire.delay_s("read") == (SLOW_S if fault is Fault.SLOW else 0.0)
    wire.mend()
    assert wire.through(b"abcd", "read") == b"abcd"


def test_garbage_has_the_length_and_nothing_else():
    wire = Bare(0)
    wire.spoil(Fault.GARBAGE, "read")
    out = wire.through(bytes(100), "read")
    assert len(out) == 100
    assert out != bytes(100)


def test_a_clock_that_jumps_leaves_the_frame_good(tmp_path):
    regulator = RegulatorWire(0, tmp_path / "a", tmp_path / "b")
    state = RegulatorState(3, True, 0, 5.0)
    jumped = regulator.jumped(frame(encode(state, 9, 1_000)))
    (body,) = Deframer().feed(jumped)
    assert decode(body) == (state, 9)
    assert int.from_bytes(body[6:10], "little") == 1_000 + CLOCK_JUMP_S * 1e6
    camera = MocapWire(0, "key", "tcp/127.0.0.1:1", "tcp/127.0.0.1:2", lambda state: None)
    assert json.loads(camera.jumped(b'{"t_capture_ns": 5}')) == {"t_capture_ns": 5 + CLOCK_JUMP_S * 1e9}
