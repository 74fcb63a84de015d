"""Body of the simulator's robot, with the sensor effects of its model."""

import numpy as np

from softarm.drivers.bodies.base import Truth
from softarm.schemas.messages import BODY_NAMES, MocapFrame, Pose, PressureReading, RailReading
from softarm.schemas.model import Model
from softarm.schemas.robot import PHYSICS_RATE_HZ
from softarm.simulator.sensors import Sensors
from softarm.simulator.simulator import Simulator


class SimulatedBody:
    """Simulated robot that starts at rest in the middle of the rail; see `softarm.drivers.bodies.base.Body`.

    Sensors have no delay except the model's effects. The effects of `clock` are not applied: they describe the control
    loop, which is real here.
    """

    def __init__(self, model: Model | None = None, seed: int = 0) -> None:
        """Create the robot; `seed` draws the noise and dropouts of its sensors.

        Raises ValueError if the number of links differs from the number of tracked links.
        """
        self.model = model or Model()
        self.travel_m = self.model.cart.travel_m
        links = self.model.arm.links
        if links != len(BODY_NAMES) - 1:
            raise ValueError(f"the model has {links} links, the robot {len(BODY_NAMES) - 1}: use a model with as many")
        self.simulator = Simulator(self.model, robots=1, physics_rate_hz=PHYSICS_RATE_HZ)
        # The first step may compile.
        self.simulator.step(0.0, 0.0, 1 / PHYSICS_RATE_HZ)
        self.simulator.reset()
        self.now_ns = 0
        self._feed = 1.0 + float(self.simulator.effects.value("rail.gain", "scale")[0])
        distorted = any(name.startswith("mocap.") for name in self.model.effects)
        self._sensors = Sensors(self.simulator, np.random.default_rng(seed)) if distorted else None
        self._frame = 0

    @property
    def truth(self) -> Truth:
        """True state at this moment."""
        robot = self.simulator
        y, z = robot.tip_m()[0].tolist()
        position_m, velocity_m_s = float(robot.cart_position_m[0]), float(robot.cart_velocity_m_s[0])
        return Truth(position_m, velocity_m_s, float(robot.pressure_kpa[0]), (y, z))

    def step(self, cart_velocity_m_s: float, pressure_kpa: float, duration_ns: int) -> None:
        """Advance by a duration under constant commands."""
        self.simulator.step(cart_velocity_m_s, pressure_kpa, duration_ns * 1e-9)
        self.now_ns += duration_ns

    def place(self, cart_position_m: float) -> None:
        """Move the cart and forget delayed samples; see `Body.place`."""
        self.simulator.reset(cart_position_m=cart_position_m)
        if self._sensors is not None:
            self._sensors.reset()

    def frames(self) -> tuple[MocapFrame, ...]:
        """Return one frame of this instant, or none if it was dropped."""
        self._frame += 1
        poses = self._poses()
        return () if poses is None else (MocapFrame(self._frame, self.now_ns, self.now_ns, poses),)

    def gauge(self) -> PressureReading:
        """Return the present reading of the regulator's sensor."""
        return PressureReading(self.now_ns, float(self.simulator.pressure_reading_kpa[0]), True)

    def encoder(self) -> RailReading:
        """Return the present read-back of the axis, including a wrong feed constant."""
        truth = self.truth
        return RailReading(self.now_ns, truth.cart_position_m / self._feed, truth.cart_velocity_m_s / self._feed, True)

    def _poses(self) -> tuple[Pose, ...] | None:
        if self._sensors is None:
            ends = self.simulator.link_ends_m()[0].tolist()
            angles = self.simulator.link_angles_rad[0].tolist()
            cart = Pose(float(self.simulator.cart_position_m[0]), self.model.arm.base_height_m, 0.0)
            return (cart, *(Pose(y, z, angle) for (y, z), angle in zip(ends, angles, strict=True)))
        seen = self._sensors.look()
        if not seen.fresh[0]:
            return None
        bodies = zip(seen.positions_m[0].tolist(), seen.angles_rad[0].tolist(), strict=True)
        return tuple(Pose(y, z, angle) for (y, z), angle in bodies)
