"""`softarm rail`: what it refuses, what it says before anything moves, and what is left."""

import asyncio
import fcntl
import functools
import os
import signal
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from softarm.cli.main import main
from softarm.drivers.rail.cia402 import DriveState
from softarm.drivers.rail.commissioning import visit
from softarm.drivers.twin.dryve import DryveDevice, DryveServer
from softarm.drivers.twin.faults import Faults
from softarm.schemas.config import DryveRail


class Bench:
    """The twin's drive on a TCP port, a cart that moves while the visitor waits, and a configuration of both."""

    def __init__(self, folder: Path) -> None:
        self.now_ns = 1_000_000_000
        self.drive = DryveDevice(DryveRail())
        self.server = DryveServer("127.0.0.1", 0, self.drive, Faults(self.clock), self.clock)
        self.position_m = 0.0
        self.file = folder / "arm.yaml"
        self.folder = folder
        self.on_the_way: Any = lambda: None
        self.drive.power_cycle()

    def clock(self) -> int:
        return self.now_ns

    def configure(self) -> None:
        self.file.write_text(
            f"# my arm\ndrivers:\n  rail:\n    host: 127.0.0.1\n    port: {self.server.port}\n    timeout_s: 0.14\n"
            f"recorder:\n  directory: {self.folder}\n"
        )

    def pause(self, seconds: float) -> None:
        self.now_ns += round(seconds * 1e9)
        speed_m_s = self.drive.target_velocity_m_s
        self.position_m += speed_m_s * seconds
        self.drive.sense(self.position_m, speed_m_s)
        if self.drive.reference.searching:
            self.on_the_way()

    def softarm(self, *words: str, **how: Any) -> Result:
        return CliRunner().invoke(main, ["rail", words[0], "--config", str(self.file), *words[1:]], **how)


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    bench, ready, ended = Bench(tmp_path), threading.Event(), asyncio.Event()
    loop = asyncio.new_event_loop()

    async def serve() -> None:
        await bench.server.open()
        ready.set()
        await ended.wait()
        await bench.server.close()

    thread = threading.Thread(target=lambda: loop.run_until_complete(serve()), daemon=True)
    thread.start()
    assert ready.wait(20)
    bench.configure()
    monkeypatch.setattr(visit, "Visit", functools.partial(visit.Visit, clock=bench.clock, pause=bench.pause))
    yield bench
    loop.call_soon_threadsafe(ended.set)
    thread.join(20)
    loop.close()


def test_it_says_what_moves_then_homes_and_leaves_the_drive_off(bench: Bench) -> None:
    answer = bench.softarm("home", "--yes")
    assert answer.exit_code == 0, answer.output
    assert (
        f"The robot of {bench.file} will move: the cart, by the drive at 127.0.0.1:{bench.server.port}, anywhere "
        "between the ends of its 0.6 m of travel, at 0.05 m/s and back at 0.01 m/s, by the drive's homing method 17 "
        "(to the negative limit switch)." in answer.output
    )
    assert "says that it is not homed" in answer.output
    assert "homed (the drive says so), and the drive is off: the axis reads 0.015" in answer.output
    assert "push the cart to the middle by hand" in answer.output
    assert f"next: `softarm run --config {bench.file}`" in answer.output
    assert bench.drive.state is DriveState.READY
    assert not list(bench.folder.glob("stop-*"))


@pytest.mark.parametrize(
    ("how", "says"), [({}, "nobody can be asked: give --yes"), ({"input": "y\n"}, "nobody can be asked: give --yes")]
)
def test_nothing_moves_where_nobody_was_asked(bench: Bench, how: dict[str, str], says: str) -> None:
    answer = bench.softarm("home", **how)
    assert answer.exit_code == 1
    assert says in answer.output
    assert bench.position_m == 0.0
    assert bench.drive.state is DriveState.SWITCH_ON_DISABLED


def test_a_daemon_of_this_robot_keeps_it_out(bench: Bench) -> None:
    latch = bench.folder / f"stop-127.0.0.1-{bench.server.port}.json"
    with latch.open("wb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        answer = bench.softarm("home", "--yes")
    assert answer.exit_code == 1
    assert "the drive has one master at a time" in answer.output
    assert "another daemon has this robot; stop that one" in answer.output
    assert bench.server._master is None


def test_any_other_program_that_is_connected_keeps_it_out(bench: Bench) -> None:
    with socket.create_connection(("127.0.0.1", bench.server.port)):
        answer = bench.softarm("home", "--yes")
    assert answer.exit_code == 1
    assert "is held by another program of this computer" in answer.output
    assert not list(bench.folder.glob("stop-*"))
    assert bench.position_m == 0.0


@pytest.mark.parametrize(
    ("before", "says"),
    [
        (lambda b: b.drive.trip(0x8611), "the drive reports E11 following error (0x8611); see to its cause, then give"),
        (lambda b: setattr(b.drive, "remote", False), "DI7 is low; release the hardware e-stop"),
        (lambda b: setattr(b.drive, "state", DriveState.OPERATION_ENABLED), "was in operation, and was switched off"),
        (lambda b: b.drive._values.update({visit.dryve.HOMING_METHOD: 0}), "no homing method is set (6098h is 0)"),
    ],
)
def test_what_stands_against_it_is_said_before_anything_moves(bench: Bench, before: Any, says: str) -> None:
    before(bench)
    answer = bench.softarm("home", "--yes")
    assert answer.exit_code == 1
    assert says in answer.output
    assert "will move" not in answer.output
    assert bench.position_m == 0.0


def test_a_fault_that_was_seen_to_is_reset_and_then_it_homes(bench: Bench) -> None:
    bench.drive.trip(0x8611)
    assert bench.softarm("home", "--yes", "--reset-fault").exit_code == 0


def test_ctrl_c_says_what_it_leaves(bench: Bench) -> None:
    def interrupt() -> None:
        if bench.position_m < -0.01:
            os.kill(os.getpid(), signal.SIGINT)

    bench.on_the_way = interrupt
    answer = bench.softarm("home", "--yes")
    assert answer.exit_code == 130
    assert "the cart was braked, the drive is off and NOT homed" in answer.output
    assert bench.drive.state is DriveState.READY
    assert bench.position_m > -0.02
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_fault_on_the_way_is_a_sentence(bench: Bench) -> None:
    bench.on_the_way = lambda: bench.position_m < -0.01 and bench.drive.trip(0x8611)
    answer = bench.softarm("home", "--yes")
    assert answer.exit_code == 1
    assert "home: the drive reports E11 following error (0x8611)" in answer.output


@pytest.mark.parametrize("speed", ["0.5", "0", "nan"])
def test_a_speed_out_of_range_is_refused(bench: Bench, speed: str) -> None:
    answer = bench.softarm("home", "--yes", "--speed", speed)
    assert answer.exit_code == 2
    assert bench.position_m == 0.0


def test_nobody_at_the_address(bench: Bench) -> None:
    bench.file.write_text(bench.file.read_text().replace(f"port: {bench.server.port}", "port: 1"))
    answer = bench.softarm("home", "--yes")
    assert answer.exit_code == 1
    assert "127.0.0.1:1: connect" in answer.output
