"""The simulator's robot as a body, with the sensor effects of its model."""

import numpy as np

from softarm.schemas.messages import BODY_NAMES, MocapFrame, Pose, PressureReading, RailReading
from softarm.schemas.model import Model
from softarm.schemas.robot import PHYSICS_RATE_HZ
from softarm.simulator.sensors import Sensors
from softarm.simulator.simulator import Simulator


class SimulatedBody:
    """One simulated robot that starts at rest in the middle of the rail; see `softarm.drivers.bodies.base.Body`.

    Sensors show every instant at once, but for the model's effects. Those of `clock` are the loop's own and no
    sensor's: here the loop is real.

    Raises ValueError for a model with another number of links than there are marker sets.
    """

    def __init__(self, model: Model | None = None) -> None:
        self.model = model or Model()
        links = self.model.arm.links
        if links != len(BODY_NAMES) - 1:
            raise ValueError(f"the model has {links} links, the robot {len(BODY_NAMES) - 1}: give such a model")
        self.simulator = Simulator(self.model, robots=1, physics_rate_hz=PHYSICS_RATE_HZ)
        self.simulator.step(0.0, 0.0, 1 / PHYSICS_RATE_HZ)  # the first step may compile; nobody is waiting yet
        self.simulator.reset()
        self.now_ns = 0
        self._feed = 1.0 + float(self.simulator.effects.value("rail.gain", "scale")[0])
        distorted = any(name.startswith("mocap.") for name in self.model.effects)
        self._sensors = Sensors(self.simulator, np.random.default_rng(0)) if distorted else None
        self._frame = 0

    @property
    def travel_m(self) -> float:
        """To either side."""
        return self.model.cart.travel_m

    @property
    def cart_position_m(self) -> float:
        """True, from the middle of the rail."""
        return float(self.simulator.cart_position_m[0])

    @property
    def cart_velocity_m_s(self) -> float:
        """True velocity."""
        return float(self.simulator.cart_velocity_m_s[0])

    @property
    def pressure_kpa(self) -> float:
        """True, in the muscle."""
        return float(self.simulator.pressure_kpa[0])

    @property
    def tip_m(self) -> tuple[float, float]:
        """True y, z."""
        y, z = self.simulator.tip_m()[0].tolist()
        return y, z

    def step(self, cart_velocity_m_s: float, pressure_kpa: float, duration_ns: int) -> None:
        """See `Body.step`."""
        self.simulator.step(cart_velocity_m_s, pressure_kpa, duration_ns * 1e-9)
        self.now_ns += duration_ns

    def place(self, cart_position_m: float) -> None:
        """See `Body.place`; what was seen before is not shown late."""
        self.simulator.reset(cart_position_m=cart_position_m)
        if self._sensors is not None:
            self._sensors.reset()

    def frames(self) -> tuple[MocapFrame, ...]:
        """One frame of this instant; none when it was dropped."""
        self._frame += 1
        poses = self._poses()
        return () if poses is None else (MocapFrame(self._frame, self.now_ns, self.now_ns, poses),)

    def gauge(self) -> PressureReading:
        """As the regulator's own sensor reads it now."""
        return PressureReading(self.now_ns, float(self.simulator.pressure_reading_kpa[0]), True)

    def encoder(self) -> RailReading:
        """The cart now as the axis counts it: a wrong feed constant it cannot see."""
        position_m, velocity_m_s = self.cart_position_m / self._feed, self.cart_velocity_m_s / self._feed
        return RailReading(self.now_ns, position_m, velocity_m_s, True)

    def _poses(self) -> tuple[Pose, ...] | None:
        if self._sensors is None:
            ends = self.simulator.link_ends_m()[0].tolist()
            angles = self.simulator.link_angles_rad[0].tolist()
            cart = Pose(self.cart_position_m, self.model.arm.base_height_m, 0.0)
            return (cart, *(Pose(y, z, angle) for (y, z), angle in zip(ends, angles, strict=True)))
        seen = self._sensors.look()
        if not seen.fresh[0]:
            return None
        bodies = zip(seen.positions_m[0].tolist(), seen.angles_rad[0].tolist(), strict=True)
        return tuple(Pose(y, z, angle) for (y, z), angle in bodies)
