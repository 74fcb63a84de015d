"""Interface of a robot without its wires, used by the in-process devices and by the twin."""

from typing import NamedTuple, Protocol

from softarm.schemas.messages import MocapFrame, PressureReading, RailReading


class PlacementError(Exception):
    """The body cannot be placed; the message states the alternative."""


class Truth(NamedTuple):
    """True state: the cart from the middle of the rail, the pressure in the muscle, y and z of the tip."""

    cart_position_m: float
    cart_velocity_m_s: float
    pressure_kpa: float
    tip_m: tuple[float, float]


class Body(Protocol):
    """Robot with true state, sensors, and a step under commands.

    `now_ns` is the body's clock, nanoseconds since its creation: only `step` advances it, and every stamp is on it.
    `travel_m` is the distance from the middle of the rail to either mechanical stop.
    Readings always show armed and enabled; the devices replace these fields.
    """

    now_ns: int
    travel_m: float

    @property
    def truth(self) -> Truth:
        """True state at this moment."""

    def step(self, cart_velocity_m_s: float, pressure_kpa: float, duration_ns: int) -> None:
        """Advance by a duration under constant commands."""

    def place(self, cart_position_m: float) -> None:
        """Move the cart, with the arm straight and at rest and the muscle vented; the clock continues.

        Raises:
            PlacementError: This body cannot be placed.
        """

    def frames(self) -> tuple[MocapFrame, ...]:
        """Return the frames since the last call, oldest first. Call it once after each step."""

    def gauge(self) -> PressureReading:
        """Return the newest reading of the regulator's sensor, the same object until a newer one exists."""

    def encoder(self) -> RailReading:
        """Return the axis's newest read-back, the same object until a newer one exists."""
