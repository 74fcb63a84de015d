"""The independent robot: it accepts commands and returns measurements; its caller advances the time."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softarm.reality.devices import PressureRegulator, Servo
from softarm.reality.parameters import RobotParameters
from softarm.reality.plant import RATE_HZ, Plant
from softarm.reality.sensors import Cameras, Encoder, Gauge
from softarm.schemas.messages import MocapFrame, PressureReading, RailReading

DT_S = 1 / RATE_HZ
# Every device has its own random stream: an imperfection of one never changes the noise of another.
_REGULATOR, _RAIL, _CAMERAS, _GAUGE = range(4)


@dataclass(frozen=True, slots=True)
class Truth:
    """True state of the robot, without sensor errors."""

    t_s: float
    cart_position_m: float
    cart_velocity_m_s: float
    pressure_kpa: float  # in the muscle
    link_ends_m: NDArray[np.float64]  # y, z of the far ends of the model's links [5, 2]; the last one is the tip
    link_angles_rad: NDArray[np.float64]  # absolute angles of their chords [5]


class UnstableError(RuntimeError):
    """Numerical instability of the robot."""


class Robot:
    """One robot with given imperfections; the same seed and calls give the same measurements bit for bit.

    It starts at time 0, at rest, with zero commands. Its arm is straight or, with `hanging`, in its rest position.
    Time advances in steps of 1/2040 s; a command between two steps acts from the later one. `held` clamps the cart.
    """

    def __init__(
        self,
        parameters: RobotParameters | None = None,
        seed: int = 0,
        *,
        cart_position_m: float = 0.0,
        held: bool = False,
        hanging: bool = False,
        shelf_m: tuple[float, float] | None = None,
    ) -> None:
        """Build the robot.

        Args:
            shelf_m: y of the front edge and z of the top of the lower board of a shelf that is open towards +y.

        Raises:
            ValueError: The cart is beyond the travel, or the seed is negative.
        """
        self.parameters = p = parameters or RobotParameters()
        if not abs(cart_position_m) <= p.cart.travel_m:
            raise ValueError(
                f"cart_position_m is {cart_position_m}; the travel is +-{p.cart.travel_m} m: start within it"
            )
        if seed < 0:
            raise ValueError(f"seed is {seed}; give a whole number from 0")
        self.held = held
        self._steps = 0
        self._commanded_s = 0.0
        random = [np.random.default_rng((seed, device)) for device in range(4)]
        self._regulator = PressureRegulator(p.regulator, DT_S, random[_REGULATOR])
        self._servo = Servo(p.rail, DT_S, cart_position_m, random[_RAIL])
        self.plant = Plant(p, cart_position_m, held, self._servo.motor_kg, shelf_m)
        if hanging:
            self.plant.hang()
        self._cameras = Cameras(p.mocap, p.clock.camera_drift, p.body.base_height_m, random[_CAMERAS])
        self._gauge, self._encoder = Gauge(p.pressure_sensor, random[_GAUGE]), Encoder(p.rail_sensor)

    @property
    def t_s(self) -> float:
        """Return the robot's time, s."""
        return self._steps * DT_S

    def command(self, t_s: float, cart_velocity_m_s: float, pressure_kpa: float) -> None:
        """Send both commands at a time.

        Raises:
            ValueError: The time is in the robot's past or before an earlier command, or a command is NaN or infinity.
        """
        if not (math.isfinite(cart_velocity_m_s) and math.isfinite(pressure_kpa)):
            raise ValueError(f"the command is {cart_velocity_m_s} m/s, {pressure_kpa} kPa; give two finite numbers")
        earliest = max(self._commanded_s, self.t_s - DT_S)
        if not earliest <= t_s < math.inf:
            raise ValueError(f"t_s is {t_s}; the robot is at {self.t_s:.6f} s: give {earliest:.6f} or later")
        self._commanded_s = t_s
        self._servo.wire.send(t_s, cart_velocity_m_s)
        self._regulator.wire.send(t_s, pressure_kpa)

    def advance(self, t_s: float) -> None:
        """Advance to the last step at or before a time; a time in the past has no effect.

        Raises:
            ValueError: The time is NaN or infinity.
            UnstableError: The robot's state has become NaN or infinity.
        """
        if not math.isfinite(t_s):
            raise ValueError(f"t_s is {t_s}; give a finite number of seconds")
        until = math.floor(t_s * RATE_HZ + 1e-6)
        plant, servo, regulator = self.plant, self._servo, self._regulator
        loose_link = self.parameters.mocap.loose_link
        due_s = self._measure()
        while self._steps < until:
            # A command that arrives exactly now acts in this step.
            t = self._steps * DT_S + 1e-9
            pressure = regulator.step(t)
            force = 0.0 if self.held else servo.step(t, plant.cart_position_m, plant.cart_velocity_m_s)
            plant.step(force, servo.friction_n, pressure)
            self._steps += 1
            if loose_link:
                self._cameras.shake(plant.end_velocity_m_s(loose_link), DT_S)
            if self.t_s + 1e-9 >= due_s:
                due_s = self._measure()

    def mocap(self) -> list[MocapFrame]:
        """Return the frames received since the last call, oldest first; stamps count from the robot's start."""
        return self._cameras.received(self.t_s)

    def pressure(self) -> list[PressureReading]:
        """Return the regulator's readings since the last call, oldest first."""
        return self._gauge.received(self.t_s)

    def rail(self) -> list[RailReading]:
        """Return the axis readings since the last call, oldest first."""
        return self._encoder.received(self.t_s)

    @property
    def truth(self) -> Truth:
        """Return the present true state."""
        ends, angles = self.plant.links()
        plant = self.plant
        return Truth(
            self.t_s, plant.cart_position_m, plant.cart_velocity_m_s, self._regulator.pressure_kpa, ends, angles
        )

    def _measure(self) -> float:
        """Take every measurement that is due and return the time of the next one."""
        cameras, gauge, encoder, now_s = self._cameras, self._gauge, self._encoder, self.t_s
        if not np.isfinite(self.plant.data.qpos).all():
            raise UnstableError(
                f"the robot's state became NaN or infinite at {now_s:.3f} s; "
                "use weaker imperfections or commands, or a heavier cart"
            )
        if cameras.due_s <= now_s + 1e-9:
            ends, angles = self.plant.links()
            cameras.expose(now_s, self.plant.cart_position_m, ends, angles)
        if gauge.due_s <= now_s + 1e-9:
            gauge.read(now_s, self._regulator.pressure_kpa)
        if encoder.due_s <= now_s + 1e-9:
            self._servo.sense(self.plant.cart_position_m, self.plant.cart_velocity_m_s)
            encoder.read(now_s, self._servo.position_m, self._servo.velocity_m_s)
        return min(cameras.due_s, gauge.due_s, encoder.due_s)
