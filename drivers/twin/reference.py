"""What the twin's drive knows of where it is: its zero, and the search for it by the switch at the rail's low end."""

from enum import Enum, auto

from softarm.schemas.robot import RAIL_TRAVEL_M

METHOD = 17  # of CiA 402: the negative limit switch, whose edge is looked for
SWITCH_M = -(RAIL_TRAVEL_M - 0.015)  # of the cart from the middle; below it the switch is closed


class _Search(Enum):
    TO_THE_SWITCH = auto()
    OFF_THE_SWITCH = auto()


class Reference:
    """Pure. `offset_m` is by how much the axis reads too much: 0 of one that is homed."""

    def __init__(self) -> None:
        self.homed, self.offset_m = True, 0.0
        self.attained = self.failed = False  # of the newest search
        self._search: _Search | None = None

    @property
    def searching(self) -> bool:
        """Is a search under way?"""
        return self._search is not None

    def forget(self, axis_m: float) -> None:
        """As an incremental axis does without supply: its zero is where it stands, `axis_m` by the true one."""
        self.homed, self.offset_m = False, -axis_m
        self.attained = self.failed = False
        self._search = None

    def begin(self, speed: int) -> None:
        """Look for the switch; at no speed there is nothing to be found."""
        self.attained, self.failed = False, speed == 0
        self._search = None if self.failed else _Search.TO_THE_SWITCH

    def break_off(self) -> None:
        """Until the next begin."""
        self._search = None

    def see(self, position_m: float) -> None:
        """Take notice of the cart, by its place from the middle."""
        closed = position_m <= SWITCH_M
        if self._search is _Search.TO_THE_SWITCH and closed:
            self._search = _Search.OFF_THE_SWITCH
        elif self._search is _Search.OFF_THE_SWITCH and not closed:
            self._search = None
            self.homed, self.offset_m, self.attained = True, 0.0, True

    def velocity(self, speed: int, creep: int) -> int:
        """What the motor is told, in the units of both."""
        match self._search:
            case _Search.TO_THE_SWITCH:
                return -speed
            case _Search.OFF_THE_SWITCH:
                return creep
        return 0
