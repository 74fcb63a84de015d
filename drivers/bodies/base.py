"""A robot without its wires: what stands behind the devices in this process and behind the twin's ports."""

from typing import Protocol

from softarm.schemas.messages import MocapFrame, PressureReading, RailReading


class PlacementError(Exception):
    """This body cannot be put anywhere; says what to do instead."""


class Body(Protocol):
    """The truth, what the sensors show of it, and a step under commands.

    `now_ns` is the body's own clock, nanoseconds since it was made: `step` alone moves it, and every stamp is on it.
    Whether they are armed or enabled is for the devices to say: readings say True.
    """

    now_ns: int

    @property
    def travel_m(self) -> float:
        """How far the cart can go to either side: there it meets a stop."""

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

    def step(self, cart_velocity_m_s: float, pressure_kpa: float, duration_ns: int) -> None:
        """Move on under these commands."""

    def place(self, cart_position_m: float) -> None:
        """Be somewhere else, the arm straight and at rest, the muscle vented; the clock runs on.

        Raises PlacementError from a body that stays where it was made.
        """

    def frames(self) -> tuple[MocapFrame, ...]:
        """Frames that have come since the last call, oldest first; call it once after a step."""

    def gauge(self) -> PressureReading:
        """The newest reading of the regulator's sensor: the same object until there is a newer one."""

    def encoder(self) -> RailReading:
        """The axis's newest read-back: the same object until there is a newer one."""
