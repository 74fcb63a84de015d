"""Tests of `softarm rail`."""

import fcntl
import math
import os
import signal
import socket
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from click.testing import Result

from softarm.daemon.api.status import Ages
from softarm.daemon.control.records import ActiveEvent, Mode, Observed
from softarm.drivers.rail.cia402 import DriveState
from softarm.drivers.rail.commissioning import session
from softarm.drivers.rail.settings import Settings
from softarm.schemas.policy import Observation
from tests.cli.invoke import invoke, refuse, succeed
from tests.drivers.rail.commissioning.conftest import TwinWorld
from tests.processes import free_port


class Bench(TwinWorld):
    """The twin's drive on a TCP port, a cart that moves during pauses, and their configuration."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.api_port = free_port()
        self.file = folder / "arm.yaml"
        self.folder = folder
        self.on_the_way: Any = lambda: None
        self.hand: Any = None  # where the cart is pushed to, by the time
        self.drive.power_cycle()

    def push(self, reach_m: float = 0.3) -> None:
        """Push the cart of a homed axis from end to end repeatedly."""
        self.drive.reference.homed, self.drive.reference.offset_m = True, -0.013
        self.drive.sense(0.0, 0.0)
        self.hand = lambda now_s: reach_m * max(-1.0, min(1.0, 1.2 * math.sin(now_s)))

    def configure(self) -> None:
        self.file.write_text(
            f"# my arm\ndrivers:\n  rail:\n    host: 127.0.0.1\n    port: {self.server.port}\n    timeout_s: 0.14\n"
            f"recorder:\n  directory: {self.folder}\napi:\n  port: {self.api_port}\n"
        )

    def move(self, seconds: float) -> None:
        if self.hand is not None:
            self.put(self.hand(self.now_ns * 1e-9))
        else:
            super().move(seconds)
        if self.drive.reference.searching:
            self.on_the_way()

    def softarm(self, verb: str, *words: str) -> Result:
        return succeed("rail", verb, "--config", self.file, *words)

    def refuses(self, message: str, verb: str, *words: str, **how: Any) -> Result:
        return refuse(message, "rail", verb, "--config", self.file, *words, **how)


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, served: Any) -> Iterator[Bench]:
    bench = Bench(tmp_path)
    with served(bench.server):
        bench.configure()
        original = session.DriveSession

        def timed(settings: Settings, **how: Any) -> session.DriveSession:
            # The drive answers by a thread of this process, which a loaded computer may delay by more than 0.14 s.
            slow = settings._replace(timeout_s=20.0)
            return original(slow, clock=bench.clock, pause=lambda seconds: bench.pause(seconds), **how)

        monkeypatch.setattr(session, "DriveSession", timed)
        yield bench


def test_home_prints_the_motion_homes_and_disables_the_drive(bench: Bench) -> None:
    answer = bench.softarm("home", "--yes")
    assert (
        f"The robot of {bench.file} will move: the cart, by the drive at 127.0.0.1:{bench.server.port}, anywhere "
        "between the ends of its 0.6 m of travel, at 0.05 m/s and back at 0.01 m/s, by the drive's homing method 17 "
        "(to the negative limit switch)." in answer.output
    )
    assert "says that it is not homed" in answer.output
    assert "homed (the drive says so), and the drive is off: the axis reads 0.015" in answer.output
    assert "push the cart to the middle by hand" in answer.output
    assert f"next: `softarm rail centre --config {bench.file}`" in answer.output
    assert bench.drive.state is DriveState.READY
    assert not list(bench.folder.glob("stop-*"))


def test_nothing_moves_without_confirmation_in_a_terminal(bench: Bench) -> None:
    bench.refuses("no terminal can confirm: use --yes", "home", input="y\n")
    assert bench.position_m == 0.0
    assert bench.drive.state is DriveState.SWITCH_ON_DISABLED


def test_home_is_refused_while_a_daemon_controls_the_robot(bench: Bench) -> None:
    latch = bench.folder / f"stop-127.0.0.1-{bench.server.port}.json"
    with latch.open("wb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        answer = bench.refuses("the drive has one master at a time", "home", "--yes")
    assert "another daemon controls this robot; stop it" in answer.output
    assert bench.server._master is None


def test_home_is_refused_while_another_program_is_connected(bench: Bench) -> None:
    with socket.create_connection(("127.0.0.1", bench.server.port)):
        bench.refuses("is in use by another program", "home", "--yes")
    assert not list(bench.folder.glob("stop-*"))
    assert bench.position_m == 0.0


@pytest.mark.parametrize(
    ("before", "message"),
    [
        (lambda b: b.drive.trip(0x8611), "the drive reports E11 following error (0x8611); remove the cause, then use"),
        (lambda b: setattr(b.drive, "remote", False), "DI7 is low; release the hardware e-stop, or use --relay"),
        (
            lambda b: setattr(b.drive, "state", DriveState.OPERATION_ENABLED),
            "was in operation and has been switched off",
        ),
        (lambda b: b.drive._values.update({session.dryve.HOMING_METHOD: 0}), "no homing method is set (6098h is 0)"),
    ],
)
def test_a_reason_against_homing_is_reported_before_any_motion(bench: Bench, before: Any, message: str) -> None:
    before(bench)
    answer = bench.refuses(message, "home", "--yes")
    assert "will move" not in answer.output
    assert bench.position_m == 0.0


def test_the_reset_fault_option_clears_a_fault_before_homing(bench: Bench) -> None:
    bench.drive.trip(0x8611)
    bench.softarm("home", "--yes", "--reset-fault")


@pytest.mark.parametrize(
    ("number", "message", "code"),
    [
        (signal.SIGINT, "the cart was braked and the drive is off; the search was NOT finished", 130),
        (signal.SIGTERM, "a person interrupted it", 1),
        (signal.SIGHUP, "a person interrupted it", 1),
    ],
)
def test_ctrl_c_and_a_closed_terminal_brake(bench: Bench, number: signal.Signals, message: str, code: int) -> None:
    def interrupt() -> None:
        if bench.position_m < -0.01:
            os.kill(os.getpid(), number)

    bench.on_the_way, before = interrupt, signal.getsignal(number)
    bench.refuses(message, "home", "--yes", code=code)
    assert bench.drive.state is DriveState.READY
    assert bench.position_m > -0.02
    assert signal.getsignal(number) is before


def test_with_a_relay_homing_waits_for_di7(bench: Bench) -> None:
    bench.drive.remote = False
    begun_ns = bench.now_ns
    hand = bench.pause

    def closes(seconds: float) -> None:
        hand(seconds)
        bench.drive.remote = bench.now_ns - begun_ns > 1.2e9

    bench.pause = closes  # type: ignore[method-assign]
    bench.softarm("home", "--yes", "--relay")
    bench.pause, bench.drive.remote = hand, False  # type: ignore[method-assign]
    bench.refuses("or check the connection of the board (docs/hardware/firmware.md)", "home", "--yes", "--relay")


# The middle


def test_centre_measures_the_middle_and_writes_it_on_request(bench: Bench) -> None:
    bench.push()
    before = bench.file.read_text()
    answer = bench.softarm("centre", "--seconds", "8")
    assert "Push the cart by hand, slowly" in answer.output
    assert "travel 0.600 m, from -0.0130 to 0.5870 m on the axis" in answer.output
    assert "drivers.rail.centre_m: 0.287  (is 0.3)" in answer.output
    assert "nothing was written" in answer.output
    assert bench.file.read_text() == before
    assert bench.drive.state is DriveState.SWITCH_ON_DISABLED
    bench.softarm("centre", "--seconds", "8", "--write")
    assert bench.file.read_text() == before.replace("  rail:\n", "  rail:\n    centre_m: 0.287\n")
    answer = bench.softarm("centre", "--seconds", "8", "--write")
    assert "drivers.rail is correct and was not changed" in answer.output


def test_an_implausible_push_writes_nothing(bench: Bench) -> None:
    bench.push(reach_m=0.2)
    before = bench.file.read_text()
    answer = bench.refuses("push the cart until it stops, at both ends", "centre", "--seconds", "8", "--write")
    assert "nothing was written" in answer.output
    assert bench.file.read_text() == before


def test_centre_requires_a_homed_axis(bench: Bench) -> None:
    bench.refuses("`softarm rail home` first", "centre", "--seconds", "5")


def test_without_a_terminal_centre_needs_a_duration(bench: Bench) -> None:
    bench.push()
    bench.refuses("with --seconds", "centre")


class Seen:
    """Statuses of a daemon while a person pushes the cart; axis and motion capture may disagree."""

    def __init__(self, sense: int = 1, **changes: Any) -> None:
        self.calls, self.sense, self.changes = 0, sense, changes

    def __call__(self, status: Any) -> Any:
        self.calls += 1
        y_m = -0.3 * math.cos(0.2 * self.calls)
        values = Observation(y_m, 0.0, y_m, 0.52, 0.0, 0.0, 0.0, 0.0)
        moment = {
            "mode": Mode.DISARMED,
            "uptime_s": -10.0,
            "rail_position_m": self.sense * y_m + 0.287 - 0.3,
            "rail_velocity_m_s": 0.0,
            "observed": Observed(values, self.calls, 0, 0, 0),
            "ages_ms": Ages(8.0, 8.0, 8.0),
        }
        return status(**moment | self.changes)


@pytest.fixture
def asked(bench: Bench, daemon: Any, make_status: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return a function that runs `softarm rail centre` with a daemon in the bench's time."""
    own = SimpleNamespace(sleep=bench.pause, monotonic_ns=bench.clock, time=time.time)
    monkeypatch.setattr("softarm.cli.rail.time", own)

    def ask(seen: Seen, *words: str, simulated: bool = False) -> Result:
        daemon.answers["GET", "/api/robot"] = deque([(200, {"simulated": simulated})])
        daemon.answers["GET", "/api/status"] = deque((200, seen(make_status)) for _ in range(200))
        return invoke("rail", "centre", "--config", bench.file, "--seconds", 4, "--url", daemon.url, *words)

    return ask


