"""Fly goals without rest: does the cart ever leave its limits, does the arm ever stop unrequested?

Each goal starts where the last one ended, in mid-swing; goals are drawn from the whole workspace. The body is the
simulator or the independent robot of `reality/`, in lockstep with the daemon's tick, or the robot of
`validation/outside/` behind real interfaces in real time. The cart's motion is taken from the body's true state.
After an unrequested stop a new robot starts at rest in the middle.

    python -m validation.chained --body outside --goals 1000 --json FILE
"""

import contextlib
import json
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import click
import numpy as np

from benchmarks import results
from softarm.cli.shared.errors import failing
from softarm.common.processes import bar
from softarm.daemon.control import workspace
from softarm.daemon.control.records import Mode, Outputs, Request
from softarm.daemon.runtime.offline import Lockstep
from softarm.drivers.bodies.base import Body
from softarm.drivers.bodies.independent import IndependentBody
from softarm.drivers.bodies.simulated import SimulatedBody
from softarm.evaluation.software_in_the_loop import SoftwareInTheLoop, SoftwareInTheLoopError
from softarm.policies import registry
from softarm.policies.base import Policy
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal
from softarm.schemas.robot import RAIL_EXCURSION_M

STOP_M = 0.0005  # distance from the end of travel that counts as a hit
LOOKS = 8  # samples of the cart per tick in lockstep: 240 Hz
AFTER_S = 1.0  # observed after a stop and after the last goal
POLL_S = 0.03


@dataclass
class Leg:
    """Result of one goal."""

    reached: bool
    trained: bool  # target within the policy's training range
    max_cart_m: float
    excursions: int
    crashes: int
    stop: str | None  # reason of an unrequested stop
    events: list[str]
    seconds: float
    timing: dict[str, float] = field(default_factory=dict)  # in real time only


class Cart:
    """Record of a cart, with its farthest position and how often it exceeded the bound and hit the end of travel."""

    def __init__(self, bound_m: float, travel_m: float) -> None:
        self.max_m = 0.0
        self.excursions = self.crashes = 0
        self._bound_m, self._end_m = bound_m, travel_m - STOP_M
        self._before_m = 0.0

    def look(self, cart_m: float) -> None:
        """Record the current position, m from the middle."""
        before_m, away_m = self._before_m, abs(cart_m)
        self.max_m = max(self.max_m, away_m)
        self.excursions += away_m > self._bound_m >= before_m
        self.crashes += away_m >= self._end_m > before_m
        self._before_m = away_m


