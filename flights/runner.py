"""The trials of every test and how a policy is flown at them: by the daemon's own tick, the same for every policy."""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from softarm.daemon.control.records import Mode
from softarm.daemon.shell.offline import Lockstep
from softarm.drivers.bodies.simulated import SimulatedBody
from softarm.flights.evaluation import CART_STARTS_M
from softarm.policies.base import Array, Policy, PolicyError
from softarm.reality.parameters import RobotParameters
from softarm.schemas.config import Config
from softarm.schemas.goals import SHELF_TARGETS, TEST_TARGETS, Goal
from softarm.schemas.model import Model
from softarm.schemas.robot import CONTROL_RATE_HZ

BOARD_BELOW_M = 0.005  # from a shelf's target down to its lower board ([C], as training.shelf)
SHELF_Y_M, SHELF_Z_M, SHELF_DEPTH_M = (-0.48, -0.40), (0.58, 0.67), (-0.05, 0.20)  # [P] section 4.2
SHELF_CART_M = (-0.025, 0.24)
MIDDLE_M = sum(SHELF_DEPTH_M) / 2
RANDOM_TRIALS = 500
SWING_S = (0.5, 2.5)  # for how long the arm was swung before the goal comes
SWING_CART_M = 0.2
NOWHERE = Goal("reach", 0.0, 0.9)  # which no arm reaches


class Trial(NamedTuple):
    """One flight to be flown."""

    goal: Goal
    cart_start_m: float
    seed: int = 0  # of the swing before it, or of the independent robot's sensors
    depth_m: float | None = None  # the target's, behind the front edge of a shelf; None: there is no shelf

    @property
    def shelf_m(self) -> tuple[float, float] | None:
        """y of the shelf's front edge and z of its lower board."""
        return None if self.depth_m is None else (self.goal.y_m + self.depth_m, self.goal.z_m - BOARD_BELOW_M)


class Outcome(NamedTuple):
    """What came of a trial."""

    reached: bool
    refusal: str | None = None  # the policy's words when it had no answer; such a trial is not reached


def grid_trials(targets: Sequence[Goal] = TEST_TARGETS) -> list[Trial]:
    """Targets from three cart starts at rest, target by target."""
    return [Trial(goal, start, TEST_TARGETS.index(goal)) for goal in targets for start in CART_STARTS_M]


def swinging_trials() -> list[Trial]:
    """The 54 targets, three times each, from wherever a swung arm happens to be."""
    goals = [goal for goal in TEST_TARGETS for _ in CART_STARTS_M]
    return [Trial(goal, Swing.draw(number).cart_start_m, number) for number, goal in enumerate(goals)]


def shelf_trials() -> list[Trial]:
    """The paper's twelve; its targets lie in the middle of the trained depths."""
    pairs = [(Goal("reach", y, z), start) for y, z in SHELF_TARGETS for start in CART_STARTS_M]
    return [Trial(goal, start, number, MIDDLE_M) for number, (goal, start) in enumerate(pairs)]


def random_shelf_trials() -> list[Trial]:
    """Random ones of the shelf's training range."""
    rng = np.random.default_rng(500)
    ranges = (SHELF_Y_M, SHELF_Z_M, SHELF_DEPTH_M, SHELF_CART_M)
    draws = zip(*(rng.uniform(*ends, RANDOM_TRIALS).tolist() for ends in ranges), strict=True)
    return [Trial(Goal("reach", y, z), start, depth_m=depth) for y, z, depth, start in draws]


class Heard(Policy):
    """A policy whose refusals are kept: the daemon makes them a fault and stops the arm."""

    def __init__(self, policy: Policy) -> None:
        self.spec = policy.spec
        self.refusal: str | None = None
        self._policy = policy

    def reset(self) -> None:
        """See Policy."""
        self._policy.reset()

    def step(self, observation: Array, goal: Array) -> Array:
        """What the policy wants. Raises what it raises."""
        try:
            return self._policy.step(observation, goal)
        except PolicyError as error:
            self.refusal = str(error)
            raise


