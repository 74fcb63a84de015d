"""State of the current goal, from the observed tip. Pure."""

import math
from collections.abc import Sequence
from dataclasses import replace

from softarm.schemas.config import Goals
from softarm.schemas.goals import Goal, GoalState, GoalStatus


class GoalTracker:
    """Tracker of one goal at a time. A reach goal succeeds once the tip is within the success radius ([P] 4)."""

    def __init__(self, config: Goals) -> None:
        self._config = config
        self._started_ns: int | None = None  # first tick in which the policy acts on the goal
        self._run_s: float | None = None
        self.status = GoalStatus()

    @property
    def running(self) -> Goal | None:
        """Return the running goal, or None."""
        return self.status.goal if self.status.state == "running" else None

    def start(self, goal: Goal, run_s: float | None = None) -> None:
        """Start a goal, which replaces a running one; a run ends after `run_s`, or never."""
        self._run_s = run_s
        self.status = GoalStatus(goal, "running", number=self.status.number + 1)
        self._started_ns = None

    def update(self, tips_m: Sequence[tuple[float, float]], now_ns: int) -> None:
        """Check before the policy acts whether the goal is reached or out of time.

        Args:
            tips_m: Tip positions (y, z) seen since the last update, oldest first. A goal's first update uses only the
                last, since the others precede the goal.
            now_ns: Time of the tick.
        """
        goal = self.running
        if goal is None:
            return
        if self._started_ns is None:
            self._started_ns = now_ns
            tips_m = tips_m[-1:]
        elapsed = (now_ns - self._started_ns) * 1e-9
        self.status = replace(self.status, time_s=elapsed)
        if goal.kind == "run" and self._run_s is not None and elapsed >= self._run_s - 1e-4:
            self.end("reached", None)
        if goal.kind != "reach":
            return
        for y_m, z_m in tips_m:
            distance = math.hypot(y_m - goal.y_m, z_m - goal.z_m)
            closest = distance if self.status.closest_m is None else min(distance, self.status.closest_m)
            self.status = replace(self.status, closest_m=closest)
            if distance < self._config.success_radius_m:
                self.end("reached", None)
                return
        if elapsed >= self._config.time_limit_s - 1e-4:
            self.end("failed", self._why_not())

    def _why_not(self) -> str:
        closest = self.status.closest_m
        came = "the tip was not seen" if closest is None else f"closest distance {closest * 1e3:.0f} mm"
        return (
            f"not reached within {self._config.time_limit_s:.2f} s: {came}, "
            f"required {self._config.success_radius_m * 1e3:.0f} mm"
        )

    def end(self, state: GoalState, reason: str | None) -> None:
        """End a running goal in this state."""
        if self.running is not None:
            self.status = replace(self.status, state=state, reason=reason)
