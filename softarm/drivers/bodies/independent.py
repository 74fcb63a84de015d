"""Body of the independent robot of `reality/`, with its own sensors. Needs the extra `mujoco`."""

from softarm.drivers.bodies.base import PlacementError, Truth
from softarm.reality.parameters import RobotParameters
from softarm.reality.robot import Robot
from softarm.schemas.messages import MocapFrame, PressureReading, RailReading


class IndependentBody:
    """Body of a `softarm.reality.robot.Robot`, which hangs at rest at first; see `softarm.drivers.bodies.base.Body`.

    Its sensors have their own rates and delays, so a step may return no frame or several.
    """

    def __init__(
        self,
        parameters: RobotParameters | None = None,
        seed: int = 0,
        *,
        cart_position_m: float = 0.0,
        shelf_m: tuple[float, float] | None = None,
    ) -> None:
        """Create the robot; arguments and errors are those of `softarm.reality.robot.Robot`."""
        self._robot = Robot(parameters, seed, cart_position_m=cart_position_m, hanging=True, shelf_m=shelf_m)
        self.travel_m = self._robot.parameters.cart.travel_m
        # Readings of the devices before the first sample.
        self._pressure = PressureReading(0, self.truth.pressure_kpa, True)
        self._rail = RailReading(0, self.truth.cart_position_m, 0.0, True)
        self.now_ns = 0

    @property
    def truth(self) -> Truth:
        """True state at this moment."""
        now = self._robot.truth
        y, z = now.link_ends_m[-1].tolist()
        return Truth(now.cart_position_m, now.cart_velocity_m_s, now.pressure_kpa, (y, z))

    def step(self, cart_velocity_m_s: float, pressure_kpa: float, duration_ns: int) -> None:
        """Advance by a duration; the commands act from the start of the step."""
        self._robot.command(self.now_ns * 1e-9, cart_velocity_m_s, pressure_kpa)
        self.now_ns += duration_ns
        self._robot.advance(self.now_ns * 1e-9)

    def place(self, cart_position_m: float) -> None:
        """Raise PlacementError: this body cannot be placed."""
        raise PlacementError("the independent robot cannot be placed: create it at its starting position")

    def frames(self) -> tuple[MocapFrame, ...]:
        """Return the frames since the last call, oldest first."""
        return tuple(self._robot.mocap())

    def gauge(self) -> PressureReading:
        """Return the newest reading of the regulator's sensor."""
        *_, self._pressure = (self._pressure, *self._robot.pressure())
        return self._pressure

    def encoder(self) -> RailReading:
        """Return the newest read-back of the axis."""
        *_, self._rail = (self._rail, *self._robot.rail())
        return self._rail
