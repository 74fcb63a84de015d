"""Measure the benefit of bridging dropouts of motion capture: policies at the 54 targets with random dropouts.

    python -m benchmarks.bridging --json bridging.json   flights with and without bridging; errors of the estimate
    python -m benchmarks.bridging --fit                  fit the constants of dead_reckoning.py again

Every flight runs the daemon's tick in lockstep with 120 frames a second, on the simulator (noise added) and on the
independent robot. Dropouts are a third of a second to one second apart. Three reactions are compared: the failsafe acts
as soon as a frame is stale, the last pose is held, or the pose is extrapolated. Needs the extra `mujoco`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
from numpy.typing import NDArray

from benchmarks import results
from benchmarks.tables import TABLES
from softarm.common import batch
from softarm.common.batch import Workers, workers_options
from softarm.daemon.control.alignment import ReadingHistory
from softarm.daemon.control.dead_reckoning import DeadReckoning, Readings, Strength, TipModel, TrackedPose
from softarm.daemon.control.plausibility import CART, TIP
from softarm.daemon.control.records import Inputs, Mode, Tick
from softarm.daemon.runtime.offline import Lockstep
from softarm.drivers.bodies.base import Body
from softarm.drivers.bodies.in_process import InProcessMocap, InProcessRobot
from softarm.drivers.bodies.simulated import SimulatedBody
from softarm.evaluation.robots import ROBOTS
from softarm.evaluation.runner import NOWHERE, Swung
from softarm.policies import registry
from softarm.policies.base import Policy
from softarm.schemas.config import Config, Failsafe
from softarm.schemas.flights import CART_STARTS_M, TEST_TARGETS, Swing
from softarm.schemas.messages import MocapFrame, Pose
from softarm.schemas.robot import CONTROL_PERIOD_S

SIMULATOR = "simulator"
BODIES = (SIMULATOR, "nominal", "payload", "later")
DROPOUT_MS = (0, 33, 67, 100, 150, 200, 250)
TRACKED_S = (1 / 3, 1.0)  # between two dropouts
FRAMES = 4  # per tick
NOISE_M = 0.0003  # of the simulator's cameras; the independent robot has noise of its own
HORIZONS = 5  # ticks without a frame
WAYS = {
    "stopped": Failsafe(mocap_bridge_s=0.0),
    "held": Failsafe(mocap_bridge_s=0.0, mocap_stale_s=0.3),
    "bridged": Failsafe(mocap_bridge_s=0.25),
    "default": Failsafe(),
}
METHODS = ("hold", "constant velocity", "model as fitted", "model")
FITTED = 7  # number of fitted constants of TipModel


class Blinking(InProcessMocap):
    """Cameras at 120 Hz with dropouts of `dropout_s` each."""

    def __init__(self, robot: InProcessRobot, seed: int, dropout_s: float, noise_m: float) -> None:
        super().__init__(robot)
        self._rng, self._dropout_s, self._noise_m = np.random.default_rng(seed), dropout_s, noise_m
        self._next_dropout_ns: int | None = None  # None before the first dropout

    def begin(self) -> None:
        """Start the dropouts from now on."""
        if self._dropout_s:
            self._next_dropout_ns = self._robot.now_ns + round(1e9 * self._rng.uniform(0.0, TRACKED_S[1]))

    def read(self, now_ns: int) -> tuple[MocapFrame, ...]:
        """Return the frames since the last call that fall into no dropout."""
        since_ns = self._robot.now_ns
        frames = FRAMES if now_ns > since_ns else 1  # a robot that was placed needs only its current pose
        instants_ns = [since_ns + round(part * (now_ns - since_ns) / frames) for part in range(1, frames + 1)]
        return tuple(
            self._blurred(f) for t_ns in instants_ns for f in super(Blinking, self).read(t_ns) if self._sees(f)
        )

    def _sees(self, frame: MocapFrame) -> bool:
        begins_ns, t_ns = self._next_dropout_ns, frame.t_capture_ns
        if begins_ns is None or t_ns < begins_ns:
            return True
        ends_ns = begins_ns + round(1e9 * self._dropout_s)
        if t_ns < ends_ns:
            return False
        self._next_dropout_ns = ends_ns + round(1e9 * self._rng.uniform(*TRACKED_S))
        return True

    def _blurred(self, frame: MocapFrame) -> MocapFrame:
        if not self._noise_m:
            return frame
        noise_m = self._rng.normal(0.0, self._noise_m, (len(frame.bodies), 2)).tolist()
        bodies = (Pose(p.y_m + dy, p.z_m + dz, p.angle_rad) for p, (dy, dz) in zip(frame.bodies, noise_m, strict=True))
        return replace(frame, bodies=tuple(bodies))


class Job(NamedTuple):
    """Flights of one kind."""

    policy: str
    body: str
    dropout_ms: int
    way: str


def begun(
    policy: Policy, body: str, cart_start_m: float, seed: int, dropout_s: float = 0.0, way: str = "default"
) -> tuple[Lockstep, list[Tick]]:
    """Return an armed daemon whose cameras have dropouts, and its recorder."""
    ticks: list[Tick] = []
    config = Config(failsafe=WAYS[way])
    robot: Body
    if body == SIMULATOR:
        robot = SimulatedBody()
    else:
        from softarm.drivers.bodies.independent import IndependentBody

        robot = IndependentBody(ROBOTS[body], seed, cart_position_m=cart_start_m)
    daemon = Lockstep(config, policy, record=lambda *tick: ticks.append(tick), body=robot)
    cameras = daemon.robot.mocap = Blinking(daemon.robot, seed, dropout_s, NOISE_M if body == SIMULATOR else 0.0)
    daemon.arm()
    if body == SIMULATOR:
        daemon.place(cart_start_m)
    cameras.begin()
    return daemon, ticks


def fly(job: Job) -> dict[str, int]:
    """Fly all targets, each from one of the three starts; count the flights, the reached and those that stopped."""
    reached = stopped = 0
    policy = registry.load(job.policy)
    for number, goal in enumerate(TEST_TARGETS):
        start_m = CART_STARTS_M[number % len(CART_STARTS_M)]
        daemon, _ = begun(policy, job.body, start_m, number, job.dropout_ms * 1e-3, job.way)
        reached += daemon.pursue(goal).reached
        stopped += daemon.outputs is not None and daemon.outputs.mode is not Mode.ARMED
    return {"flights": len(TEST_TARGETS), "reached": reached, "stopped": stopped}


class Window(NamedTuple):
    """Last tracked pose, the readings from then on, and the true cart and tip at the following ticks."""

    before: TrackedPose
    seen: TrackedPose
    axis: ReadingHistory
    pressure: ReadingHistory
    strength: float  # estimated from the second before
    then: tuple[TrackedPose, ...]


def swings(body: str, seed: int = 0) -> Iterator[list[Inputs]]:
    """Yield the ticks of flights without dropouts: learned swings and sinusoids."""
    for policy in ("reach", "reach-wide"):
        for number in range(seed, len(TEST_TARGETS), 6):
            daemon, ticks = begun(registry.load(policy), body, CART_STARTS_M[number % 3], number)
            daemon.pursue(TEST_TARGETS[number])
            yield _armed(ticks)
    for number in range(4):
        daemon, ticks = begun(Swung(registry.load("reach"), Swing.draw(seed + number)), body, 0.0, number)
        daemon.tick(daemon.request("goal", NOWHERE))
        for _ in range(90):
            daemon.tick()
        yield _armed(ticks)


def _armed(ticks: Sequence[Tick]) -> list[Inputs]:
    return [inputs for inputs, outputs, _ in ticks if outputs.mode is Mode.ARMED]


def windows(ticks: Sequence[Inputs], every: int = 2) -> Iterator[Window]:
    """Cut a flight into windows, one every `every` ticks."""
    axis, pressure = ReadingHistory(), ReadingHistory()
    strength = Strength()
    for number, tick in enumerate(ticks[: -HORIZONS or None]):
        _read(tick, axis, pressure)
        frames = [frame for each in ticks[max(number - 3, 0) : number + 1] for frame in each.mocap]
        *earlier, seen = map(_tracked_pose, frames)
        strength.update(seen, Readings(axis, pressure, 0))
        then = ticks[number + 1 : number + HORIZONS + 1]
        if number < 3 or number % every or not all(each.mocap for each in then):
            continue
        before = min(earlier, key=lambda one: abs(seen.t_ns - one.t_ns - 1e9 * CONTROL_PERIOD_S))
        read = ReadingHistory(), ReadingHistory()
        for each in ticks[number - 3 : number + HORIZONS + 1]:
            _read(each, *read)
        yield Window(before, seen, *read, strength.value, tuple(_tracked_pose(each.mocap[-1]) for each in then))


def _read(tick: Inputs, axis: ReadingHistory, pressure: ReadingHistory) -> None:
    assert tick.rail is not None
    assert tick.pressure is not None
    axis.add(tick.rail.t_receive_ns, tick.rail.position_m, tick.rail.velocity_m_s)
    pressure.add(tick.pressure.t_receive_ns, tick.pressure.pressure_kpa)


def _tracked_pose(frame: MocapFrame) -> TrackedPose:
    cart, tip = frame.bodies[CART], frame.bodies[TIP]
    return TrackedPose(frame.t_capture_ns, cart.y_m, tip.y_m, tip.z_m)


def off_m(window: Window, method: str, model: TipModel | None = None) -> list[tuple[float, float]]:
    """Return the error of the tip (y, z) in m at the following ticks."""
    seen, before = window.seen, window.before
    strength = window.strength if method == "model" else 1.0
    reckoning = DeadReckoning(before, seen, Readings(window.axis, window.pressure, 0), strength, model)
    off = []
    for then in window.then:
        if method.startswith("model"):
            guess = reckoning.at(then.t_ns) or seen
        else:
            share = (then.t_ns - seen.t_ns) / (seen.t_ns - before.t_ns) if method != "hold" else 0.0
            y_m, z_m = (new + share * (new - old) for new, old in zip(seen[2:], before[2:], strict=True))
            guess = seen._replace(tip_y_m=y_m, tip_z_m=z_m)
        off.append((guess.tip_y_m - then.tip_y_m, guess.tip_z_m - then.tip_z_m))
    return off


def errors(body: str) -> dict[str, list[float]]:
    """Return method -> RMS error of the tip in m after one tick without a frame, two, and so on."""
    cut = [window for ticks in swings(body, seed=3) for window in windows(ticks)]
    return {
        method: np.sqrt(np.square([off_m(each, method) for each in cut]).sum(axis=2).mean(axis=0)).tolist()
        for method in METHODS
    }


def fit() -> TipModel:
    """Fit the model's constants to swings of the simulator, with errors up to each tick, robust against outliers."""
    from scipy.optimize import least_squares

    cut = [window for ticks in swings(SIMULATOR) for window in windows(ticks, every=3)]

    def left(numbers: NDArray[np.float64]) -> NDArray[np.float64]:
        model = TipModel(*numbers.tolist())
        return 100 * np.array([off_m(each, "model as fitted", model) for each in cut]).ravel()

    found = least_squares(left, TipModel()[:FITTED], loss="soft_l1", x_scale=np.abs(TipModel()[:FITTED]))
    return TipModel(*found.x.tolist())


@click.command()
@click.option("--fit", "fitting", is_flag=True, help="Print the model's numbers, fitted to the simulator, and end.")
@click.option("--body", "bodies", multiple=True, default=BODIES, show_default=True, help="Again for more.")
@workers_options()
@results.json_option
def main(fitting: bool, bodies: Sequence[str], workers: Workers, json_file: Path | None) -> None:
    """Print the results of flights with dropouts for each reaction, and the errors of the estimated tip.

    \b
    Example:
      python -m benchmarks.bridging --body simulator --json bridging.json
    """
    if fitting:
        for name, number in fit()._asdict().items():
            click.echo(f"{name}: {number:.4g}")
        return
    todo = [Job("reach", body, ms, way) for body in bodies for ms in DROPOUT_MS for way in WAYS]
    found = batch.run("flying", fly, {str(job): job for job in todo}, workers).complete()
    flights = [job._asdict() | found[str(job)] for job in todo]
    figures = {"flights": flights, "tip_rms_m": {body: errors(body) for body in bodies}}
    results.report("bridging", figures, json_file)
    click.echo(TABLES["estimates"](lambda _: figures))


if __name__ == "__main__":
    main()
