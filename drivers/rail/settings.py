"""What the rail's masters are told of the axis, and how its counts become metres from the middle of the rail."""

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:  # the rail's process imports next to nothing
    from softarm.schemas.config import DryveRail


class Settings(NamedTuple):
    """Of `softarm.schemas.config.DryveRail`, by its names."""

    host: str
    port: int
    units_per_m: float
    centre_m: float
    acceleration_m_s2: float
    quick_stop_m_s2: float
    timeout_s: float
    hold_s: float
    time_to_live_s: float
    reversed: bool = False
    asks_homed: bool = True

    @property
    def sense(self) -> int:
        """+1 where the axis counts up towards +y; -1 where it counts down."""
        return -1 if self.reversed else 1

    def units(self, metres: float) -> int:
        """Drive units of a size: 60A8h, the same for position, velocity and acceleration."""
        return round(metres * self.units_per_m)

    def velocity_units(self, velocity_m_s: float) -> int:
        """As the drive counts a velocity along y."""
        return self.sense * self.units(velocity_m_s)

    def velocity_m_s(self, units: int) -> float:
        """Along y, of a velocity as the drive counts it."""
        return self.sense * (units / self.units_per_m)

    def position_m(self, units: int) -> float:
        """Along y from the middle of the rail, of a position as the drive counts it."""
        return self.sense * (units / self.units_per_m - self.centre_m)

    def axis_m(self, position_m: float) -> float:
        """From the drive's own zero, the way that it counts, of a place from the middle of the rail."""
        return self.sense * position_m + self.centre_m


def settings_of(config: "DryveRail") -> Settings:
    """The configuration's."""
    return Settings(**{name: value for name, value in config.model_dump().items() if name in Settings._fields})
