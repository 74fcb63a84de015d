"""Replanning at every tick: a policy that flies the simulator ahead instead of having learned what it does."""

import math
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from softarm.policies.base import Array, PolicyError, PolicySpec
from softarm.policies.mppi.estimator import Estimator
from softarm.policies.mppi.planner import Planner
from softarm.schemas.policy import OBSERVATION, REACH_GOAL, places
from softarm.schemas.robot import CONTROL_PERIOD_S

Seen = NDArray[np.float64]

LOST_M = 0.04  # an estimate whose tip is so far from the seen one is begun anew
_COMMAND, _PRESSURE = places("previous_cart_velocity_command_m_s", "pressure_kpa")
_GIVEN = [signal.name for signal in (*OBSERVATION, *REACH_GOAL)]
_LIMITS = {
    "horizon_s": (0.5, 4.0),
    "rollouts": (64, 8192),
    "rounds": (1, 100),
    "budget_s": (0.001, 0.033),
}


class Mppi:
    """Sampling model-predictive control on the batch simulator, on one core.

    horizon_s: how far plans look; rollouts: plans flown a round; rounds: at most so many a tick; budget_s: no round
    begins that would end later; model: the simulator's, a file or a shipped name; seed: of the sampling; clock:
    nanoseconds, monotonic. Raises PolicyError for what is out of range or no model.
    """

    spec = PolicySpec(name="mppi", description="replans at every tick by flying the simulator ahead")

    def __init__(
        self,
        horizon_s: float = 1.3,
        rollouts: int = 512,
        rounds: int = 3,
        budget_s: float = 0.012,
        model: str = "seed",
        seed: int = 0,
        clock: Callable[[], int] = time.perf_counter_ns,
    ) -> None:
        given = {"horizon_s": horizon_s, "rollouts": rollouts, "rounds": rounds, "budget_s": budget_s}
        for name, value in given.items():
            low, high = _LIMITS[name]
            if not low <= value <= high:
                raise PolicyError(f"option {name} is {value}; allowed {low} to {high}")
        from softarm.simulator import model_file  # its kernel brings numba, which only those who fly this policy need

        try:
            loaded = model_file.load(model)
        except model_file.ModelFileError as error:
            raise PolicyError(f"option model: {error}") from error
        self._estimator = Estimator(loaded, CONTROL_PERIOD_S)
        self._planner = Planner(loaded, rollouts, round(horizon_s / CONTROL_PERIOD_S), CONTROL_PERIOD_S)
        self._rounds, self._budget_ns, self._seed, self._clock = rounds, round(budget_s * 1e9), seed, clock
        self._warm_up(loaded.arm.base_height_m - sum(loaded.arm.link_length_m))

    def _warm_up(self, hanging_z_m: float) -> None:
        """Compile and fill the caches before anybody waits; learn how long a round takes."""
        hanging = np.zeros(len(OBSERVATION), dtype=np.float32)
        hanging[places("tip_z_m")] = hanging_z_m
        self.reset()
        for _ in range(3):
            self._round_ns = 0  # what the last step took: the first one compiles
            self.step(hanging, np.array((0.0, hanging_z_m), dtype=np.float32))
        self.reset()

    def reset(self) -> None:
        """Forget the plans and what was thought of the arm."""
        self._begun = False
        self.rounds_flown = 0  # in the last step

    def step(self, observation: Array, goal: Array) -> Array:
        """See `softarm.policies.base.Policy.step`. Without time for a round it goes on with the plan that it has.

        Raises ValueError for an observation or a goal that is not finite; what it knew stays.
        """
        start_ns = self._clock()
        for name, value in zip(_GIVEN, (*observation, *goal), strict=True):
            if not math.isfinite(value):
                raise ValueError(f"{name} is {value}: it cannot plan without it")
        self._estimate(observation.astype(np.float64))
        self.rounds_flown = 0
        now_ns = self._clock()
        while self.rounds_flown < self._rounds and now_ns + self._round_ns - start_ns <= self._budget_ns:
            self._planner.improve(self._estimator.simulator, goal)
            before_ns, now_ns = now_ns, self._clock()
            self._round_ns = max(now_ns - before_ns, self._round_ns - self._round_ns // 16)
            self.rounds_flown += 1
        if self.rounds_flown == 0:
            self._round_ns //= 2  # one hiccup must not keep it from ever trying again
        sent: Array = self._planner.best()[0]
        self._sent = sent
        return sent

    def planned(self) -> Array:
        """The best plan, float32 [T, 2]: cart velocity (m/s), pressure (kPa); the first was returned by `step`."""
        return self._planner.best()

    def _estimate(self, seen: Seen) -> None:
        """Bring estimate and plans to the instant of the observation [8]."""
        if self._begun:
            self._planner.move_on()
            if self._follows(seen):
                return
        else:
            self._planner.begin(seen[[_COMMAND, _PRESSURE]].astype(np.float32), self._seed)
        self._estimator.begin(seen)
        self._begun = True

    def _follows(self, seen: Seen) -> bool:
        """Carry the estimate on; False when it has lost the arm: a collision, a tick left out, a model far off."""
        try:
            self._estimator.follow(seen, float(seen[_COMMAND]), float(self._sent[1]))
        except np.linalg.LinAlgError:
            return False
        return self._estimator.distance_m(seen) <= LOST_M
