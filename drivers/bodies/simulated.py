"""The three devices as one simulated robot in this process: lockstep, no sleeping, no wire.

Time is what the caller says: each `mocap.read(now_ns)` first moves the robot up to `now_ns` under the last
commands. So the same robot serves the offline flights, where time jumps by a tick, and
`softarm run --simulated`, where it is real.
"""

from softarm.drivers.base import WithoutWire
from softarm.drivers.bodies.sight import Sight
from softarm.schemas.messages import MocapFrame, PressureReading, RailReading
from softarm.schemas.model import Model
from softarm.simulator.simulator import Simulator

PHYSICS_HZ = 1200.0  # the seed's


class SimulatedRobot:
    """One robot and its three devices; starts at rest at time `now_ns`."""

    def __init__(self, model: Model | None = None, now_ns: int = 0, physics_rate_hz: float = PHYSICS_HZ) -> None:
        self.model = model or Model()
        self.simulator = Simulator(self.model, robots=1, physics_rate_hz=physics_rate_hz)
        self.simulator.step(0.0, 0.0, 1 / physics_rate_hz)  # the first step may compile; nobody is waiting yet
        self.simulator.reset()
        self.sight = Sight(self.simulator)
        self.now_ns = now_ns
        self.mocap = SimulatedMocap(self)
        self.regulator = SimulatedRegulator(self)
        self.rail = SimulatedRail(self)

    @property
    def cart_position_m(self) -> float:
        """True, from the middle of the rail."""
        return float(self.simulator.cart_position_m[0])

    def place(self, cart_position_m: float) -> None:
        """Put the robot somewhere, its arm straight and at rest, the muscle vented."""
        self.simulator.reset(cart_position_m=cart_position_m)
        self.sight.forget()

    def advance(self, now_ns: int) -> None:
        """Move up to an instant under the commands last written."""
        if now_ns <= self.now_ns:
            return
        duration_s = (now_ns - self.now_ns) * 1e-9
        self.simulator.step(self.rail.set_point_m_s, self.regulator.set_point_kpa, duration_s)
        self.now_ns = now_ns


class SimulatedMocap(WithoutWire):
    """Six poses at the instant of the read."""

    def __init__(self, robot: SimulatedRobot) -> None:
        self._robot = robot
        self._sequence = 0

    def read(self, now_ns: int) -> tuple[MocapFrame, ...]:
        """Move the robot up to now and look at it."""
        robot = self._robot
        robot.advance(now_ns)
        self._sequence += 1
        poses = robot.sight.poses()
        return () if poses is None else (MocapFrame(self._sequence, robot.now_ns, now_ns, poses),)


class SimulatedRegulator(WithoutWire):
    """Takes a set-point at once; its lag is the simulator's."""

    def __init__(self, robot: SimulatedRobot) -> None:
        self._robot = robot
        self._armed = False
        self._sequence = 0
        self.set_point_kpa = 0.0

    def read(self) -> PressureReading | None:
        """The pressure as its sensor has it."""
        kpa = self._robot.sight.pressure_kpa()
        return PressureReading(self._robot.now_ns, kpa, self._armed, (), self._sequence)

    def write(self, armed: bool, pressure_kpa: float) -> None:
        """Set-point until the next call; vents when not armed."""
        self._armed = armed
        self._sequence += 1
        self.set_point_kpa = pressure_kpa if armed else 0.0


class SimulatedRail(WithoutWire):
    """Takes a set-point at once; ramp and delay are the simulator's."""

    def __init__(self, robot: SimulatedRobot) -> None:
        self._robot = robot
        self._enabled = False
        self.set_point_m_s = 0.0

    def read(self) -> RailReading | None:
        """The cart as the axis has it."""
        return RailReading(self._robot.now_ns, *self._robot.sight.rail(), self._enabled)

    def write(self, enable: bool, velocity_m_s: float) -> None:
        """Set-point until the next call; a drive that is off holds still."""
        self._enabled = enable
        self.set_point_m_s = velocity_m_s if enable else 0.0
