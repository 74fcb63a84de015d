"""The relay in the drive's enable input: the daemon arms with it, and it stops the cart when nothing else can.

The daemon's tick, the firmware's core and the twin's drive run in lockstep.
"""

import math
from dataclasses import replace
from typing import Any

import pytest

from softarm.daemon.control.records import EStop, Mode
from softarm.drivers.rail import dryve
from softarm.drivers.rail.cia402 import DriveState, next_controlword
from softarm.drivers.regulator.driver import Conversation, reading_of
from softarm.drivers.twin.dryve import DryveDevice
from softarm.policies.hold import Hold
from softarm.schemas.config import DryveRail, SerialRegulator
from softarm.schemas.messages import RailReading
from tests.daemon.rig import PERIOD_NS, Rig

LOOK_NS = 1_000_000


class Bench:
    """Board and drive, with the relay in the line of DI7; a daemon, and the cable to the drive."""

    def __init__(self, board: Any) -> None:
        self.board = board
        self.drive = DryveDevice(DryveRail())
        self.drive.keeps_going = True
        self.talk = Conversation(SerialRegulator().time_to_live_s)
        self.rig = Rig(Hold())
        self.now_ns = 0
        self.linked, self.button = True, False
        self.pressure: Any = None
        self.rail: RailReading | None = None
        self.outputs: Any = None
        self.drive.sense(0.0, 0.0)
        self._drive_to(dryve.MODE, dryve.PROFILE_VELOCITY)

    def _drive_to(self, entry: dryve.Entry, value: int) -> None:
        self.drive.answer(dryve.encode_request(1, entry, value), self.now_ns)

    def pass_time(self, nanoseconds: int) -> None:
        """Advance board and drive."""
        until_ns = self.now_ns + nanoseconds
        while self.now_ns < until_ns:
            self.now_ns = min(self.now_ns + LOOK_NS, until_ns)
            self.board.watch(self.now_ns)
            self.drive.remote = self.board.relay_closed and not self.button
            self.drive.watch(self.now_ns)

    def tick(self, *kinds: str) -> Any:
        self.pass_time(PERIOD_NS)
        if self.linked:
            self.rail = RailReading(self.now_ns, 0.0, 0.0, self.drive.in_operation, self.drive.remote)
        self.rig.now = self.now_ns - PERIOD_NS
        self.outputs = self.rig.tick(*kinds, pressure=self.pressure, rail=self.rail)
        sent = self.outputs.sent
        line = self.talk.greeting(self.now_ns) or self.talk.command(sent.enable, sent.pressure_kpa, self.now_ns)
        state = self.talk.receive(self.board.receive(line, self.now_ns, 0.0))
        if state is not None:
            self.pressure = reading_of(state, self.now_ns)
        if self.linked:
            self._lead(sent.enable)
        return self.outputs

    def _lead(self, enable: bool) -> None:
        """Lead the drive as its master does: send nothing while DI7 is low."""
        word = next_controlword(self.drive.state, enable, at_rest=True) if self.drive.remote else None
        if word is not None:
            self._drive_to(dryve.CONTROLWORD, word)

    def ticks_for(self, seconds: float) -> None:
        for _ in range(math.ceil(seconds * 30)):
            self.tick()

    def armed(self) -> "Bench":
        self.ticks_for(1.5)
        self.tick("arm")
        assert self.outputs.results[-1].accepted, self.rig.reasons()
        self.ticks_for(0.3)
        assert self.outputs.mode is Mode.ARMED
        assert self.drive.in_operation
        self._drive_to(dryve.TARGET_VELOCITY, 50_000)
        self.drive.sense(0.0, 0.5)
        return self

    def seconds_to_stop(self, at_most_s: float) -> float:
        """Return the time until DI7 makes the drive brake."""
        began_ns = self.now_ns
        while self.drive.in_operation and self.now_ns - began_ns < at_most_s * 1e9:
            self.pass_time(LOOK_NS)
        assert not self.drive.in_operation
        return (self.now_ns - began_ns) * 1e-9


@pytest.fixture
def bench(make_board: Any) -> Bench:
    return Bench(make_board())


def test_a_dead_host_stops_the_drive(bench: Bench) -> None:
    bench.armed()
    assert bench.seconds_to_stop(1.0) <= 0.1 + 1e-9
    bench.drive.sense(0.0, 0.0)
    bench.pass_time(60 * 1_000_000_000)
    assert bench.drive.state is DriveState.SWITCH_ON_DISABLED


def test_an_emergency_stop_reaches_the_drive_without_its_cable(bench: Bench) -> None:
    bench.armed()
    bench.linked = False
    bench.tick("stop")
    assert bench.seconds_to_stop(1.0) <= 2e-3
    bench.drive.sense(0.0, 0.0)
    bench.linked = True
    bench.ticks_for(0.5)
    bench.tick("acknowledge")
    assert "enable input (DI7) is low" in bench.rig.reasons()
    bench.ticks_for(0.7)
    bench.tick("acknowledge")
    assert bench.outputs.estop is EStop.CLEAR
    bench.armed()


def test_a_pulled_cable_stops_the_drive_when_the_daemon_detects_it(bench: Bench) -> None:
    bench.armed()
    assert bench.rail is not None
    bench.linked, bench.rail = False, replace(bench.rail, velocity_m_s=0.5)
    began_ns = bench.now_ns
    while bench.drive.in_operation:
        bench.tick()
        assert bench.now_ns - began_ns < 1e9
    # Known when the reading is 0.15 s old; then a tick for the soft stop, one for its end, and one is under way.
    assert bench.now_ns - began_ns <= 150e6 + 3 * PERIOD_NS
    assert "the axis reading is too old" in bench.outputs.last_stop
    bench.drive.sense(0.0, 0.0)
    bench.linked = True
    bench.ticks_for(1.2)
    bench.armed()


def test_arming_within_the_second_is_refused_with_the_reason(bench: Bench) -> None:
    bench.armed()
    bench._drive_to(dryve.TARGET_VELOCITY, 0)
    bench.drive.sense(0.0, 0.0)
    bench.tick("disarm")
    while bench.outputs.mode is not Mode.DISARMED:
        bench.tick()
    bench.tick("arm")
    assert "enable input (DI7) is low" in bench.rig.reasons()
    assert bench.outputs.estop is EStop.CLEAR
    bench.armed()


def test_the_emergency_stop_button_is_in_the_same_line(bench: Bench) -> None:
    bench.armed()
    bench.button = True
    assert bench.seconds_to_stop(1.0) <= 1e-3
    bench.tick()
    assert bench.outputs.mode is Mode.STOPPED
