"""Check that measured limits cover the robot, on rails of known ramp, latency, payload and read-back delay.

    python -m validation.limits --json limits.json

Each robot is first flown with a careful configuration (`softarm excite rail-dashes`, then the policy `reach` from goal
to goal). Its limits are measured from these flights as `softarm identify --limits` does. The patched configuration then
faces a policy that drives the cart against both ends as hard as possible. The cart's motion is the body's true state.
The simulated robot needs the extra `sim`, the independent one `mujoco`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np

from benchmarks import results
from softarm.common import batch
from softarm.daemon.control.records import Mode, Tick
from softarm.daemon.limits.findings import EXCITATION, findings
from softarm.daemon.runtime.offline import Lockstep
from softarm.drivers.bodies.base import Body
from softarm.drivers.bodies.independent import IndependentBody
from softarm.drivers.bodies.simulated import SimulatedBody
from softarm.policies import registry
from softarm.policies.base import Array, Policy, PolicySpec
from softarm.policies.excite import Excite
from softarm.reality.parameters import Arm, Rail, RobotParameters
from softarm.recordings.rail_motion import RailMotion
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal
from validation.adversary import LateBody
from validation.adversary_batch import World

LOOKS = 8  # samples of the body per tick
PLAYED_S, REACH_S, ATTACK_S = 65.0, 60.0, 30.0


@dataclass(frozen=True)
class Robot:
    """Robot with known properties."""

    body: str  # simulator, reality
    ramp_m_s2: float
    latency_s: float
    payload_kg: float
    age_s: float  # how much older readings are than their stamps

    def make(self) -> LateBody:
        """Return a new body, at rest in the middle."""
        body: Body
        if self.body == "reality":
            rail = Rail(acceleration_m_s2=self.ramp_m_s2, delay_s=self.latency_s)
            body = IndependentBody(RobotParameters(rail=rail, arm=Arm(payload_kg=self.payload_kg)))
        else:
            world = World(self.ramp_m_s2, self.latency_s, self.payload_kg, self.age_s, skips=0.0, skipped_max=1)
            body = SimulatedBody(world.model)
        return LateBody(body, self.age_s, eighths, fresh=True)

    def config(self, **rail: float) -> Config:
        """Return the daemon's configuration, with the drive set to the robot's ramp."""
        limits = {"acceleration_max_m_s2": 20.0, "surge_m_s2": self.ramp_m_s2, "braking_m_s2": self.ramp_m_s2, **rail}
        drive = {"acceleration_m_s2": self.ramp_m_s2, "quick_stop_m_s2": self.ramp_m_s2}
        return Config.model_validate({"limits": {"rail": limits}, "drivers": {"rail": drive}})


ROBOTS = tuple(
    Robot(body, *kind)
    for body in ("simulator", "reality")
    for kind in (
        (6.0, 0.033, 0.0, 0.0),
        (6.0, 0.01, 0.1, 0.0),
        (3.0, 0.06, 0.1, 0.03),
        (8.0, 0.1, 0.05, 0.0),
        (2.0, 0.033, 0.0, 0.03),
    )
)


def eighths(duration_ns: int) -> Iterator[int]:
    """Split a duration into LOOKS intervals."""
    for look in range(LOOKS):
        yield duration_ns * (look + 1) // LOOKS - duration_ns * look // LOOKS


class Attack(Policy):
    """Policy that drives at full speed in either direction while the muscle swings the arm."""

    def __init__(self, seed: int) -> None:
        self.spec = PolicySpec("attack", "drives the cart against both ends", needs_target=False)
        self._rng = np.random.default_rng(seed)
        self._left = [0, 0]
        self._wanted = np.zeros(2, dtype=np.float32)

    def reset(self) -> None:
        """Do nothing, since the attack keeps no state of a goal."""

    def step(self, observation: Array, goal: Array) -> Array:
        """Return cart velocity and pressure."""
        for i, (low, high, longest) in enumerate(((-1.0, 1.0, 20), (0.0, 20.0, 30))):
            self._left[i] -= 1
            if self._left[i] < 0:
                self._left[i] = int(self._rng.integers(1, longest))
                self._wanted[i] = self._rng.choice((low, high))
        return self._wanted.copy()


def motion(ticks: Sequence[Tick], config: Config) -> RailMotion:
    """Return the motion of the rail, as read from a log of these ticks."""
    sent = [(o.t_ns * 1e-9, o.sent.cart_velocity_m_s, o.sent.enable) for _, o, _ in ticks]
    rails = {i.rail.t_receive_ns: i.rail for i, _, _ in ticks if i.rail is not None}
    seen = [(t * 1e-9, each.position_m, each.velocity_m_s) for t, each in sorted(rails.items())]
    sent_s, set_points, enabled = np.array(sent, dtype=np.float64).T
    t_s, position_m, velocity_m_s = np.array(seen, dtype=np.float64).T
    return RailMotion(Path("ticks"), sent_s, set_points, enabled > 0, t_s, position_m, velocity_m_s, config)


class Flight(NamedTuple):
    """Result of one flight."""

    motion: RailMotion
    farthest_m: float  # true position of the cart from the middle
    stops: int


def fly(robot: Robot, config: Config, policy: Policy, seconds: float, goals: np.random.Generator | None) -> Flight:
    """Fly goals (or one `run` if None) for a given time, arming again after every stop."""
    body, ticks = robot.make(), list[Tick]()
    daemon = Lockstep(config, policy, record=lambda *tick: ticks.append(tick), body=body)
    stops, outputs = -1, daemon.tick()
    while outputs.t_ns < seconds * 1e9:
        if outputs.mode is not Mode.ARMED:
            stops += 1
            daemon.tick(daemon.request("acknowledge"))
            try:
                outputs = daemon.arm()
            except RuntimeError:
                # The cart is beyond its limits.
                break
        elif outputs.goal.state == "running":
            outputs = daemon.tick()
        elif goals is None:
            outputs = daemon.tick(daemon.request("goal", Goal("run")))
        else:
            y_m, z_m = goals.uniform((-0.4, 0.55), (0.0, 0.75)).tolist()
            outputs = daemon.tick(daemon.request("goal", Goal("reach", y_m, z_m)))
    return Flight(motion(ticks, config), body.farthest_m, max(stops, 0))


def tried(robot: Robot) -> dict[str, Any]:
    """Measure a robot as its owner does, by an excitation and careful flights; patch, attack, return plain values."""
    ramp = robot.ramp_m_s2
    careful = robot.config(latency_s=0.15, braking_m_s2=0.25 * ramp, surge_m_s2=2 * ramp, velocity_max_m_s=0.8)
    played = fly(robot, careful, Excite(EXCITATION), PLAYED_S, None)
    flown = fly(robot, careful, registry.load("reach"), REACH_S, np.random.default_rng(1))
    # Compared with the mildest limits, so that the whole patch comes from the measurement.
    found = findings([played.motion, flown.motion], robot.config(latency_s=0.005))
    attacked = fly(robot, found.patched, Attack(2), ATTACK_S, None)
    seen = found.measured
    bounds = {"latency_s": seen.latency, "braking_m_s2": seen.braking, "surge_m_s2": seen.surge, "drag_m_s": seen.drag}
    return {
        "robot": asdict(robot),
        "measured": {key: None if bound is None else bound._asdict() for key, bound in bounds.items()},
        "farthest_m": attacked.farthest_m,
        "stops": attacked.stops,
    }


@click.command()
@results.json_option
def main(json_file: Path | None) -> None:
    """Print a table with one row per robot.

    \b
    Example:
      python -m validation.limits --json limits.json
    """
    rows = batch.run("measuring, patching, attacking", tried, {str(robot): robot for robot in ROBOTS}).complete()
    results.report("limits", {"rows": list(rows.values())}, json_file)


if __name__ == "__main__":
    main()
