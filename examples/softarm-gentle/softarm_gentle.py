"""The task `gentle`: reach a low target slowly."""

from dataclasses import dataclass

import numpy as np
from softarm.training.task.reach import Array, Moment, Range, ReachTask


@dataclass(frozen=True)
class Gentle(ReachTask):
    """Task whose reward falls with the speed of the tip, the more the nearer the target is.

    At `slow_m_s` success has a third of its reward. `speed_penalty` is per m/s at the target, before the scale of all
    rewards; at `near_m` a third of it is left.
    """

    interface = 1

    name: str = "gentle"
    target_y_m: Range = (-0.3, 0.05)
    target_z_m: Range = (0.54, 0.62)
    slow_m_s: float = 0.5
    speed_penalty: float = 1.0
    near_m: float = 0.1

    def reward(self, now: Moment) -> Array:
        """Return the scaled reward of a step, float32 [R]."""
        apart_m = np.linalg.norm(now.tip_m - now.target_m, axis=1)
        worth = self.success_reward * now.success * np.exp(-now.tip_speed_m_s / self.slow_m_s)
        haste = self.speed_penalty * now.tip_speed_m_s * np.exp(-apart_m / self.near_m)
        total = worth - haste + self.rail_penalty * now.off_rail
        return np.asarray(self.reward_scale * total, dtype=np.float32)