class InLockstep:
    """The daemon's tick with a body in this process."""

    def __init__(self, config: Config, policy: Policy, body: Body) -> None:
        self._daemon = Lockstep(config, policy, body=body)
        self._daemon.arm()
        self._cart = Cart(bound_m(config), body.travel_m)
        self._period_ns = round(1e9 / config.control.rate_hz)

    def pursue(self, goal: Goal, trained: bool, last: bool) -> Leg:
        """Fly one goal from the current state, and observe for another second after the last one.

        `trained` states whether the policy was trained on targets there.
        """
        cart, daemon = self._cart, self._daemon
        cart.max_m, excursions, crashes = 0.0, cart.excursions, cart.crashes
        events: set[str] = set()
        outputs = self._tick(daemon.request("goal", goal))
        assert outputs.results[-1].accepted, outputs.results[-1].reasons
        begun_ns = outputs.t_ns
        while outputs.goal.state == "running" and outputs.mode is Mode.ARMED:
            outputs = self._tick()
            events |= {event.name for event in outputs.events}
        seconds = (outputs.t_ns - begun_ns) * 1e-9
        stop = None if outputs.mode is Mode.ARMED else str(outputs.last_stop)
        reached = outputs.goal.state == "reached"
        for _ in range(round(AFTER_S * daemon.config.control.rate_hz) if last or stop else 0):
            self._tick()
        excursions, crashes = cart.excursions - excursions, cart.crashes - crashes
        return Leg(reached, trained, cart.max_m, excursions, crashes, stop, sorted(events), seconds)

    def _tick(self, *requests: Request) -> Outputs:
        robot = self._daemon.robot
        begun_ns = robot.now_ns
        for part in range(1, LOOKS):
            robot.advance(begun_ns + part * self._period_ns // LOOKS)
            self._cart.look(robot.body.truth.cart_position_m)
        outputs = self._daemon.tick(*requests)
        self._cart.look(robot.body.truth.cart_position_m)
        return outputs


class Outside(SoftwareInTheLoop):
    """The daemon as a user starts it, with the outside robot in place of the twin, in real time."""

    def __init__(self, policy: str, bound: float, logs: Path) -> None:
        super().__init__(logs, {"control": {"policy": policy}})
        self._bound_m = bound
        self._truth_file = self.folder / "truth.json"

    def start_twin(self) -> None:
        """Start the outside robot instead of the twin."""
        drivers = self.settings["drivers"]
        where = {
            "serial": drivers["regulator"]["port"],
            "rail-port": drivers["rail"]["port"],
            "endpoint": drivers["mocap"]["endpoint"],
            "status": self._truth_file,
            "bound-m": self._bound_m,
        }
        program = [sys.executable, "-m", "validation.outside", *(f"--{name}={value}" for name, value in where.items())]
        with (self.folder / "outside.out").open("ab") as output:
            self.twin = subprocess.Popen(program, stdout=output, stderr=subprocess.STDOUT)
        self._wait("outside", self.twin, lambda: self._truth_file.exists() and self._truth_file.stat().st_size > 0)

    def start_daemon(self) -> None:
        """Start the daemon and arm. Raises SoftwareInTheLoopError."""
        super().start_daemon()
        self.arm()

    def truth(self) -> dict[str, Any]:
        """Return the robot's true state, at most 50 ms old."""
        while True:  # the file is rewritten in place and may be incomplete
            with contextlib.suppress(json.JSONDecodeError):
                return dict(json.loads(self._truth_file.read_text()))

    def pursue(self, goal: Goal, trained: bool, last: bool) -> Leg:
        """Fly one goal as `InLockstep.pursue` does. Raises SoftwareInTheLoopError if it is refused."""
        before, missed = self.truth(), self.status()["missed_total"]
        events: set[str] = set()
        self.reach(goal)
        while (status := self.status())["goal"]["state"] == "running" and status["mode"] == "armed":
            events |= {event["name"] for event in status["events"]}
            time.sleep(POLL_S)
        stop = None if status["mode"] == "armed" else str(status["last_stop"])
        if last or stop:
            time.sleep(AFTER_S)
        after = self.truth()
        timing = {name: after[name] - before[name] for name in ("steps", "late_steps", "stalls", "paused_s")}
        return Leg(
            reached=status["goal"]["state"] == "reached",
            trained=trained,
            max_cart_m=after["max_cart_m"],
            excursions=after["excursions"] - before["excursions"],
            crashes=after["crashes"] - before["crashes"],
            stop=stop,
            events=sorted(events | {event["name"] for event in status["events"]}),
            seconds=status["goal"]["time_s"],
            timing={**timing, "max_late_s": after["max_late_s"], "missed_ticks": status["missed_total"] - missed},
        )


def bound_m(config: Config) -> float:
    """Return how far the cart may be from the middle, soft limit and margin together."""
    rail = config.limits.rail
    return max(-rail.position_min_m, rail.position_max_m) + RAIL_EXCURSION_M


def draw(config: Config, seed: int, number: int) -> Goal:
    """Return the goal with a given number, drawn from the targets that the daemon would accept."""
    rng, space = np.random.default_rng((seed, number)), config.goals.workspace
    while True:
        y_m, z_m = rng.uniform((space.y_min_m, space.z_min_m), (space.y_max_m, space.z_max_m)).tolist()
        goal = Goal("reach", y_m, z_m)
        if not workspace.refusals(goal, config):
            return goal


Arm = contextlib.nullcontext[InLockstep] | Outside


def fly(begin: Callable[[], Arm], goals: Iterable[tuple[Goal, bool]]) -> Iterator[Leg]:
    """Fly goals, each with whether the policy was trained there; `begin` makes an arm, and another after each stop."""
    left = list(goals)
    while left:
        with begin() as arm:
            stop = None
            while left and stop is None:
                (goal, trained), *left = left
                leg = arm.pursue(goal, trained, last=not left)
                stop = leg.stop
                yield leg


def summary(legs: Sequence[Leg]) -> dict[str, Any]:
    """Return the figures of a whole chain."""
    trained = [leg for leg in legs if leg.trained]
    found: dict[str, Any] = {
        "goals": len(legs),
        "reached": sum(leg.reached for leg in legs),
        "trained_goals": len(trained),
        "trained_reached": sum(leg.reached for leg in trained),
        "max_cart_m": max(leg.max_cart_m for leg in legs),
        "excursions": sum(leg.excursions for leg in legs),
        "crashes": sum(leg.crashes for leg in legs),
        "stops": dict(Counter(leg.stop for leg in legs if leg.stop is not None)),
        "goals_with_event": dict(Counter(event for leg in legs for event in leg.events)),
        "seconds": sum(leg.seconds for leg in legs),
    }
    if timed := [leg.timing for leg in legs if leg.timing]:
        longest = {"max_late_s": max(each["max_late_s"] for each in timed)}
        found["timing"] = {name: sum(each[name] for each in timed) for name in timed[0]} | longest
    found["incidents"] = [
        {"goal": number, **asdict(leg)} for number, leg in enumerate(legs) if leg.excursions or leg.crashes or leg.stop
    ]
    return found


@click.command()
@click.option("--body", type=click.Choice(["simulated", "reality", "outside"]), required=True, help="Robot to fly.")
@click.option("--goals", default=1000, show_default=True, type=click.IntRange(min=1))
@click.option("--policy", default="reach-wide", show_default=True, help="Name, as `softarm policy list` shows it.")
@click.option("--seed", default=0, show_default=True, type=click.IntRange(min=0), help="Of the goals.")
@results.json_option
def main(body: str, goals: int, policy: str, seed: int, json_file: Path | None) -> None:
    """Fly goals without rest; exit with 1 if the cart exceeded its bound or the arm stopped unrequested.

    \b
    Example:
      python -m validation.chained --body reality --goals 200
    """
    config, trained = Config(), registry.load(policy).spec.trained
    legs: list[Leg] = []

    def begin() -> Arm:
        if body == "outside":
            return Outside(policy, bound_m(config), Path(folder))
        stops = sum(leg.stop is not None for leg in legs)
        made: Body = SimulatedBody() if body == "simulated" else IndependentBody(seed=len(legs) + stops)
        return contextlib.nullcontext(InLockstep(config, registry.load(policy), made))

    drawn = [draw(config, seed, number) for number in range(goals)]
    aims = [(goal, trained is not None and not workspace.warnings(goal, policy, trained)) for goal in drawn]
    with (
        failing(SoftwareInTheLoopError),
        tempfile.TemporaryDirectory(prefix="softarm-") as folder,
        bar(f"chained, {body}", goals) as shown,
    ):
        for leg in fly(begin, aims):
            legs.append(leg)
            shown.advance()
    figures = {"body": body, "policy": policy, "seed": seed, **summary(legs)}
    results.write(json_file, figures)
    _say(figures, bound_m(config))
    raise SystemExit(bool(figures["excursions"] or figures["crashes"] or figures["stops"]))


def _say(figures: dict[str, Any], bound: float) -> None:
    click.echo(
        f"{figures['body']}, {figures['policy']}: {figures['reached']} of {figures['goals']} goals reached "
        f"({figures['trained_reached']} of {figures['trained_goals']} in its training range); cart within "
        f"{figures['max_cart_m']:.4f} m, {figures['excursions']} times beyond {bound:g} m, {figures['crashes']} times "
        f"at its end; {sum(figures['stops'].values())} unrequested stops"
    )
    for reason, count in figures["stops"].items():
        click.echo(f"  {count} x {reason}")
    if "timing" in figures:
        timing = figures["timing"]
        click.echo(
            f"  robot: {timing['late_steps']} of {timing['steps']} steps more than 5 ms late, the latest "
            f"{1e3 * timing['max_late_s']:.0f} ms ({timing['stalls']} times more than 20 ms), paused for "
            f"{timing['paused_s']:.2f} s; daemon: {timing['missed_ticks']} ticks missed"
        )


if __name__ == "__main__":
    main()
