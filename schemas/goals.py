"""What the arm is asked to do, and how that goes."""

from dataclasses import dataclass
from typing import Literal

GoalKind = Literal["reach", "hold", "run"]
GoalState = Literal["none", "running", "reached", "failed", "cancelled"]


@dataclass(frozen=True, slots=True)
class Goal:
    """A target for the tip, a hold (cart braked, muscle at rest pressure), or a run of a policy that needs no target.

    y and z of a hold and of a run are NaN. A run is `reached` when the policy's own episode is over.
    """

    kind: GoalKind
    y_m: float = float("nan")
    z_m: float = float("nan")


@dataclass(frozen=True, slots=True)
class GoalStatus:
    """The newest goal and how it went."""

    goal: Goal | None = None
    state: GoalState = "none"
    reason: str | None = None  # why it failed or was cancelled
    closest_m: float | None = None  # the tip's closest distance to the target so far
    time_s: float = 0.0  # since the goal was taken up; stands still once it has ended
    number: int = 0  # goals taken up since the daemon started


# The paper's free-space test set: 9 x 6 over y in [-0.4, 0.0], z in [0.55, 0.80]; it trained on z <= 0.70.
TEST_TARGETS = tuple(
    Goal("reach", round(-0.40 + 0.05 * column, 2), round(0.55 + 0.05 * row, 2))
    for row in range(6)
    for column in range(9)
)
TRAINED_Z_MAX_M = 0.70

# The paper's four targets on the shelf, y and z (its section 4.2, where the third is printed with y = +0.48).
SHELF_TARGETS = ((-0.48, 0.60), (-0.48, 0.63), (-0.48, 0.66), (-0.53, 0.63))
