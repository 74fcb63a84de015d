"""The rail's process itself: it outlives the daemon until the drive is disabled.

The drive keeps its set-point without a master. validation.dead_daemon measures the times.
"""

import asyncio
import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import AsyncIterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

import softarm
from softarm.drivers.rail import dryve
from softarm.drivers.rail.cia402 import DriveState
from softarm.drivers.rail.driver import SILENT_S, DryveRailAxis, launch
from softarm.drivers.twin.faults import Faults
from softarm.schemas.config import DryveRail
from tests.drivers.rail.conftest import Drive, Server, stop_while
from tests.processes import gone

pytestmark = pytest.mark.anyio
HEAVY = {"numpy", "numba", "pydantic", "asyncio", "zenoh", "logging", "json", "yaml", "dataclasses", "inspect"}

# A small daemon: it enables the drive, then renews the set-point more often than a tick would.
DAEMON = """
import asyncio, ctypes, signal, sys
from softarm.drivers.rail.driver import DryveRailAxis
from softarm.schemas.config import DryveRail

signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job inherits it ignored
signal.signal(signal.SIGHUP, signal.SIG_DFL)

async def main():
    axis = DryveRailAxis(DryveRail.model_validate_json(sys.argv[1]), 20)
    axis.start()
    signal.signal(signal.SIGUSR1, lambda *_: ctypes.PyDLL(None).usleep(300_000))  # with the interpreter's lock
    print(axis._active.child.pid, flush=True)
    enable = False
    while True:
        axis.write(enable, 0.5)
        enable = enable or axis.read() is not None and axis.problem() is None
        await asyncio.sleep(1 / 60)

asyncio.run(main())
"""


@pytest.fixture
def drive() -> Drive:
    """Return a drive that keeps its set-point without a master."""
    drive = Drive(DryveRail(host="127.0.0.1"))
    drive.keeps_going = True
    return drive


def is_off(drive: Drive) -> bool:
    return drive.state in (DriveState.READY, DriveState.SWITCH_ON_DISABLED)


@contextlib.asynccontextmanager
async def served(drive: Drive) -> AsyncIterator[DryveRail]:
    server = Server("127.0.0.1", 0, drive, Faults(time.monotonic_ns), lambda: 0)
    await server.open()
    try:
        yield DryveRail(host="127.0.0.1", port=server.port, timeout_s=1.0)
    finally:
        await server.close()


@contextlib.asynccontextmanager
async def flying(config: DryveRail, drive: Drive, until: Any) -> AsyncIterator[tuple[int, int]]:
    """Yield the process ids of a daemon that moves the cart and of its rail process."""
    daemon, rail = await launched(config)
    try:
        # On a busy machine the daemon may be late, and the drive disabled again before it moves.
        while not await moves(drive):
            daemon.kill()
            await daemon.wait()
            await until(partial(gone, rail), drive.move)
            daemon, rail = await launched(config)
        yield daemon.pid, rail
    finally:
        with contextlib.suppress(ProcessLookupError):
            daemon.kill()
        await daemon.wait()


async def launched(config: DryveRail) -> tuple[asyncio.subprocess.Process, int]:
    daemon = await asyncio.create_subprocess_exec(
        sys.executable, "-c", DAEMON, config.model_dump_json(), stdout=subprocess.PIPE, start_new_session=True
    )
    assert daemon.stdout is not None
    return daemon, int(await daemon.stdout.readline())


async def moves(drive: Drive) -> bool:
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(5.0):
            while not drive.target_velocity_m_s:
                drive.move()
                await asyncio.sleep(0.002)
    return drive.target_velocity_m_s != 0


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGINT, signal.SIGHUP])
async def test_when_the_daemon_dies_the_drive_is_disabled(drive: Drive, until: Any, end: signal.Signals) -> None:
    async with served(drive) as config, flying(config, drive, until) as (daemon, rail):
        os.killpg(daemon, end)
        await until(lambda: is_off(drive), drive.move)
        await until(lambda: gone(rail))


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGABRT, signal.SIGQUIT, signal.SIGUSR1])
async def test_a_signal_to_the_whole_service_disables_the_drive(drive: Drive, until: Any, number: int) -> None:
    """systemd sends them, SIGABRT for its watchdog, to every process of the service."""
    async with served(drive) as config, flying(config, drive, until) as (daemon, rail):
        children = Path(f"/proc/{daemon}/task/{daemon}/children")  # the reserve is one
        await until(lambda: len(children.read_text().split()) == 2)
        for each in children.read_text().split():
            os.kill(int(each), number)
        os.kill(daemon, signal.SIGKILL)
        await until(lambda: is_off(drive), drive.move)
        await until(lambda: gone(rail))


