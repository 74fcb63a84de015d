"""Three implementations of one page (firmware, twin, independent robot) must answer the same line equally."""

import itertools
import math
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from softarm.drivers.regulator.cobs import frame
from softarm.drivers.twin.teensy import TeensyDevice
from validation.outside import regulator as outside

BELOW, ABOVE = (float(np.nextafter(np.float32(edge), np.float32(way))) for edge, way in ((-0.7, -9), (20, 99)))
KPA = st.sampled_from([0.0, -0.0, 5.0, 12.5, -0.7, 20.0, BELOW, ABOVE, math.nan, math.inf, -math.inf, 1e-42])
LIVE_MS = st.sampled_from([1, 57, 100, 100, 100, 250, 0, 251, 300, 65535])
AHEAD = st.sampled_from([1, 1, 1, 1, 2, 0, -1, 2**31 - 1, 2**31, -(2**31) + 1])
WAIT_US = st.one_of(
    st.sampled_from([0, 1, 999, 1000, 1001, 33_333, 56_999, 57_000, 99_999, 100_000, 100_001, 249_999, 250_000]),
    st.integers(0, 300_000),
)
COMMAND = st.tuples(st.just("command"), AHEAD, st.sampled_from([0, 0, 0, 0, 1]), LIVE_MS, st.integers(0, 255), KPA)
LENGTH = st.one_of(st.sampled_from([10, 21]), st.integers(0, 40))
STEP = st.one_of(
    st.tuples(st.just("wait"), WAIT_US),
    st.tuples(st.just("hello"), AHEAD),
    COMMAND,
    COMMAND.map(lambda command: (*command[:2], 0, 100, command[4], 5.0)),
    st.tuples(st.just("noise"), st.binary(max_size=30)),
    st.tuples(st.just("long"), st.integers(1, 600), st.booleans()),
    st.tuples(st.just("body"), st.sampled_from([1, 1, 0, 2, 255]), st.sampled_from([1, 2, 3, 0x81, 0x82]), LENGTH),
)


class Three:
    """The devices on one clock, and the knowledge of a host."""

    def __init__(self, make_board: Callable[..., Any], now_us: int, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_us = now_us
        self.sequence, self.token = 0, 0
        self.board = make_board(self._source())
        self.twin = TeensyDevice(self._source())
        self.outside = outside.Firmware()
        draw = self._source()
        monkeypatch.setattr(outside.os, "urandom", lambda _: draw().to_bytes(4, "little"))
        self._pending = b""
        self.watch()

    def _source(self) -> Callable[[], int]:
        """Return the source of a device's tokens, which are the same for all devices."""
        count = itertools.count(1)

        def draw() -> int:
            self.token = next(count) * 0x9E3779B1 % 2**32
            return self.token

        return draw

    def say(self, step: tuple[Any, ...]) -> None:
        """Put the bytes of a step on the line; they are received when time passes or `receive_all` is called."""
        kind, *rest = step
        if kind == "noise":
            self._pending += rest[0]
        elif kind == "long":
            self._pending += b"\x07" * rest[0] + (b"\0" if rest[1] else b"")
        elif kind == "body":
            version, of, length = rest
            self._pending += frame((bytes((version, of)) + bytes(40))[: max(1, length)])
        else:
            self.sequence = (self.sequence + rest[0]) % 2**32
            if kind == "hello":
                self._pending += frame(struct.pack("<BBII", 1, 1, self.sequence, 0))
            else:
                _, wrong, live_ms, flags, kpa = rest
                fields = (self.token ^ wrong, live_ms, flags, kpa)
                self._pending += frame(struct.pack("<BBIIIHBf", 1, 2, self.sequence, 0, *fields))

    def receive_all(self, cut: int = 0) -> None:
        """Deliver the bytes on the line in two pieces."""
        data, self._pending = self._pending, b""
        for piece in (data[:cut], data[cut:]):
            now_ns = self.now_us * 1000
            answers = [
                self.board.receive(piece, now_ns, 3.25),
                self.twin.receive(piece, now_ns, 3.25),
                self.outside.receive(piece, self.now_us, 3.25),
            ]
            assert answers[0].hex() == answers[1].hex() == answers[2].hex()
            self.watch()

    def watch(self) -> None:
        """Advance the devices and compare their outputs."""
        self.board.watch(self.now_us * 1000)
        self.twin.watch(self.now_us * 1000)
        self.outside.run(self.now_us)
        assert self.board.armed == self.twin.armed == self.outside.armed
        assert self.board.set_point_kpa == self.twin.set_point_kpa == self.outside.set_kpa
        assert self.board.faults == self.twin.faults == self.outside._faults
        assert self.board.accepted_sequence == self.twin.accepted_sequence == self.outside._accepted


RANGE_ENDS = [
    *(("command", 1, 0, 100, armed, kpa) for armed in (0, 1) for kpa in (-0.7, 20.0, BELOW, ABOVE)),
    *(("command", 1, 0, live_ms, armed, 5.0) for armed in (0, 1) for live_ms in (0, 1, 250, 251)),
]


@pytest.mark.slow
@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    script=st.lists(st.tuples(STEP, st.integers(0, 60)), min_size=5, max_size=60),
    start_us=st.sampled_from([0, 2**31 - 150_000, 2**32 - 1, 2**32 - 150_000, 5 * 2**32 - 40_000]),
    first=st.sampled_from([1, 2**31 - 3, 2**32 - 3]),
)
@example(script=[(step, 1) for step in RANGE_ENDS], start_us=0, first=1)
def test_three_devices_act_and_answer_equally(
    make_board: Any, monkeypatch: pytest.MonkeyPatch, script: Any, start_us: int, first: int
) -> None:
    three = Three(make_board, start_us, monkeypatch)
    for step in (("hello", first), ("command", 1, 0, 100, 0, 0.0), ("command", 1, 0, 100, 1, 5.0)):
        three.say(step)
        three.receive_all()
    assert three.board.armed
    for step, cut in script:
        if step[0] == "wait":
            three.receive_all(cut)
            three.now_us += step[1]
            three.watch()
        else:
            three.say(step)
            if cut % 3:
                three.receive_all(cut)
    three.receive_all()
