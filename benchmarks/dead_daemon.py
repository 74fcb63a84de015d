"""How far does the cart go when a process dies, freezes or holds its lock?

The wire-level twin, in this process, with a drive that keeps its set-point when nobody leads it; a daemon of its own,
whose policy drives the cart at up to 1 m/s from end to end, as fast as the safety filter lets it. At a moment drawn at
random something is done to the daemon or to the rail's process. What the robot saw is measured: how long after the last
set-point that moved the cart it was told to stop, when the valve opened, how far the cart went.

    python -m softarm.benchmarks.dead_daemon --repeats 50 --json FILE
"""

import asyncio
import contextlib
import os
import random
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click
import httpx
import numpy as np
from rich.console import Console
from rich.table import Table

from softarm.benchmarks import results
from softarm.common.processes import bar
from softarm.daemon.shell import realtime
from softarm.drivers.bodies.base import Body
from softarm.drivers.bodies.simulated import SimulatedBody
from softarm.drivers.rail import process as rail_process
from softarm.drivers.twin.cameras import TwinState
from softarm.drivers.twin.main import Twin
from softarm.flights.software_in_the_loop import SoftwareInTheLoop, SoftwareInTheLoopError
from softarm.schemas.config import Config

SWING_S = (0.3, 2.0)  # how long the policy drives before something happens
REST_S = 5.0  # everything has come to rest long before
RECOVER_S = 60.0
LOCK_S = 1.0
KILLED_S = 1.0  # after which one that was killed has ended
SAMPLE_S = 0.002
SPEED_M_S = 0.2  # a trial begins at no less

# A guest policy: from end to end at full speed, with pressure drawn anew each time; on request it holds the lock.
_POLICY = """
import ctypes, os, random
import numpy as np
from softarm.policies.base import PolicySpec

class Rush:
    spec = PolicySpec(name="rush", description="from end to end at full speed", needs_target=False)

    def __init__(self, trigger: str) -> None:
        self._trigger, self._draw, self._left = trigger, random.Random(0), 0

    def reset(self) -> None:
        self._left = 0

    def step(self, observation, goal):
        if self._left <= 0:
            self._left = self._draw.randint(3, 24)
            self._command = np.array((self._draw.choice((-1.0, 1.0)), self._draw.uniform(0, 20)), dtype=np.float32)
        self._left -= 1
        if os.path.exists(self._trigger):
            os.remove(self._trigger)
            ctypes.PyDLL(None).usleep({lock_us})
        return self._command
"""


class Robot(threading.Thread):
    """The twin, on an asyncio loop of its own."""

    def __init__(self, config: Config, body: Body) -> None:
        super().__init__(name="robot", daemon=True)
        self._config, self._body = config, body
        self._ready, self._over = threading.Event(), threading.Event()
        self._problem: BaseException | None = None
        self.twin: Twin
        self.seen: list[tuple[float, float, bool]] | None = None  # when, where the cart was, was the valve open

    def run(self) -> None:
        """Be the robot until told."""
        realtime.outrank_guests(self._config.control.realtime_priority)
        try:
            asyncio.run(self._serve())
        except BaseException as error:
            self._problem = error
        self._ready.set()

    async def _serve(self) -> None:
        async with Twin(self._config, body=self._body) as twin:
            twin.faults.rail_keeps_going()
            self.twin = twin
            self._ready.set()
            while not self._over.is_set():
                if self.seen is not None:
                    self.seen.append((time.monotonic(), twin.state.cart_position_m, twin.teensy.set_point_kpa == 0.0))
                await asyncio.sleep(SAMPLE_S)

    def wait(self) -> None:
        """Until its wires are there. Raises what kept it from that."""
        self._ready.wait()
        if self._problem is not None:
            raise self._problem

    def end(self) -> None:
        """And wait for it."""
        self._over.set()
        self.join(5.0)

    @property
    def state(self) -> TwinState:
        """The truth."""
        return self.twin.state