@pytest.mark.parametrize("freeze", [signal.SIGSTOP, signal.SIGUSR1])
async def test_when_the_daemon_freezes_the_drive_is_disabled_and_stays_disabled(
    drive: Drive, until: Any, freeze: signal.Signals
) -> None:
    async with served(drive) as config, flying(config, drive, until) as (daemon, _):
        os.kill(daemon, freeze)
        await until(lambda: is_off(drive), drive.move)
        os.kill(daemon, signal.SIGCONT)
        since = len(drive.requests)
        until_s = time.monotonic() + 0.5
        await until(lambda: time.monotonic() > until_s, drive.move)
        assert set(drive.writes(dryve.TARGET_VELOCITY, since)) <= {0}
        assert is_off(drive)


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGSTOP])
async def test_a_process_that_dies_or_hangs_is_replaced_by_one_that_stops_the_drive_first(
    drive: Drive, until: Any, running: Any, end: signal.Signals
) -> None:
    async with served(drive) as config:
        axis = DryveRailAxis(config, 20)
        seen: list[bool] = []

        def each(enable: bool) -> None:
            drive.move()
            axis.write(enable, 0.5)
            if (reading := axis.read()) is not None:
                seen.append(reading.linked)

        async with running(axis):
            await until(lambda: axis.read() is not None and axis.problem() is None, lambda: each(False))
            await until(lambda: axis.read().velocity_m_s, lambda: each(True))  # type: ignore[union-attr]
            first = axis._active.child.pid  # type: ignore[union-attr]
            os.kill(first, end)
            await until(lambda: False in seen, lambda: each(True))
            assert "the rail's process ended" in (axis.problem() or "")
            await until(lambda: is_off(drive) and axis.read().linked, lambda: each(True))  # type: ignore[union-attr]
            stop = bytes(4)
            first_link, *others = [[r.data for r in link if r.index == 0x60FF and r.data] for link in drive.links]
            assert set(first_link) > {stop}
            assert {data for link in others for data in link} == {stop}
            assert not axis.read().enabled  # type: ignore[union-attr]
            assert gone(first)
            assert axis._active.child.pid != first  # type: ignore[union-attr]
            await until(lambda: axis.problem() is None, lambda: each(False))
            await until(lambda: drive.target_velocity_m_s, lambda: each(True))


@pytest.fixture
async def moving(drive: Drive, until: Any, running: Any) -> AsyncIterator[tuple[Drive, DryveRailAxis]]:
    """A driver whose process moves the cart."""
    async with served(drive) as config:
        axis = DryveRailAxis(config, 20)
        async with running(axis):
            await until(lambda: axis.problem() is None, lambda: axis.write(False, 0.0))
            await until(lambda: drive.target_velocity_m_s, lambda: axis.write(True, 0.5) or drive.move())
            yield drive, axis


async def test_a_drive_in_fault_is_not_polled_more_often(moving: Any, until: Any) -> None:
    drive, axis = moving
    drive.trip(0x8611)
    await until(lambda: axis.read().faults, lambda: axis.write(True, 0.5))
    since, began_s = len(drive.requests), time.monotonic()
    await until(lambda: time.monotonic() > began_s + 0.5)
    assert len(drive.requests) - since < 150


@pytest.mark.parametrize("before", [signal.SIGTERM, signal.SIGSTOP, signal.SIGKILL])
async def test_stopping_disables_the_drive_and_leaves_no_process_even_if_it_hangs(
    moving: Any, until: Any, monkeypatch: pytest.MonkeyPatch, before: signal.Signals
) -> None:
    monkeypatch.setattr("softarm.drivers.rail.driver.STOP_S", 1.0)
    drive, axis = moving
    process = axis._active.child.pid
    os.kill(process, before)
    await stop_while(drive.move, axis, until)
    assert is_off(drive)
    assert gone(process)


async def test_stopping_disables_the_drive_after_a_process_was_replaced(moving: Any, until: Any) -> None:
    drive, axis = moving

    def steer(enable: bool) -> None:
        axis.write(enable, 0.5)
        drive.move()

    for end, cause in ((signal.SIGSTOP, "no report"), (signal.SIGKILL, "by itself")):
        os.kill(axis._active.child.pid, end)
        await until(lambda: not axis.read().linked, lambda: steer(False))
        assert cause in axis.problem()
        await until(lambda: axis.problem() is None and is_off(drive), lambda: steer(False))
    await until(lambda: drive.target_velocity_m_s, lambda: steer(True))
    await stop_while(drive.move, axis, until)
    assert is_off(drive)


