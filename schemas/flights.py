"""Flights: what is flown, from where to where, and when it counts.

[P]: the paper; [C]: its authors' configuration. Nothing here flies: `flights/` does, by the daemon's own tick, and
`training/run/validation.py`, many at once on the simulator.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softarm.schemas.goals import Goal, GoalStatus
from softarm.schemas.robot import CONTROL_RATE_HZ, RAIL_LIMIT_M

# The paper's free-space test set: 9 x 6 over y in [-0.4, 0.0], z in [0.55, 0.80]; it trained on z <= 0.70.
TEST_TARGETS = tuple(
    Goal("reach", round(-0.40 + 0.05 * column, 2), round(0.55 + 0.05 * row, 2))
    for row in range(6)
    for column in range(9)
)
TRAINED_Z_MAX_M = 0.70
CART_STARTS_M = (0.0, 0.1, 0.2)

# The paper's four targets on the shelf, y and z (its section 4.2, where the third is printed with y = +0.48), and the
# ranges that it trained on; depths are a target's behind the shelf's front edge, before it below zero.
SHELF_TARGETS = tuple(Goal("reach", y, z) for y, z in ((-0.48, 0.60), (-0.48, 0.63), (-0.48, 0.66), (-0.53, 0.63)))
SHELF_Y_M, SHELF_Z_M, SHELF_DEPTH_M = (-0.48, -0.40), (0.58, 0.67), (-0.05, 0.20)
SHELF_MIDDLE_M = sum(SHELF_DEPTH_M) / 2  # where the four targets lie: the paper does not say where its shelf stood
SHELF_CART_M = (-0.025, 0.24)
BOARD_BELOW_M = 0.005  # from a shelf's target down to its lower board [C]

SWING_S = (0.5, 2.5)  # for how long an arm is swung before its goal comes
SWING_CART_M = 0.2


class Swing(NamedTuple):
    """How an arm is swung about before its goal comes: sinusoids of the cart's command and the muscle's."""

    ticks: int
    cart_start_m: float
    rate_hz: tuple[float, float]
    phase_rad: tuple[float, float]

    @classmethod
    def draw(cls, seed: int) -> Self:
        """The same from the same seed."""
        rng = np.random.default_rng(seed)
        ticks, start = int(CONTROL_RATE_HZ * rng.uniform(*SWING_S)), float(rng.uniform(-SWING_CART_M, SWING_CART_M))
        (cart_hz, muscle_hz), (cart_rad, muscle_rad) = rng.uniform(0.4, 1.2, 2), rng.uniform(0.0, 2.0 * math.pi, 2)
        return cls(ticks, start, (float(cart_hz), float(muscle_hz)), (float(cart_rad), float(muscle_rad)))

    def command(self, tick: int) -> NDArray[np.float32]:
        """Cart velocity (m/s) and pressure (kPa) at a tick."""
        wave = np.sin(2.0 * math.pi * np.array(self.rate_hz) * tick / CONTROL_RATE_HZ + self.phase_rad)
        return np.array((0.6 * wave[0], 9.0 + 8.0 * wave[1]), dtype=np.float32)


class Scenario(NamedTuple):
    """What is flown: a goal, and where and how it finds the robot."""

    goal: Goal
    cart_start_m: float
    seed: int = 0  # of the independent robot's sensors
    depth_m: float | None = None  # the target's, behind the front edge of a shelf; None: there is no shelf
    swing: Swing | None = None  # None: the arm hangs straight and at rest

    @property
    def shelf_m(self) -> tuple[float, float] | None:
        """y of the shelf's front edge and z of its lower board."""
        return None if self.depth_m is None else (self.goal.y_m + self.depth_m, self.goal.z_m - BOARD_BELOW_M)


def grid(targets: Sequence[Goal] = TEST_TARGETS) -> list[Scenario]:
    """Targets from three cart starts at rest, target by target."""
    return [Scenario(goal, start, TEST_TARGETS.index(goal)) for goal in targets for start in CART_STARTS_M]


def swinging() -> list[Scenario]:
    """The 54 targets, three times each, from wherever a swung arm happens to be."""
    goals = [goal for goal in TEST_TARGETS for _ in CART_STARTS_M]
    swings = [Swing.draw(number) for number in range(len(goals))]
    pairs = enumerate(zip(goals, swings, strict=True))
    return [Scenario(goal, swing.cart_start_m, number, swing=swing) for number, (goal, swing) in pairs]


def shelf() -> list[Scenario]:
    """The paper's twelve: four targets from three cart starts, in the middle of the trained depths."""
    pairs = enumerate((goal, start) for goal in SHELF_TARGETS for start in CART_STARTS_M)
    return [Scenario(goal, start, number, SHELF_MIDDLE_M) for number, (goal, start) in pairs]


def random_shelf(count: int = 500) -> list[Scenario]:
    """Random ones of the shelf's training range; the same ones every time."""
    rng = np.random.default_rng(500)
    ranges = (SHELF_Y_M, SHELF_Z_M, SHELF_DEPTH_M, SHELF_CART_M)
    draws = zip(*(rng.uniform(*ends, count).tolist() for ends in ranges), strict=True)
    return [Scenario(Goal("reach", y, z), start, depth_m=depth) for y, z, depth, start in draws]


@dataclass(frozen=True, slots=True)
class Flight:
    """What came of a goal, from being taken up to its end."""

    status: GoalStatus
    max_tip_z_m: float
    max_cart_m: float  # farthest from the middle of the rail, truly
    ticks: int
    refusal: str | None = None  # the policy's words when it had no answer; such a flight is not reached
    stop: str | None = None  # why the arm stopped meanwhile, which nobody had asked for; not reached either

    @property
    def reached(self) -> bool:
        """Whether it counts."""
        return counts(self.status.state == "reached", self.max_cart_m)


def counts(reached: bool, max_cart_m: float) -> bool:
    """The criterion of success: the target was reached, and the cart stayed within the rail's limit until then [P]."""
    return reached and max_cart_m <= RAIL_LIMIT_M


class Shares(NamedTuple):
    """Of some flights, the shares that reached their targets, by where those lie."""

    in_range: float  # of the seed's training range, z <= 0.70 m; NaN without such targets
    above: float
    all: float

    @property
    def sentence(self) -> str:
        """For people."""
        return f"{self.in_range:.1%} in range, {self.above:.1%} above, {self.all:.1%} in all"


def in_range(z_m: ArrayLike) -> NDArray[np.bool_]:
    """Whether targets lie in the height that the seed was trained on; float32's rounding is forgiven."""
    return np.asarray(z_m) <= TRAINED_Z_MAX_M + 1e-4


def shares(reached: ArrayLike, z_m: ArrayLike) -> Shares:
    """Shares of flights [F] whose targets lie at heights z_m [F]. Raises ValueError for none at all."""
    hits, low = np.asarray(reached, dtype=np.bool_), in_range(z_m)
    if hits.shape != low.shape or hits.size == 0:
        raise ValueError(f"{hits.size} flights to {low.size} targets: give a target's height for each of some flights")
    inside, above = (float(hits[which].mean()) if which.any() else math.nan for which in (low, ~low))
    return Shares(inside, above, float(hits.mean()))


def heights(scenarios: Iterable[Scenario]) -> NDArray[np.float64]:
    """Heights of the targets, m, [F]."""
    return np.array([scenario.goal.z_m for scenario in scenarios])
