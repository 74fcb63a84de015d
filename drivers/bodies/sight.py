"""What a simulated robot's sensors show: mocap poses, the axis's read-back and the pressure, each with its effects.

The twin and the in-process robot both look through this. The effects of `clock` are the loop's own and no
sensor's: here the loop is real.
"""

import numpy as np

from softarm.schemas.messages import Pose
from softarm.simulator.sensors import Sensors
from softarm.simulator.simulator import Simulator


class Sight:
    """The sensors of a simulator's only robot; `seed` draws noise and dropouts."""

    def __init__(self, simulator: Simulator, seed: int = 0) -> None:
        self._simulator = simulator
        (model,) = simulator.models
        self._base_height_m = model.arm.base_height_m
        self._feed = 1.0 + float(simulator.effects.value("rail.gain", "scale")[0])
        distorted = any(name.startswith("mocap.") for name in model.effects)
        self._sensors = Sensors(simulator, np.random.default_rng(seed)) if distorted else None

    def forget(self) -> None:
        """The robot was put elsewhere: what was seen before is not shown late."""
        if self._sensors is not None:
            self._sensors.reset()

    def poses(self) -> tuple[Pose, ...] | None:
        """One frame (`softarm.schemas.messages.BODY_NAMES` order), or None when it was dropped."""
        if self._sensors is None:
            ends = self._simulator.link_ends_m()[0].tolist()
            angles = self._simulator.link_angles_rad[0].tolist()
            cart = Pose(float(self._simulator.cart_position_m[0]), self._base_height_m, 0.0)
            return (cart, *(Pose(y, z, angle) for (y, z), angle in zip(ends, angles, strict=True)))
        seen = self._sensors.look()
        if not seen.fresh[0]:
            return None
        bodies = zip(seen.positions_m[0].tolist(), seen.angles_rad[0].tolist(), strict=True)
        return tuple(Pose(y, z, angle) for (y, z), angle in bodies)

    def rail(self) -> tuple[float, float]:
        """Position (m) and velocity (m/s) as the axis counts them: a wrong feed constant it cannot see."""
        simulator = self._simulator
        return float(simulator.cart_position_m[0]) / self._feed, float(simulator.cart_velocity_m_s[0]) / self._feed

    def pressure_kpa(self) -> float:
        """As the regulator's own sensor reads it."""
        return float(self._simulator.pressure_reading_kpa[0])
