"""PID baseline of the seed: one controller per axis, which does not swing ([P] SM-I)."""

import math

import numpy as np

from softarm.policies.base import HIGH, LOW, Array, PolicyError, PolicySpec
from softarm.schemas.policy import places
from softarm.schemas.robot import CONTROL_PERIOD_S

_TIP, _TIP_VELOCITY = places("tip_y_m", "tip_z_m"), places("tip_vy_m_s", "tip_vz_m_s")


class Pid:
    """a = -K_p e - K_d de/dt - K_i integral(e), e = tip - target; y drives the cart, z the muscle.

    Gains: kp_y in 1/s, kd_y in 1, ki_y in 1/s^2 (to m/s); kp_z in kPa/m, kd_z in kPa s/m, ki_z in kPa/(m s); defaults
    as in [P]. An integral is held while its action is at a limit. Raises PolicyError for a negative or infinite gain
    or NaN.
    """

    spec = PolicySpec(name="pid", description="PID on the tip's error, the gains of the paper's baseline")

    def __init__(
        self,
        kp_y: float = 1.0,
        kp_z: float = 20.0,
        ki_y: float = 0.0,
        ki_z: float = 0.0,
        kd_y: float = 0.0,
        kd_z: float = 0.0,
    ) -> None:
        gains = {"kp_y": kp_y, "kp_z": kp_z, "ki_y": ki_y, "ki_z": ki_z, "kd_y": kd_y, "kd_z": kd_z}
        for name, gain in gains.items():
            if not (math.isfinite(gain) and gain >= 0):
                raise PolicyError(f"option {name} is {gain}; allowed 0 or more: the policy sets the sign")
        self._kp = np.array([kp_y, kp_z], dtype=np.float32)
        self._ki = np.array([ki_y, ki_z], dtype=np.float32)
        self._kd = np.array([kd_y, kd_z], dtype=np.float32)
        self.reset()

    def reset(self) -> None:
        """Set the integrals to zero."""
        self._integral = np.zeros(2, dtype=np.float32)

    def step(self, observation: Array, goal: Array) -> Array:
        """Return [cart velocity, pressure] within `ACTION`'s ranges."""
        error = observation[_TIP] - goal
        integral = self._integral + error * np.float32(CONTROL_PERIOD_S)
        action = -self._kp * error - self._kd * observation[_TIP_VELOCITY] - self._ki * integral
        clipped: Array = np.clip(action, LOW, HIGH)
        self._integral = np.where(clipped == action, integral, self._integral)
        return clipped