class Swing(NamedTuple):
    """How an arm is swung about before its goal comes."""

    ticks: int
    cart_start_m: float
    rate_hz: NDArray[np.float64]  # of the cart's command and the muscle's
    phase_rad: NDArray[np.float64]

    @classmethod
    def draw(cls, seed: int) -> Self:
        """The same from the same seed."""
        rng = np.random.default_rng(seed)
        ticks, start = int(30 * rng.uniform(*SWING_S)), float(rng.uniform(-SWING_CART_M, SWING_CART_M))
        return cls(ticks, start, rng.uniform(0.4, 1.2, 2), rng.uniform(0.0, 2.0 * math.pi, 2))


class Swung(Policy):
    """A policy that is swung about first: until its second goal, smooth commands stand for it."""

    def __init__(self, policy: Policy, swing: Swing) -> None:
        self.spec = policy.spec
        self._policy, self._swing = policy, swing
        self._goals = self._step = 0

    def reset(self) -> None:
        """Before each goal: the first one swings."""
        self._goals += 1
        if self._goals > 1:
            self._policy.reset()

    def step(self, observation: Array, goal: Array) -> Array:
        """Sinusoids, or what the policy wants."""
        if self._goals > 1:
            return self._policy.step(observation, goal)
        wave = np.sin(2.0 * math.pi * self._swing.rate_hz * self._step / CONTROL_RATE_HZ + self._swing.phase_rad)
        self._step += 1
        return np.array((0.6 * wave[0], 9.0 + 8.0 * wave[1]), dtype=np.float32)


def fly(policy: Policy, model: Model | None, trials: Iterable[Trial]) -> list[Outcome]:
    """From rest on the simulated robot; a policy that asks for a shelf's depth is told."""
    heard, outcomes = Heard(policy), []
    body, daemon = _armed(heard, model)
    for trial in trials:
        if daemon.outputs is None or daemon.outputs.mode is not Mode.ARMED:  # the last one was stopped
            body, daemon = _armed(heard, model)
        heard.refusal = None
        if trial.shelf_m is not None:
            body.simulator.place_shelf(*trial.shelf_m)
        _tell_depth(policy, trial)
        reached = daemon.fly(trial.goal, trial.cart_start_m).reached
        outcomes.append(Outcome(reached, heard.refusal))
    return outcomes


def fly_swinging(policy: Policy, model: Model | None, trials: Iterable[Trial]) -> list[Outcome]:
    """On the simulated robot, the goal coming while the arm is being swung."""
    outcomes = []
    for trial in trials:
        heard = Heard(policy)
        _tell_depth(policy, trial)
        reached = swing(heard, model, trial).pursue(trial.goal).reached
        outcomes.append(Outcome(reached, heard.refusal))
    return outcomes


def swing(policy: Policy, model: Model | None, trial: Trial) -> Lockstep:
    """Swing the arm until the trial's goal is due; it is the policy's first."""
    drawn = Swing.draw(trial.seed)
    daemon = Lockstep(Config(), Swung(policy, drawn), model)
    daemon.arm()
    daemon.place(trial.cart_start_m)
    daemon.tick(daemon.request("goal", NOWHERE))
    for _ in range(drawn.ticks):
        daemon.tick()
    return daemon


def fly_held_back(policy: Policy, parameters: RobotParameters, trials: Iterable[Trial]) -> list[Outcome]:
    """From rest on an independent robot, a new one for each trial. Needs the extra `mujoco`."""
    from softarm.drivers.bodies.independent import IndependentBody

    outcomes = []
    for trial in trials:
        heard = Heard(policy)
        _tell_depth(policy, trial)
        body = IndependentBody(parameters, trial.seed, cart_position_m=trial.cart_start_m, shelf_m=trial.shelf_m)
        daemon = Lockstep(Config(), heard, body=body)
        daemon.arm()
        outcomes.append(Outcome(daemon.pursue(trial.goal).reached, heard.refusal))
    return outcomes


def _armed(policy: Policy, model: Model | None) -> tuple[SimulatedBody, Lockstep]:
    body = SimulatedBody(model)
    daemon = Lockstep(Config(), policy, body=body)
    daemon.arm()
    return body, daemon


def _tell_depth(policy: Policy, trial: Trial) -> None:
    if hasattr(policy, "target_depth_m"):
        policy.target_depth_m = MIDDLE_M if trial.depth_m is None else trial.depth_m
