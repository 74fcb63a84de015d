"""Measure how far the cart moves when a process dies, freezes or holds its lock.

The wire-level twin runs in this process, with a drive that keeps its last set-point without a master. A separate daemon
runs a policy that drives the cart from end to end at up to 1 m/s, as fast as the safety filter allows. At a random
moment the daemon or the rail's process is disturbed. Measured at the robot: the time from the last set-point that moved
the cart to the stop, the time to the open valve, and the travel of the cart.

    python -m validation.dead_daemon --repeats 50 --json FILE
"""

import asyncio
import os
import random
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
from anyio.from_thread import start_blocking_portal

from benchmarks import results
from softarm.cli.shared.errors import failing
from softarm.common import realtime
from softarm.common.processes import bar
from softarm.drivers.bodies.simulated import SimulatedBody
from softarm.drivers.twin.cameras import TwinState
from softarm.drivers.twin.main import Twin
from softarm.evaluation.software_in_the_loop import SoftwareInTheLoopError
from softarm.schemas.config import Config
from validation.daemon_process import DisturbedDaemon

SWING_S = (0.3, 2.0)  # how long the policy drives before the disturbance
REST_S = 5.0  # longer than any stop takes
RECOVER_S = 60.0
LOCK_S = 1.0
KILLED_S = 1.0  # a killed daemon has ended by then
SAMPLE_S = 0.002
SPEED_M_S = 0.2  # minimum speed at the disturbance


class Rig(DisturbedDaemon):
    """Daemon that drives a robot of this process from end to end."""

    def __init__(self, folder: Path) -> None:
        self.trigger = folder / "lock"  # once it exists, the policy holds the interpreter's lock
        policy = {"plugin": "rush", "options": {"trigger": str(self.trigger), "lock_s": LOCK_S}}
        overrides = {"policies": {"rush": policy}, "control": {"policy": "rush"}, "goals": {"time_limit_s": 600}}
        super().__init__(folder / "logs", overrides)
        self.robot: Twin
        self.seen: list[tuple[float, float, bool]] | None = None  # time, cart position, whether the valve was open

    def start_twin(self) -> None:
        """Simulate the robot in a thread of this process."""
        portal = self.beside.enter_context(start_blocking_portal())
        portal.call(realtime.outrank_own_threads, Config().control.realtime_priority)
        twin = Twin(Config.model_validate(self.settings), body=SimulatedBody())
        self.robot = self.beside.enter_context(portal.wrap_async_context_manager(twin))
        self.robot.faults.start("rail_keeps_going")
        self.beside.callback(portal.start_task_soon(self._watch).cancel)

    async def _watch(self) -> None:
        while True:
            if self.seen is not None:
                state, is_open = self.robot.state, self.robot.teensy.set_point_kpa == 0.0
                self.seen.append((time.monotonic(), state.cart_position_m, is_open))
            await asyncio.sleep(SAMPLE_S)

    def go_on(self) -> None:
        """Return to a daemon that can drive."""
        self.process.send_signal(signal.SIGCONT)
        try:
            self.process.wait(KILLED_S)
        except subprocess.TimeoutExpired:
            self.recover(RECOVER_S)
        else:
            self.start_daemon()


CASES: dict[str, Callable[[Rig], None]] = {
    "daemon: kill -9": lambda rig: rig.process.kill(),
    "daemon: SIGSTOP": lambda rig: rig.process.send_signal(signal.SIGSTOP),
    f"daemon: interpreter's lock held for {LOCK_S:g} s": lambda rig: rig.trigger.touch(),
    "rail's process: kill -9": lambda rig: os.kill(rig.rail_process(), signal.SIGKILL),
    "rail's process: SIGSTOP": lambda rig: os.kill(rig.rail_process(), signal.SIGSTOP),
}


def run(repeats: int, cases: list[str], report: Callable[[float], None]) -> dict[str, Any]:
    """Measure `repeats` trials of each case and return the figures by case; `report` receives the finished share.

    Raises SoftwareInTheLoopError if the daemon does not drive, or the robot is not stopped and vented.
    """
    # Real devices do not wait for other programs.
    realtime.outrank_other_programs(Config().control.realtime_priority)
    draw = random.Random(0)
    figures: dict[str, Any] = {}
    with tempfile.TemporaryDirectory(prefix="softarm-") as folder, Rig(Path(folder)) as rig:
        for number, name in enumerate(cases):
            trials = []
            for repeat in range(repeats):
                trials.append(_trial(rig, name, draw))
                report((number + (repeat + 1) / repeats) / len(cases))
            figures[name] = _figures(trials)
    return figures


def _trial(rig: Rig, name: str, draw: random.Random) -> dict[str, float]:
    rig.drive(RECOVER_S)
    time.sleep(draw.uniform(*SWING_S))
    robot, speed_m_s = rig.robot, draw.uniform(SPEED_M_S, 0.95)
    deadline = time.monotonic() + REST_S
    while abs(robot.state.cart_velocity_m_s) < speed_m_s and time.monotonic() < deadline:
        time.sleep(0.001)
    seen: list[tuple[float, float, bool]] = []
    before, began_s, rig.seen = robot.state, time.monotonic(), seen
    CASES[name](rig)
    deadline = time.monotonic() + REST_S
    while not _at_rest(state := robot.state) and time.monotonic() < deadline:
        time.sleep(SAMPLE_S)
    time.sleep(0.1)
    rig.seen = None
    vented_s = next((at_s for at_s, _, valve_open in seen if valve_open), None)
    if state.halted_after_s is None or vented_s is None:
        missing = "the cart received no stop" if state.halted_after_s is None else "the valve did not open"
        raise SoftwareInTheLoopError(f"{name}: {missing} within {REST_S:g} s")
    rig.go_on()
    places = [before.cart_position_m, *(place for _, place, _ in seen)]
    return {
        "speed_m_s": abs(before.cart_velocity_m_s),
        "stop_received_ms": state.halted_after_s * 1e3,
        "vented_ms": 1e3 * (vented_s - began_s),
        "travel_mm": 1e3 * max(abs(place - places[0]) for place in places),
        "farthest_mm": 1e3 * max(map(abs, places)),
        "crashes": state.crashes - before.crashes,
    }


def _at_rest(state: TwinState) -> bool:
    return state.halted_after_s is not None and state.braked_since_ns is not None and state.vented


def _figures(trials: list[dict[str, float]]) -> dict[str, Any]:
    measured = [name for name in trials[0] if name != "crashes"]
    spread = {name: results.spread([trial[name] for trial in trials]) for name in measured}
    return {**spread, "trials": len(trials), "crashes": sum(round(trial["crashes"]) for trial in trials)}


@click.command()
@click.option("--repeats", default=50, show_default=True, type=click.IntRange(1), help="Trials of each case.")
@results.json_option
def main(repeats: int, json_file: Path | None) -> None:
    """Measure how far the cart moves when a process dies, freezes or holds its lock.

    \b
    Example:
      python -m validation.dead_daemon --repeats 50 --json dead-daemon.json
    """
    with failing(SoftwareInTheLoopError), bar("ending daemons") as shown:
        figures = run(repeats, list(CASES), shown.show)
    results.report("dead-daemon", {"cases": figures}, json_file)


if __name__ == "__main__":
    main()
