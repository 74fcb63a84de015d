"""How a policy is flown at each test: one truth a trial, the same trials for every policy, the daemon's own tick."""

import math

import numpy as np

from benchmarks.held_back import Flight
from daemon.evaluation import CART_STARTS_M, LIMIT_M
from daemon.offline import Lockstep
from policies.base import Array, Policy
from reality.parameters import Parameters
from reality.robot import Robot
from schemas.config import Config
from schemas.goals import SHELF_TARGETS, TEST_TARGETS, Goal
from schemas.model import Model

BOARD_BELOW_M = 0.005  # from a shelf's target down to its lower board ([C], as training.shelf)
SHELF_Y_M, SHELF_Z_M, SHELF_DEPTH_M = (-0.48, -0.40), (0.58, 0.67), (-0.05, 0.20)  # [P] section 4.2
SHELF_CART_M = (-0.025, 0.24)
RANDOM_TRIALS = 500
SWING_S = (0.5, 2.5)  # for how long the arm was swung before the goal comes
SWING_CART_M = 0.2


class Swung(Policy):
    """A policy that is swung about first: until its second goal, smooth random commands stand for it."""

    def __init__(self, policy: Policy, seed: int) -> None:
        self.spec = policy.spec
        self._policy, self._goals, self._step = policy, 0, 0
        rng = np.random.default_rng(seed)
        self.ticks = int(30 * rng.uniform(*SWING_S))
        self.cart_start_m = float(rng.uniform(-SWING_CART_M, SWING_CART_M))
        self._rate, self._phase = rng.uniform(0.4, 1.2, 2), rng.uniform(0.0, 2.0 * math.pi, 2)

    def reset(self) -> None:
        """Before each goal: the first one swings."""
        self._goals += 1
        if self._goals > 1:
            self._policy.reset()

    def step(self, observation: Array, goal: Array) -> Array:
        """Sinusoids, or what the policy wants."""
        if self._goals > 1:
            return self._policy.step(observation, goal)
        wave = np.sin(2.0 * math.pi * self._rate * self._step / 30.0 + self._phase)
        self._step += 1
        return np.array((0.6 * wave[0], 9.0 + 8.0 * wave[1]), dtype=np.float32)


def fly_grid(policy: Policy, model: Model | None = None) -> list[bool]:
    """The 54 targets from three cart starts at rest, target by target."""
    daemon = Lockstep(Config(), policy, model)
    return [_reached(daemon, goal, start) for goal in TEST_TARGETS for start in CART_STARTS_M]


def fly_swinging(policy: Policy, model: Model | None = None) -> list[bool]:
    """The 54 targets, three times each, from wherever a swung arm happens to be."""
    reached = []
    for number in range(len(TEST_TARGETS) * len(CART_STARTS_M)):
        swung = Swung(policy, number)
        daemon = Lockstep(Config(), swung, model)
        daemon.arm()
        daemon.place(swung.cart_start_m)
        outputs = daemon.tick(daemon.request("goal", Goal("reach", 0.0, 0.9)))  # which no arm reaches
        for _ in range(swung.ticks):
            outputs = daemon.tick()
        farthest = 0.0
        outputs = daemon.tick(daemon.request("goal", TEST_TARGETS[number // len(CART_STARTS_M)]))
        while outputs.goal.state == "running":
            outputs = daemon.tick()
            farthest = max(farthest, abs(float(daemon.robot.simulator.cart_position_m[0])))
        reached.append(outputs.goal.state == "reached" and farthest <= LIMIT_M)
    return reached


def shelf_trials() -> list[tuple[Goal, float, float]]:
    """Goal, depth and cart start of the paper's twelve; its targets lie in the middle of the trained depths."""
    depth = sum(SHELF_DEPTH_M) / 2
    return [(Goal("reach", y, z), depth, start) for y, z in SHELF_TARGETS for start in CART_STARTS_M]


def random_shelf_trials() -> list[tuple[Goal, float, float]]:
    """The same of random trials of the training range."""
    rng = np.random.default_rng(500)
    draws = zip(*(rng.uniform(*ends, RANDOM_TRIALS) for ends in _SHELF_RANGES), strict=True)
    return [(Goal("reach", float(y), float(z)), float(depth), float(start)) for y, z, depth, start in draws]


_SHELF_RANGES = (SHELF_Y_M, SHELF_Z_M, SHELF_DEPTH_M, SHELF_CART_M)


def fly_shelf(policy: Policy, model: Model | None, trials: list[tuple[Goal, float, float]]) -> list[bool]:
    """Swing into a shelf that stands anew in every trial; a policy that asks for the depth is told."""
    daemon, reached = Lockstep(Config(), policy, model), []
    daemon.arm()
    for goal, depth, start in trials:
        daemon.robot.simulator.place_shelf(goal.y_m + depth, goal.z_m - BOARD_BELOW_M)
        _tell_depth(policy, depth)
        reached.append(_reached(daemon, goal, start))
    return reached


def fly_held_back(policy: Policy, parameters: Parameters) -> list[bool]:
    """The 54 targets from three starts on the independent robot."""
    trials = [(goal, start) for goal in TEST_TARGETS for start in CART_STARTS_M]
    return [
        Flight(policy, Robot(parameters, k // len(CART_STARTS_M), cart_position_m=start, hanging=True)).reach(goal)
        for k, (goal, start) in enumerate(trials)
    ]


def fly_held_back_shelf(policy: Policy) -> list[bool]:
    """The paper's twelve trials at the shelf of the independent robot."""
    reached = []
    for number, (goal, depth, start) in enumerate(shelf_trials()):
        _tell_depth(policy, depth)
        shelf = (goal.y_m + depth, goal.z_m - BOARD_BELOW_M)
        robot = Robot(Parameters(), number, cart_position_m=start, hanging=True, shelf_m=shelf)
        reached.append(Flight(policy, robot).reach(goal))
    return reached


def _reached(daemon: Lockstep, goal: Goal, start_m: float) -> bool:
    flight = daemon.fly(goal, start_m)
    return flight.status.state == "reached" and flight.max_cart_m <= LIMIT_M


def _tell_depth(policy: Policy, depth_m: float) -> None:
    if hasattr(policy, "target_depth_m"):
        policy.target_depth_m = depth_m
