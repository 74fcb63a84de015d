"""Search over a population of plans that are simulated, sorted and varied, without clock and I/O."""

from typing import TYPE_CHECKING

import numpy as np

from softarm.policies.base import HIGH, LOW, Array
from softarm.policies.mppi import plans
from softarm.policies.mppi.cost import cost
from softarm.schemas.model import Model

if TYPE_CHECKING:
    from softarm.simulator.simulator import Simulator

PHYSICS_HZ = 120.0  # coarse: the next tick corrects the error of some mm at a plan's end
KEPT_SHARE = 1 / 8  # of a round's plans, varied in the next round
FRESH_SHARE = 1 / 8  # of a tick's first round, new random plans
CENTRE, HALF = np.float32(0.5) * (HIGH + LOW), np.float32(0.5) * (HIGH - LOW)


class Planner:
    """Search for plans of `steps` commands, `period_s` apart; each round simulates `rollouts` plans on `model`."""

    def __init__(self, model: Model, rollouts: int, steps: int, period_s: float) -> None:
        from softarm.simulator.simulator import Simulator  # imports numba, which only this policy needs

        self.simulator: Simulator = Simulator(model, robots=rollouts, physics_rate_hz=PHYSICS_HZ)
        self._rollouts, self._steps, self._period_s = rollouts, steps, period_s
        self._kept = round(KEPT_SHARE * rollouts)
        self.begin(np.zeros(2, dtype=np.float32), seed=0)

    def begin(self, command: Array, seed: int) -> None:
        """Start with a single plan: to hold `command` [cart velocity (m/s), pressure (kPa)]."""
        self._random = np.random.default_rng(seed)
        held = np.clip((command - CENTRE) / HALF, -1.0, 1.0)
        self._plans = np.broadcast_to(held[:, None, None], (2, self._steps, 1)).astype(np.float32)
        self._fresh = self._rollouts // 2
        self.cost = np.inf

    def move_on(self) -> None:
        """Remove the first command of every plan after a control step; the last one is held."""
        self._plans = np.concatenate((self._plans[:, 1:], self._plans[:, -1:]), axis=1)
        self._fresh = int(FRESH_SHARE * self._rollouts)

    def improve(self, robot: "Simulator", target_m: Array) -> None:
        """Run one round: vary the kept plans, simulate all from the state of robot 0 of `robot`, keep the best.

        The kept plans fly again, so a round never loses its best plan. `target_m` is y and z, [2].
        """
        new = self._rollouts - self._plans.shape[2] - self._fresh
        parts = [self._plans, plans.variations(self._random, self._plans, new)]
        if self._fresh:
            parts.append(plans.swings(self._random, self._steps, self._fresh, self._period_s))
            self._fresh = 0
        flown = np.concatenate(parts, axis=2)
        self.simulator.take_over(robot)
        velocity, pressure = (HALF[i] * flown[i] + CENTRE[i] for i in (0, 1))
        path = self.simulator.fly(velocity, pressure, self._period_s)
        costs = cost(path, target_m, self._period_s)
        best = np.argsort(costs, kind="stable")[: self._kept]
        self._plans, self.cost = flown[:, :, best], float(costs[best[0]])

    def best(self) -> Array:
        """Return the best plan, float32 [T, 2]: cart velocity (m/s), pressure (kPa)."""
        plan: Array = CENTRE + HALF * self._plans[:, :, 0].T
        return plan