def test_with_a_daemon_centre_also_compares_motion_capture(bench: Bench, asked: Any) -> None:
    before = bench.file.read_text()
    answer = asked(Seen(sense=-1), "--write")
    assert answer.exit_code == 0, answer.output
    assert "the axis counts AGAINST motion capture, 1.0000 m by motion capture for each metre" in answer.output
    assert bench.file.read_text() == before.replace("  rail:\n", "  rail:\n    reversed: true\n    centre_m: 0.287\n")
    assert bench.server._master is None  # the drive is its daemon's


@pytest.mark.parametrize(
    ("seen", "message"),
    [
        (Seen(mode=Mode.ARMED), "the arm is armed: `softarm disarm --url http://127.0.0.1:"),
        (Seen(events=(ActiveEvent("rail_not_homed", "soft_stop", "no"),)), "`softarm rail home`"),
        (Seen(uptime_s=1e6), "has changed since the daemon started"),
        (Seen(ages_ms=Ages(500.0, 8.0, 8.0), rail_position_m=0.1), "push the cart slowly from end to end"),
    ],
)
def test_centre_is_refused_in_an_unsuitable_state_of_the_daemon(asked: Any, seen: Seen, message: str) -> None:
    answer = asked(seen, "--write")
    assert answer.exit_code == 1
    assert message in answer.output


def test_a_daemon_with_a_simulated_robot_is_not_used(bench: Bench, asked: Any) -> None:
    bench.push()
    answer = asked(Seen(), simulated=True)
    assert f"drive at 127.0.0.1:{bench.server.port}" in answer.output
