"""The twin's other body: the independent robot in MuJoCo, with sensors of its own. Needs the extra `mujoco`."""

from softarm.drivers.twin.robot import Frame
from softarm.reality.parameters import Parameters, of_model
from softarm.reality.robot import Robot
from softarm.schemas.messages import PressureReading, RailReading
from softarm.schemas.model import Model

TOUCH_M = 0.0005  # so close to a stop counts as there


class IndependentBody:
    """A `softarm.reality.robot.Robot` as the twin moves it; starts at rest in the middle of the rail.

    Commands given for a step act from its start. `crashes` counts arrivals at a stop, which here are springs and
    dampers: the cart may lean on one for a while, and that is one arrival.
    """

    def __init__(self, parameters: Parameters | None = None, seed: int = 0) -> None:
        self.crashes = 0
        self.cart_max_abs_m = 0.0
        self._robot = Robot(parameters, seed, hanging=True)
        self._truth = self._robot.truth
        self._pressure: PressureReading | None = None
        self._rail: RailReading | None = None
        self._t_s = 0.0
        self._at_stop = False

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

    def step(self, cart_velocity_m_s: float, pressure_kpa: float, duration_s: float) -> bool:
        """Move on under these commands; True when the cart has struck a stop."""
        self._robot.command(self._t_s, cart_velocity_m_s, pressure_kpa)
        self._t_s += duration_s
        self._robot.advance(self._t_s)
        self._truth = self._robot.truth
        travel_m = self._robot.parameters.cart.travel_m
        self.cart_max_abs_m = max(self.cart_max_abs_m, min(abs(self.cart_position_m), travel_m))
        before, self._at_stop = self._at_stop, abs(self.cart_position_m) > travel_m - TOUCH_M
        struck = self._at_stop and not before
        self.crashes += struck
        return struck

    def encoder(self) -> tuple[float, float]:
        """The axis's newest read-back."""
        readings = self._robot.rail()
        self._rail = readings[-1] if readings else self._rail
        return (self._rail.position_m, self._rail.velocity_m_s) if self._rail else (self.cart_position_m, 0.0)

    def gauge_kpa(self) -> float:
        """The newest reading of the regulator's sensor."""
        readings = self._robot.pressure()
        self._pressure = readings[-1] if readings else self._pressure
        return self._pressure.pressure_kpa if self._pressure else 0.0

    def look(self) -> Frame | None:
        """The newest frame that has come since the last call."""
        frames = self._robot.mocap()
        if not frames:
            return None
        return Frame(self._t_s - frames[-1].t_capture_ns * 1e-9, frames[-1].bodies)


def independent_body(model: Model | None, seed: int = 0) -> IndependentBody:
    """The nominal robot of a model file (default: the seed's). Raises ValueError for a model it cannot be."""
    return IndependentBody(of_model(model or Model()), seed)
