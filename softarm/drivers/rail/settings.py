"""Settings of the axis for its masters, and the conversion of drive units to metres from the middle of the rail."""

from typing import TYPE_CHECKING, NamedTuple

# The rail's process must start fast, so it does not import the schemas.
if TYPE_CHECKING:
    from softarm.schemas.config import DryveRail


class Settings(NamedTuple):
    """The fields of `softarm.schemas.config.DryveRail` that a master needs, under the same names."""

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
        """+1 if the axis counts up towards +y, otherwise -1."""
        return -1 if self.reversed else 1

    def units(self, metres: float) -> int:
        """Return a magnitude in drive units (60A8h), the same for position, velocity and acceleration."""
        return round(metres * self.units_per_m)

    def velocity_units(self, velocity_m_s: float) -> int:
        """Return a velocity along y in drive units."""
        return self.sense * self.units(velocity_m_s)

    def velocity_m_s(self, units: int) -> float:
        """Return the velocity along y for a velocity in drive units."""
        return self.sense * (units / self.units_per_m)

    def position_m(self, units: int) -> float:
        """Return the position along y from the middle of the rail for a position in drive units."""
        return self.sense * (units / self.units_per_m - self.centre_m)

    def axis_m(self, position_m: float) -> float:
        """Return the distance from the drive's zero in its counting direction, for a position along y."""
        return self.sense * position_m + self.centre_m


def settings_of(config: "DryveRail") -> Settings:
    """Return the settings in a configuration."""
    return Settings(**{name: value for name, value in config.model_dump().items() if name in Settings._fields})
