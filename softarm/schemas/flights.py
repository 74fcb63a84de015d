"""Flights: scenarios, their results and the criterion of success.

[P]: the paper; [C]: its authors' configuration. `softarm/evaluation/` runs flights with the daemon's own tick, and
`training/learn/validation.py` runs many at once on the simulator.
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
# ranges that it trained on. A depth is the distance of a target behind the shelf's front edge; negative: before it.
SHELF_TARGETS = tuple(Goal("reach", y, z) for y, z in ((-0.48, 0.60), (-0.48, 0.63), (-0.48, 0.66), (-0.53, 0.63)))
SHELF_Y_M, SHELF_Z_M, SHELF_DEPTH_M = (-0.48, -0.40), (0.58, 0.67), (-0.05, 0.20)
SHELF_MIDDLE_M = sum(SHELF_DEPTH_M) / 2  # where the four targets lie: the paper does not say where its shelf stood
SHELF_CART_M = (-0.025, 0.24)
BOARD_BELOW_M = 0.005  # from a shelf's target down to its lower board [C]

SWING_S = (0.5, 2.5)  # duration of the swing before a goal begins
SWING_CART_M = 0.2


class Swing(NamedTuple):
    """Motion before a goal begins: sinusoidal commands of cart and muscle."""

    ticks: int
    cart_start_m: float
    rate_hz: tuple[float, float]
    phase_rad: tuple[float, float]

    @classmethod
    def draw(cls, seed: int) -> Self:
        """Draw a swing; the same seed gives the same swing."""
        rng = np.random.default_rng(seed)
        ticks, start = int(CONTROL_RATE_HZ * rng.uniform(*SWING_S)), float(rng.uniform(-SWING_CART_M, SWING_CART_M))
        (cart_hz, muscle_hz), (cart_rad, muscle_rad) = rng.uniform(0.4, 1.2, 2), rng.uniform(0.0, 2.0 * math.pi, 2)
        return cls(ticks, start, (float(cart_hz), float(muscle_hz)), (float(cart_rad), float(muscle_rad)))

    def command(self, tick: int) -> NDArray[np.float32]:
        """Return cart velocity (m/s) and pressure (kPa) at a tick, as an array of two."""
        wave = np.sin(2.0 * math.pi * np.array(self.rate_hz) * tick / CONTROL_RATE_HZ + self.phase_rad)
        return np.array((0.6 * wave[0], 9.0 + 8.0 * wave[1]), dtype=np.float32)


class Scenario(NamedTuple):
    """One flight to run: a goal and the initial state of the robot."""

    goal: Goal
    cart_start_m: float
    seed: int = 0  # of the independent robot's sensors
    depth_m: float | None = None  # distance of the target behind a shelf's front edge; None: no shelf
    swing: Swing | None = None  # None: the arm hangs straight and at rest

    @property
    def shelf_m(self) -> tuple[float, float] | None:
        """Return y of the shelf's front edge and z of its lower board, m, or None without a shelf."""
        return None if self.depth_m is None else (self.goal.y_m + self.depth_m, self.goal.z_m - BOARD_BELOW_M)


def grid(targets: Sequence[Goal] = TEST_TARGETS) -> list[Scenario]:
    """Return scenarios of each target from three cart starts at rest, target by target."""
    return [Scenario(goal, start, TEST_TARGETS.index(goal)) for goal in targets for start in CART_STARTS_M]


def swinging() -> list[Scenario]:
    """Return scenarios of the 54 targets, three times each, that begin with a swinging arm."""
    goals = [goal for goal in TEST_TARGETS for _ in CART_STARTS_M]
    swings = [Swing.draw(number) for number in range(len(goals))]
    pairs = enumerate(zip(goals, swings, strict=True))
    return [Scenario(goal, swing.cart_start_m, number, swing=swing) for number, (goal, swing) in pairs]


def shelf() -> list[Scenario]:
    """Return the paper's twelve: four targets from three cart starts, in the middle of the trained depths."""
    pairs = enumerate((goal, start) for goal in SHELF_TARGETS for start in CART_STARTS_M)
    return [Scenario(goal, start, number, SHELF_MIDDLE_M) for number, (goal, start) in pairs]


def random_shelf() -> list[Scenario]:
    """Return 500 random scenarios of the shelf's training range; every call returns the same ones."""
    rng = np.random.default_rng(500)
    ranges = (SHELF_Y_M, SHELF_Z_M, SHELF_DEPTH_M, SHELF_CART_M)
    draws = zip(*(rng.uniform(*ends, 500).tolist() for ends in ranges), strict=True)
    return [Scenario(Goal("reach", y, z), start, depth_m=depth) for y, z, depth, start in draws]


@dataclass(frozen=True, slots=True)
class Flight:
    """Result of a goal, from its start to its end."""

    status: GoalStatus
    max_tip_z_m: float
    max_cart_m: float  # largest true distance from the middle of the rail
    ticks: int
    refusal: str | None = None  # the policy's message if it failed; such a flight is not reached
    stop: str | None = None  # reason of an unrequested stop during the flight; such a flight is not reached

    @property
    def reached(self) -> bool:
        """Return whether the flight counts as a success."""
        return counts(self.status.state == "reached", self.max_cart_m)


def counts(reached: bool, max_cart_m: float) -> bool:
    """Return whether the target was reached and the cart stayed within the rail's limit until then [P]."""
    return reached and max_cart_m <= RAIL_LIMIT_M


class Shares(NamedTuple):
    """Success shares of flights, by the height of their targets."""

    in_range: float  # of the seed's training range, z <= 0.70 m; NaN without such targets
    above: float
    all: float

    @property
    def sentence(self) -> str:
        """Return the shares as a sentence."""
        return f"{self.in_range:.1%} in range, {self.above:.1%} above, {self.all:.1%} in all"


def in_range(z_m: ArrayLike) -> NDArray[np.bool_]:
    """Return whether targets lie within the trained heights, with a tolerance for float32 rounding."""
    return np.asarray(z_m) <= TRAINED_Z_MAX_M + 1e-4


def shares(reached: ArrayLike, z_m: ArrayLike) -> Shares:
    """Return the success shares of flights.

    Args:
        reached: whether each flight succeeded, [F].
        z_m: heights of the targets, [F].

    Raises:
        ValueError: if the lengths differ or there are no flights.
    """
    hits, low = np.asarray(reached, dtype=np.bool_), in_range(z_m)
    if hits.shape != low.shape or hits.size == 0:
        raise ValueError(
            f"{hits.size} flights and {low.size} targets: give one target height a flight, and at least one flight"
        )
    inside, above = (float(hits[which].mean()) if which.any() else math.nan for which in (low, ~low))
    return Shares(inside, above, float(hits.mean()))


def heights(scenarios: Iterable[Scenario]) -> NDArray[np.float64]:
    """Return the heights of the targets, m, [F]."""
    return np.array([scenario.goal.z_m for scenario in scenarios])