class Rig(SoftwareInTheLoop):
    """A daemon that drives the robot from end to end."""

    def __init__(self, folder: Path, body: Body) -> None:
        self._trigger = folder / "lock"
        policy = {"plugin": "rush", "options": {"trigger": str(self._trigger)}}
        overrides = {"policies": {"rush": policy}, "control": {"policy": "rush"}, "goals": {"time_limit_s": 600}}
        super().__init__(folder / "logs", overrides)
        self.robot = Robot(Config.model_validate(self.settings), body)

    def start_twin(self) -> None:
        """The robot, in this process."""
        self.robot.start()
        self.robot.wait()

    def start_daemon(self) -> None:
        """The daemon; one before it was killed, which it begins with a latch for."""
        self.daemon = self._start("run", self.config_file)
        self.recover()

    def recover(self) -> None:
        """Until arming would be accepted. Raises SoftwareInTheLoopError when it never is."""
        deadline = time.monotonic() + RECOVER_S
        while not self.healthy():
            if time.monotonic() > deadline:
                raise SoftwareInTheLoopError(f"the daemon did not recover:\n{self._tail('run')}")
            with contextlib.suppress(SoftwareInTheLoopError, httpx.HTTPError):
                self.post("acknowledge")
            time.sleep(0.1)

    def rush(self) -> None:
        """Have the policy drive. Raises SoftwareInTheLoopError when the daemon does not arm for `RECOVER_S`."""
        deadline = time.monotonic() + RECOVER_S
        while True:
            try:
                self.arm()
                self.post("goal", kind="run")
                return
            except SoftwareInTheLoopError:  # a busy machine stopped it
                if time.monotonic() > deadline:
                    raise
                self.recover()

    def leader(self) -> int:
        """The rail's process that leads the drive: beside its end of the pair it has a connection."""
        assert self.daemon is not None
        children = Path(f"/proc/{self.daemon.pid}/task").glob("*/children")
        processes = [int(number) for file in children for number in file.read_text().split()]
        return max((process for process in processes if _is_rails(process)), key=_sockets)

    # What is done to it

    def kill(self) -> None:
        """kill -9 of the daemon."""
        assert self.daemon is not None
        self.daemon.kill()

    def freeze(self) -> None:
        """SIGSTOP of the daemon."""
        assert self.daemon is not None
        self.daemon.send_signal(signal.SIGSTOP)

    def lock(self) -> None:
        """Its policy holds the interpreter's lock."""
        self._trigger.touch()

    def kill_rail(self) -> None:
        """kill -9 of the rail's process."""
        os.kill(self.leader(), signal.SIGKILL)

    def freeze_rail(self) -> None:
        """SIGSTOP of the rail's process."""
        os.kill(self.leader(), signal.SIGSTOP)

    def go_on(self) -> None:
        """A daemon that can drive again."""
        assert self.daemon is not None
        self.daemon.send_signal(signal.SIGCONT)
        try:
            self.daemon.wait(KILLED_S)
        except subprocess.TimeoutExpired:
            self.recover()
        else:
            self.start_daemon()


CASES: dict[str, Callable[[Rig], None]] = {
    "daemon: kill -9": Rig.kill,
    "daemon: SIGSTOP": Rig.freeze,
    f"daemon: interpreter's lock held for {LOCK_S:g} s": Rig.lock,
    "rail's process: kill -9": Rig.kill_rail,
    "rail's process: SIGSTOP": Rig.freeze_rail,
}


def run(repeats: int, cases: list[str], report: Callable[[float], None], body: Body | None = None) -> dict[str, Any]:
    """So many trials of each case; report(share done). Raises SoftwareInTheLoopError when the daemon does not fly."""
    realtime.outrank_other_programs(Config().control.realtime_priority)  # the robot waits for no other program
    draw = random.Random(0)
    figures: dict[str, Any] = {}
    with _rig(body or SimulatedBody()) as rig:
        for number, name in enumerate(cases):
            trials = []
            for repeat in range(repeats):
                trials.append(_trial(rig, CASES[name], draw))
                report((number + (repeat + 1) / repeats) / len(cases))
            figures[name] = _figures(trials)
    return figures


