"""A population of plans that is flown, sorted and bred, round by round. No clock, no I/O."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softarm.policies.mppi import plans
from softarm.policies.mppi.cost import Cost
from softarm.schemas.model import Model
from softarm.schemas.policy import ACTION

if TYPE_CHECKING:
    from softarm.simulator.simulator import Simulator

Array = NDArray[np.float32]

PHYSICS_HZ = 120.0  # the error of a plan's end, some mm, is the next tick's to correct
KEPT_SHARE = 1 / 8  # of a round's plans, those that breed the next
FRESH_SHARE = 1 / 8  # of a tick's first round, those that nothing suggests
LOW = np.array([signal.low for signal in ACTION], dtype=np.float32)
HIGH = np.array([signal.high for signal in ACTION], dtype=np.float32)
CENTRE, HALF = np.float32(0.5) * (HIGH + LOW), np.float32(0.5) * (HIGH - LOW)


class Planner:
    """Plans of `steps` commands a `period_s` apart for the robot of `model`; `rollouts` of them are flown a round."""

    def __init__(self, model: Model, rollouts: int, steps: int, period_s: float, cost: Cost | None = None) -> None:
        from softarm.simulator.simulator import Simulator  # numba, which only those who fly this policy need

        self._simulator: Simulator = Simulator(model, robots=rollouts, physics_rate_hz=PHYSICS_HZ)
        self._rollouts, self._steps, self._period_s = rollouts, steps, period_s
        self._kept = round(KEPT_SHARE * rollouts)
        self._cost = cost or Cost()
        self.begin(np.zeros(2, dtype=np.float32), seed=0)

    def begin(self, command: Array, seed: int) -> None:
        """Forget all plans but one: to hold `command` [cart velocity (m/s), pressure (kPa)]."""
        self._random = np.random.default_rng(seed)
        held = np.clip((command - CENTRE) / HALF, -1.0, 1.0)
        self._plans = np.broadcast_to(held[:, None, None], (2, self._steps, 1)).astype(np.float32)
        self._fresh = self._rollouts // 2
        self.cost = np.inf

    def move_on(self) -> None:
        """A step has passed: every plan loses its first command."""
        self._plans = plans.shifted(self._plans)
        self._fresh = int(FRESH_SHARE * self._rollouts)

    def improve(self, robot: "Simulator", target_m: Array) -> None:
        """One round: vary the kept plans, fly all from where robot 0 of `robot` is, keep the best.

        target_m: [2], y and z. The plans that were kept fly too, so a round never loses what it has.
        """
        new = self._rollouts - self._plans.shape[2] - self._fresh
        parts = [self._plans, plans.variations(self._random, self._plans, new)]
        if self._fresh:
            parts.append(plans.swings(self._random, self._steps, self._fresh, self._period_s))
            self._fresh = 0
        flown = np.concatenate(parts, axis=2)
        self._simulator.take_over(robot)
        velocity, pressure = (HALF[i] * flown[i] + CENTRE[i] for i in (0, 1))
        path = self._simulator.fly(velocity, pressure, self._period_s)
        costs = self._cost.of(path, target_m, self._period_s)
        best = np.argsort(costs, kind="stable")[: self._kept]
        self._plans, self.cost = flown[:, :, best], float(costs[best[0]])

    def best(self) -> Array:
        """The best plan, float32 [T, 2]: cart velocity (m/s), pressure (kPa)."""
        plan: Array = CENTRE + HALF * self._plans[:, :, 0].T
        return plan