async def test_a_reserve_that_hangs_is_replaced_long_before_a_process_that_starts(
    moving: Any, until: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive, axis = moving
    monkeypatch.setattr("softarm.drivers.rail.driver.START_S", 1e3)
    await until(lambda: axis._spare is not None)
    for process in (axis._active, axis._spare):
        os.kill(process.child.pid, signal.SIGSTOP)
    await until(lambda: is_off(drive), lambda: axis.write(True, 0.5) or drive.move())


async def test_a_reserve_that_has_ended_is_replaced(moving: Any, until: Any) -> None:
    _, axis = moving
    await until(lambda: axis._spare is not None)
    ended = axis._spare.child
    ended.kill()
    await until(lambda: axis._spare is not None and axis._spare.child is not ended, lambda: axis.write(True, 0.5))


async def test_a_process_that_cannot_be_started_is_tried_again(
    drive: Drive, until: Any, running: Any, caplog: pytest.LogCaptureFixture
) -> None:
    refused = False

    def start(*options: Any) -> Any:
        if refused:
            raise BlockingIOError("no more processes")
        return launch(*options)

    async with served(drive) as config:
        axis = DryveRailAxis(config, 20, launch=start)

        def steer(enable: bool) -> None:
            axis.write(enable, 0.5)
            axis.read()
            drive.move()

        async with running(axis):
            await until(lambda: axis.problem() is None, lambda: steer(False))
            await until(lambda: drive.target_velocity_m_s and axis._spare, lambda: steer(True))
            refused = True
            for process in (axis._spare, axis._active):
                process.child.kill()
            await until(lambda: "cannot be started (no more processes)" in caplog.text, lambda: steer(True))
            refused = False
            await until(lambda: is_off(drive) and axis.problem() is None, lambda: steer(False))


async def test_without_a_free_descriptor_the_process_is_started_later(
    free_port: int, until: Any, running: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: Any) -> Any:
        raise OSError("too many open files")

    axis = DryveRailAxis(DryveRail(host="127.0.0.1", port=free_port))
    monkeypatch.setattr(socket, "socketpair", refuse)
    async with running(axis):
        monkeypatch.undo()
        await until(lambda: "Connection refused" in (axis.problem() or ""), lambda: axis.write(False, 0.0))


async def test_a_delay_of_the_control_loop_leaves_the_process_alone(moving: Any, until: Any) -> None:
    _, axis = moving
    process = axis._active.child
    time.sleep(2 * SILENT_S)
    axis.write(True, 0.5)
    received = axis._received_ns
    await until(lambda: axis._received_ns > received, lambda: axis.write(True, 0.5))
    assert axis._active.child is process
    assert process.poll() is None


async def test_a_stop_while_a_found_drive_brakes_disables_it(drive: Drive, until: Any) -> None:
    drive.state, drive.coasts, drive.velocity_m_s = DriveState.OPERATION_ENABLED, True, 0.5
    drive.move()
    async with served(drive) as config:
        axis = DryveRailAxis(config, 20)
        axis.start()
        await until(lambda: 0x010F in drive.writes(dryve.CONTROLWORD), drive.move)
        await stop_while(drive.move, axis, until)
    assert is_off(drive)


async def test_the_process_is_small_and_imports_little(free_port: int, until: Any, running: Any) -> None:
    axis = DryveRailAxis(DryveRail(host="127.0.0.1", port=free_port))
    async with running(axis):
        await until(lambda: "Connection refused" in (axis.problem() or ""), lambda: axis.write(False, 0.0))
        status = Path(f"/proc/{axis._active.child.pid}/status").read_text()  # type: ignore[union-attr]
        [resident_kb] = [int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS")]
        # An empty interpreter has 9,000, the daemon 200,000.
        assert resident_kb < 25_000
    names = "import sys, softarm.drivers.rail.process; print(*sys.modules)"
    root = str(Path(softarm.__file__).parents[1])
    command = [sys.executable, "-S", "-P", "-c", names]
    listed = subprocess.run(command, env={"PYTHONPATH": root}, capture_output=True, text=True, check=True).stdout
    assert not HEAVY & {name.partition(".")[0] for name in listed.split()}
