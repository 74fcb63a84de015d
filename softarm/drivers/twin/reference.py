"""Zero of the twin's drive, and its homing by the limit switch at the negative end of the rail."""

from enum import Enum, auto

from softarm.schemas.robot import RAIL_TRAVEL_M

# Homing method of CiA 402: the edge of the negative limit switch.
METHOD = 17
# Below this position of the cart the switch is closed.
SWITCH_M = -(RAIL_TRAVEL_M - 0.015)


class _Search(Enum):
    TO_THE_SWITCH = auto()
    OFF_THE_SWITCH = auto()


class Reference:
    """Zero and homing of the drive. Pure.

    `offset_m` is the error of the axis position, 0 on a homed axis. `attained` and `failed` describe the newest search.
    """

    def __init__(self) -> None:
        self.homed, self.offset_m = True, 0.0
        self.attained = self.failed = False
        self._search: _Search | None = None

    @property
    def searching(self) -> bool:
        """Whether a search is running."""
        return self._search is not None

    def forget(self, axis_m: float) -> None:
        """Lose the zero, as an incremental axis does without supply.

        Args:
            axis_m: Present position from the true zero, which becomes the new zero.
        """
        self.homed, self.offset_m = False, -axis_m
        self.attained = self.failed = False
        self._search = None

    def begin(self, speed: int) -> None:
        """Begin a search; with zero speed it fails at once."""
        self.attained, self.failed = False, speed == 0
        self._search = None if self.failed else _Search.TO_THE_SWITCH

    def cancel(self) -> None:
        """Cancel a running search."""
        self._search = None

    def update(self, position_m: float) -> None:
        """Advance the search by the cart's position from the middle of the rail."""
        closed = position_m <= SWITCH_M
        if self._search is _Search.TO_THE_SWITCH and closed:
            self._search = _Search.OFF_THE_SWITCH
        elif self._search is _Search.OFF_THE_SWITCH and not closed:
            self._search = None
            self.homed, self.offset_m, self.attained = True, 0.0, True

    def velocity(self, speed: int, creep: int) -> int:
        """Return the velocity of the search, in the units of the two speeds."""
        match self._search:
            case _Search.TO_THE_SWITCH:
                return -speed
            case _Search.OFF_THE_SWITCH:
                return creep
        return 0
