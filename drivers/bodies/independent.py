"""The independent robot of `reality/` as a body, with sensors of its own. Needs the extra `mujoco`."""

from softarm.drivers.bodies.base import PlacementError
from softarm.reality.parameters import RobotParameters
from softarm.reality.robot import Robot
from softarm.schemas.messages import MocapFrame, PressureReading, RailReading


class IndependentBody:
    """A `softarm.reality.robot.Robot` that hangs at rest where it is made; see `softarm.drivers.bodies.base.Body`.

    Its sensors have rates and delays of their own, so a step may bring no frame or several.
    """

    def __init__(
        self,
        parameters: RobotParameters | None = None,
        seed: int = 0,
        *,
        cart_position_m: float = 0.0,
        shelf_m: tuple[float, float] | None = None,
    ) -> None:
        """Raises ValueError as `softarm.reality.robot.Robot` does; `shelf_m` as there."""
        self._robot = Robot(parameters, seed, cart_position_m=cart_position_m, hanging=True, shelf_m=shelf_m)
        self._truth = self._robot.truth
        # What a device knows when it is switched on.
        self._pressure = PressureReading(0, self._truth.pressure_kpa, True)
        self._rail = RailReading(0, self._truth.cart_position_m, 0.0, True)
        self.now_ns = 0

    @property
    def travel_m(self) -> float:
        """To either side."""
        return self._robot.parameters.cart.travel_m

    @property
    def cart_position_m(self) -> float:
        """True, from the middle of the rail."""
        return self._truth.cart_position_m

    @property
    def cart_velocity_m_s(self) -> float:
        """True velocity."""
        return self._truth.cart_velocity_m_s

    @property
    def pressure_kpa(self) -> float:
        """True, in the muscle."""
        return self._truth.pressure_kpa

    @property
    def tip_m(self) -> tuple[float, float]:
        """True y, z."""
        y, z = self._truth.link_ends_m[-1].tolist()
        return y, z

    def step(self, cart_velocity_m_s: float, pressure_kpa: float, duration_ns: int) -> None:
        """See `Body.step`; the commands act from the start of the step."""
        self._robot.command(self.now_ns * 1e-9, cart_velocity_m_s, pressure_kpa)
        self.now_ns += duration_ns
        self._robot.advance(self.now_ns * 1e-9)
        self._truth = self._robot.truth

    def place(self, cart_position_m: float) -> None:
        """Raises PlacementError: see `Body.place`."""
        raise PlacementError("the independent robot cannot be put anywhere: make it where it is to start")

    def frames(self) -> tuple[MocapFrame, ...]:
        """See `Body.frames`."""
        return tuple(self._robot.mocap())

    def gauge(self) -> PressureReading:
        """See `Body.gauge`."""
        *_, self._pressure = (self._pressure, *self._robot.pressure())
        return self._pressure

    def encoder(self) -> RailReading:
        """See `Body.encoder`."""
        *_, self._rail = (self._rail, *self._robot.rail())
        return self._rail