@contextlib.contextmanager
def _rig(body: Body) -> Iterator[Rig]:
    with tempfile.TemporaryDirectory(prefix="softarm-") as name:
        folder, path = Path(name), os.environ.get("PYTHONPATH", "")
        (folder / "rush.py").write_text(_POLICY.format(lock_us=round(LOCK_S * 1e6)))
        about = folder / "rush-1.dist-info"
        about.mkdir()
        (about / "METADATA").write_text("Metadata-Version: 2.1\nName: rush\nVersion: 1\n")
        (about / "entry_points.txt").write_text("[softarm.policies]\nrush = rush:Rush\n")
        os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (str(folder), path)))
        rig = Rig(folder, body)
        try:
            with rig:
                yield rig
        finally:
            rig.robot.end()
            os.environ["PYTHONPATH"] = path


def _trial(rig: Rig, do: Callable[[Rig], None], draw: random.Random) -> dict[str, float]:
    rig.rush()
    time.sleep(draw.uniform(*SWING_S))
    robot, speed_m_s = rig.robot, draw.uniform(SPEED_M_S, 0.95)
    deadline = time.monotonic() + REST_S
    while abs(robot.state.cart_velocity_m_s) < speed_m_s and time.monotonic() < deadline:
        time.sleep(0.001)
    seen: list[tuple[float, float, bool]] = []
    before, began_s, robot.seen = robot.state, time.monotonic(), seen
    do(rig)
    deadline = time.monotonic() + REST_S
    while not _at_rest(state := robot.state) and time.monotonic() < deadline:
        time.sleep(SAMPLE_S)
    time.sleep(0.1)
    robot.seen = None
    assert state.halted_after_s is not None, "the cart was never told to stop"
    rig.go_on()
    places = [before.cart_position_m, *(place for _, place, _ in seen)]
    return {
        "speed_m_s": abs(before.cart_velocity_m_s),
        "told_to_stop_ms": state.halted_after_s * 1e3,
        "vented_ms": 1e3 * (next(at_s for at_s, _, valve_open in seen if valve_open) - began_s),
        "travel_mm": 1e3 * max(abs(place - places[0]) for place in places),
        "farthest_mm": 1e3 * max(map(abs, places)),
        "crashes": state.crashes - before.crashes,
    }


def _at_rest(state: TwinState) -> bool:
    return state.halted_after_s is not None and state.braked_since_ns is not None and state.vented


def _is_rails(process: int) -> bool:
    return rail_process.__name__.encode() in Path(f"/proc/{process}/cmdline").read_bytes()


def _sockets(process: int) -> int:
    return sum("socket:" in str(file.readlink()) for file in Path(f"/proc/{process}/fd").iterdir())


def _figures(trials: list[dict[str, float]]) -> dict[str, Any]:
    measured = [name for name in trials[0] if name != "crashes"]
    spread = {name: _spread([trial[name] for trial in trials]) for name in measured}
    return {**spread, "trials": len(trials), "crashes": sum(round(trial["crashes"]) for trial in trials)}


def _spread(values: list[float]) -> dict[str, float]:
    p50, p99, top = map(float, np.percentile(values, [50, 99, 100]))
    return {"p50": p50, "p99": p99, "max": top}


@click.command()
@click.option("--repeats", default=50, show_default=True, type=click.IntRange(1), help="Of each case.")
@click.option("--reality", is_flag=True, help="The independent robot in the simulated one's place.")
@results.json_option
def main(repeats: int, reality: bool, json_file: Path | None) -> None:
    """How far the cart goes when a process dies, freezes or holds its lock.

    \b
    Example:
      python -m softarm.benchmarks.dead_daemon --repeats 50 --json dead-daemon.json
    """
    body: Body | None = None
    if reality:
        from softarm.drivers.bodies.independent import IndependentBody

        body = IndependentBody()
    try:
        with bar("ending daemons") as shown:
            figures = run(repeats, list(CASES), shown.show, body)
    except SoftwareInTheLoopError as error:
        raise click.ClickException(str(error)) from None
    if json_file is not None:
        results.write(json_file, {"cases": figures})
    table = Table("p50 / p99 / max", "told to stop (ms)", "valve open (ms)", "travel (mm)", "farthest (mm)", "crashes")
    for name, found in figures.items():
        told = ("{p50:.0f} / {p99:.0f} / {max:.0f}".format(**found[key]) for key in list(found)[1:5])
        table.add_row(name, *told, str(found["crashes"]))
    Console().print(table)


if __name__ == "__main__":
    main()
