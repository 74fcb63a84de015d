"""Policy that plans again at every tick by simulating ahead, without training."""

import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from softarm.common.plugins import Option
from softarm.policies.base import Array, PolicyError, PolicySpec
from softarm.policies.mppi.estimator import Estimator
from softarm.policies.mppi.planner import Planner
from softarm.schemas.flights import BOARD_BELOW_M
from softarm.schemas.policy import OBSERVATION, REACH_GOAL, places
from softarm.schemas.robot import CONTROL_PERIOD_S

Seen = NDArray[np.float64]

LOST_M = 0.04  # a larger tip error of the estimate restarts it
_COMMAND, _PRESSURE = places("previous_cart_velocity_command_m_s", "pressure_kpa")
_GIVEN = [signal.name for signal in (*OBSERVATION, *REACH_GOAL)]
_LIMITS = {"horizon_s": (0.5, 4.0), "rollouts": (64, 8192), "rounds": (1, 100), "budget_s": (0.001, 0.033)}


class Mppi:
    """Sampling model-predictive control on the batch simulator, on one core.

    Args:
        horizon_s: Length of a plan.
        rollouts: Number of plans per round.
        rounds: Most rounds per tick.
        budget_s: Time per tick; no round begins that would end later.
        target_depth_m: Depth of targets behind the front edge of a shelf, which plans then touch; None: no shelf.
        model: Model file or shipped name.
        clock: Monotonic clock, ns.

    Raises:
        PolicyError: An option is out of range, or the model is invalid.
    """

    spec = PolicySpec(name="mppi", description="replans at every tick by flying the simulator ahead")

    def __init__(
        self,
        horizon_s: float = 1.3,
        rollouts: int = 256,
        rounds: int = 3,
        budget_s: float = 0.006,
        model: str = "seed",
        seed: int = 0,
        target_depth_m: float | None = None,
        clock: Callable[[], int] = time.perf_counter_ns,
    ) -> None:
        given = {"horizon_s": horizon_s, "rollouts": rollouts, "rounds": rounds, "budget_s": budget_s}
        for name, value in given.items():
            low, high = _LIMITS[name]
            if not low <= value <= high:
                raise PolicyError(f"option {name} is {value}; allowed {low} to {high}")
        from softarm.simulator import model_file  # imports numba, which only this policy needs

        try:
            loaded = model_file.load(model)
        except model_file.ModelFileError as error:
            raise PolicyError(f"option model: {error}") from error
        self._estimator = Estimator(loaded, CONTROL_PERIOD_S)
        self._planner = Planner(loaded, rollouts, round(horizon_s / CONTROL_PERIOD_S), CONTROL_PERIOD_S)
        self.target_depth_m = target_depth_m
        self.spec = self.describe(target_depth_m=target_depth_m)
        self._rounds, self._budget_ns, self._seed, self._clock = rounds, round(budget_s * 1e9), seed, clock
        self._warm_up(loaded.arm.base_height_m - sum(loaded.arm.link_length_m))

    @classmethod
    def describe(cls, target_depth_m: float | None = None, **_: Option) -> PolicySpec:
        """Return the spec with these options; Raises PolicyError for a depth that is NaN or infinite."""
        if target_depth_m is not None and not math.isfinite(target_depth_m):
            raise PolicyError(f"option target_depth_m is {target_depth_m}; give metres behind the shelf's front edge")
        return replace(cls.spec, shelf_depth_m=target_depth_m)

    def _warm_up(self, hanging_z_m: float) -> None:
        """Compile, fill the caches and measure the duration of a round."""
        hanging = np.zeros(len(OBSERVATION), dtype=np.float32)
        hanging[places("tip_z_m")] = hanging_z_m
        self.reset()
        for _ in range(3):
            self._round_ns = 0  # what the last step took: the first one compiles
            self.step(hanging, np.array((0.0, hanging_z_m), dtype=np.float32))
        self.reset()

    def reset(self) -> None:
        """Discard the plans and the estimate."""
        self._begun = False
        self.rounds_flown = 0  # in the last step

    def step(self, observation: Array, goal: Array) -> Array:
        """Plan and return the next command; without time for a round, continue with the current plan.

        Raises ValueError for NaN or infinity in the observation or the goal; the state does not change then.
        """
        start_ns = self._clock()
        for name, value in zip(_GIVEN, (*observation, *goal), strict=True):
            if not math.isfinite(value):
                raise ValueError(f"{name} is {value}: planning needs a finite number")
        if self.target_depth_m is not None:
            for simulator in (self._estimator.simulator, self._planner.simulator):
                simulator.place_shelf(goal[0] + self.target_depth_m, goal[1] - BOARD_BELOW_M)
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
        """Return the best plan, float32 [T, 2]: cart velocity (m/s), pressure (kPa); `step` returned its first row."""
        return self._planner.best()

    def _estimate(self, seen: Seen) -> None:
        """Advance estimate and plans to the time of the observation [8]."""
        if self._begun:
            self._planner.move_on()
            if self._follows(seen):
                return
        else:
            self._planner.begin(seen[[_COMMAND, _PRESSURE]].astype(np.float32), self._seed)
        self._estimator.begin(seen)
        self._begun = True

    def _follows(self, seen: Seen) -> bool:
        """Advance the estimate; return False if it diverges, after a collision, a missed tick or with a wrong model."""
        try:
            self._estimator.follow(seen, float(seen[_COMMAND]), float(self._sent[1]))
        except np.linalg.LinAlgError:
            return False
        return self._estimator.distance_m(seen) <= LOST_M
