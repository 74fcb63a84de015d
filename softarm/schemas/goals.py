"""Goals of the arm and their progress."""

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
    """The newest goal and its progress."""

    goal: Goal | None = None
    state: GoalState = "none"
    reason: str | None = None  # why it failed or was cancelled
    closest_m: float | None = None  # the tip's closest distance to the target so far
    time_s: float = 0.0  # since the goal was accepted; constant after its end
    number: int = 0  # goals accepted since the daemon started
