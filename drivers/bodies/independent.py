"""The independent robot of `reality/` as three devices in this process: lockstep, no sleeping, no wire.

What `drivers/bodies/simulated.py` is for the simulator's robot. Needs the extra `mujoco`.
"""

from dataclasses import replace

from softarm.drivers.base import WithoutWire
from softarm.reality.parameters import Parameters
from softarm.reality.robot import Robot
from softarm.schemas.messages import MocapFrame, PressureReading, RailReading


class IndependentRobot:
    """One robot and its three devices; at time 0 it hangs at rest where it is made.

    Sensors have rates and delays of their own, so a tick may bring no frame or two. Raises ValueError for a cart beyond
    its travel. shelf_m: as `softarm.reality.robot.Robot`.
    """

    def __init__(
        self,
        parameters: Parameters | None = None,
        seed: int = 0,
        *,
        cart_position_m: float = 0.0,
        shelf_m: tuple[float, float] | None = None,
    ) -> None:
        self.body = Robot(parameters, seed, cart_position_m=cart_position_m, hanging=True, shelf_m=shelf_m)
        self.now_ns = 0
        self.mocap = IndependentMocap(self)
        self.regulator = IndependentRegulator(self)
        self.rail = IndependentRail(self)

    @property
    def cart_position_m(self) -> float:
        """True, from the middle of the rail."""
        return self.body.truth.cart_position_m

    def advance(self, now_ns: int) -> None:
        """Move up to an instant under the commands last written."""
        if now_ns <= self.now_ns:
            return
        self.body.command(self.now_ns * 1e-9, self.rail.set_point_m_s, self.regulator.set_point_kpa)
        self.body.advance(now_ns * 1e-9)
        self.now_ns = now_ns


class IndependentMocap(WithoutWire):
    """The frames that have come."""

    def __init__(self, robot: IndependentRobot) -> None:
        self._robot = robot

    def read(self, now_ns: int) -> tuple[MocapFrame, ...]:
        """Move the robot up to now and look at it."""
        self._robot.advance(now_ns)
        return tuple(self._robot.body.mocap())


class IndependentRegulator(WithoutWire):
    """Vents when not armed, as the device does."""

    def __init__(self, robot: IndependentRobot) -> None:
        self._robot = robot
        self._armed = False
        self._newest: PressureReading | None = None
        self.set_point_kpa = 0.0

    def read(self) -> PressureReading | None:
        """The newest reading of its sensor."""
        for reading in self._robot.body.pressure():
            self._newest = replace(reading, armed=self._armed)
        return self._newest

    def write(self, armed: bool, pressure_kpa: float) -> None:
        """Set-point until the next call."""
        self._armed = armed
        self.set_point_kpa = pressure_kpa if armed else 0.0


class IndependentRail(WithoutWire):
    """Holds still when it is off."""

    def __init__(self, robot: IndependentRobot) -> None:
        self._robot = robot
        self._enabled = False
        self._newest: RailReading | None = None
        self.set_point_m_s = 0.0

    def read(self) -> RailReading | None:
        """The axis's newest read-back."""
        for reading in self._robot.body.rail():
            self._newest = replace(reading, enabled=self._enabled)
        return self._newest

    def write(self, enable: bool, velocity_m_s: float) -> None:
        """Set-point until the next call."""
        self._enabled = enable
        self.set_point_m_s = velocity_m_s if enable else 0.0
