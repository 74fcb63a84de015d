"""The body of the twin: the simulated robot between its mechanical stops."""

from typing import NamedTuple, Protocol

import numpy as np

from softarm.drivers.bodies.sight import Sight
from softarm.schemas.messages import BODY_NAMES, Pose
from softarm.schemas.model import Model
from softarm.simulator.simulator import Simulator

PHYSICS_HZ = 1200.0


class Frame(NamedTuple):
    """What the cameras deliver: poses in `softarm.schemas.messages.BODY_NAMES` order, and how old their stamp is."""

    age_s: float
    poses: tuple[Pose, ...]


class Body(Protocol):
    """What moves behind the twin's wires: the truth, what its sensors read, and a step."""

    crashes: int
    cart_max_abs_m: float

    @property
    def cart_position_m(self) -> float:
        """True, from the middle of the rail."""

    @property
    def cart_velocity_m_s(self) -> float:
        """True velocity."""

    @property
    def pressure_kpa(self) -> float:
        """True, in the muscle."""

    @property
    def tip_m(self) -> tuple[float, float]:
        """True y, z."""

    def step(self, cart_velocity_m_s: float, pressure_kpa: float, duration_s: float) -> bool:
        """Move on under these commands; True when the cart has struck a stop."""

    def encoder(self) -> tuple[float, float]:
        """Position (m) and velocity (m/s) as the axis reads them."""

    def gauge_kpa(self) -> float:
        """Pressure as the regulator's sensor reads it."""

    def look(self) -> Frame | None:
        """The newest frame that has come since the last call; None: none has."""


class TwinRobot:
    """One simulated robot that starts at rest in the middle of the rail.

    `crashes` counts arrivals at a stop, `cart_max_abs_m` is the farthest the cart has been from the middle.
    What its sensors show has the model's mocap effects and biases.
    """

    def __init__(self, model: Model | None) -> None:
        self.model = model or Model()
        links = self.model.arm.links
        if links != len(BODY_NAMES) - 1:
            raise ValueError(f"the model has {links} links, the twin {len(BODY_NAMES) - 1}: give such a model")
        self.crashes = 0
        self.cart_max_abs_m = 0.0
        self._simulator = Simulator(self.model, robots=1, physics_rate_hz=PHYSICS_HZ)
        self._simulator.step(0.0, 0.0, 1 / PHYSICS_HZ)  # the first step may compile
        self._simulator.reset()
        self._sight = Sight(self._simulator)

    @property
    def cart_position_m(self) -> float:
        """From the middle of the rail."""
        return float(self._simulator.cart_position_m[0])

    @property
    def cart_velocity_m_s(self) -> float:
        """True velocity."""
        return float(self._simulator.cart_velocity_m_s[0])

    @property
    def pressure_kpa(self) -> float:
        """In the muscle."""
        return float(self._simulator.pressure_kpa[0])

    @property
    def tip_m(self) -> tuple[float, float]:
        """True y, z."""
        y, z = self._simulator.tip_m()[0].tolist()
        return y, z

    def step(self, cart_velocity_m_s: float, pressure_kpa: float, duration_s: float) -> bool:
        """Move on under these commands; True when the cart has struck a stop, where it then rests."""
        simulator, travel_m = self._simulator, self.model.cart.travel_m
        simulator.step(cart_velocity_m_s, pressure_kpa, duration_s)
        position_m = self.cart_position_m
        self.cart_max_abs_m = max(self.cart_max_abs_m, min(abs(position_m), travel_m))
        outward = position_m * self.cart_velocity_m_s > 0
        if abs(position_m) < travel_m or not outward:
            return False
        self.crashes += 1
        simulator.reset(
            cart_position_m=np.clip(position_m, -travel_m, travel_m),
            joint_angles_rad=simulator.joint_angles_rad,
            pressure_kpa=simulator.pressure_kpa,
        )
        self._sight.forget()
        return True

    def encoder(self) -> tuple[float, float]:
        """See `Body.encoder`."""
        return self._sight.rail()

    def gauge_kpa(self) -> float:
        """See `Body.gauge_kpa`."""
        return self._sight.pressure_kpa()

    def look(self) -> Frame | None:
        """See `Body.look`."""
        poses = self._sight.poses()
        return None if poses is None else Frame(0.0, poses)
