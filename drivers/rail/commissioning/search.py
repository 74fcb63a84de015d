"""The drive's search for its zero, seen from the master: what it shows goes in, the next controlword comes out. Pure.

One word moves, 001Fh, and it is said once, to a drive that is in operation and stands. Whatever then goes wrong, or a
person's Ctrl-C, is answered by 010Fh, which brakes; at rest the drive is switched off. Nothing after that moves.
"""

from enum import Enum, auto

from softarm.drivers.rail.cia402 import ControlWord, DriveState, StatusWord, next_controlword
from softarm.drivers.rail.feedback import Feedback
from softarm.drivers.rail.rest import BRAKE_MAX_S
from softarm.schemas.robot import RAIL_TRAVEL_M

WALK_MAX_S = 2.0  # from switch-on disabled to operation enabled
STILL_MAX_S = 3.0  # no method lets the axis stand for longer before it is done
OFF_MAX_S = 1.0
OLD_BITS_S = 0.25  # after 001Fh what the statusword says of a search may be of the one before
MOVED_M = 0.001
PATH_MAX_M = 2 * (2 * RAIL_TRAVEL_M) + 0.1  # to one end and to the other
FASTER, TOO_FAST_M_S, TOO_FAST_POLLS = 2.0, 0.02, 3  # than was asked, beyond that, in a row
WHERE_IT_STANDS = (35, 37)  # methods that take this for the zero: nothing moves

_OTHER_CAUSE = "look at the drive's web page for the cause; nothing else moved"


class _Phase(Enum):
    WALK = auto()
    SEARCH = auto()
    BRAKE = auto()
    OFF = auto()
    OVER = auto()


class Search:
    """From a drive that is off, in homing mode and set up, to one that is off and homed, or to what went wrong."""

    def __init__(self, speed_m_s: float, creep_m_s: float, method: int | None, begun_ns: int) -> None:
        """`speed_m_s` towards the switch, `creep_m_s` towards the zero; `method`: the drive's own, where it says."""
        self.failure: tuple[str, str] | None = None  # what went wrong, and the next step
        self.started = False  # 001Fh was handed out
        self._speed_m_s, self._method = speed_m_s, method
        longest_s = PATH_MAX_M / speed_m_s + 0.1 * RAIL_TRAVEL_M / creep_m_s + 2 * STILL_MAX_S
        self._due_ns = begun_ns + round((WALK_MAX_S + longest_s) * 1e9)
        self._phase, self._since_ns = _Phase.WALK, begun_ns
        self._walked: DriveState | None = None  # in which the last word of the walk was said
        self._renewed = False  # bit 12 was seen low: what it says next is of this search
        self._moved_ns = begun_ns
        self._last_m = self._path_m = 0.0
        self._fast_polls = 0

    @property
    def over(self) -> bool:
        """Nothing more will be said."""
        return self._phase is _Phase.OVER

    @property
    def may_move(self) -> bool:
        """As far as is known the drive is in operation."""
        return self._phase in (_Phase.SEARCH, _Phase.BRAKE)

    def next(self, seen: Feedback, stop: bool) -> int | None:
        """The controlword to say now, once; None: nothing. `stop`: a person wants it to end."""
        match self._phase:
            case _Phase.WALK:
                return self._walk(seen, stop)
            case _Phase.SEARCH:
                return self._search(seen, stop)
            case _Phase.BRAKE | _Phase.OFF:
                return self._end(seen)
        return None

    def _walk(self, seen: Feedback, stop: bool) -> int | None:
        trouble = self._trouble(seen, stop)
        if trouble is None and seen.t_ns - self._since_ns > WALK_MAX_S * 1e9:
            where = f"'{seen.state.value}' (statusword 0x{seen.statusword:04X})"
            trouble = f"the drive stays in {where}", "check DI7, load supply and the drive's web page"
        if trouble is not None:
            return self._fail(seen, *trouble)
        if seen.state is DriveState.OPERATION_ENABLED:
            if self._walked is not DriveState.SWITCHED_ON:
                return self._fail(seen, "the drive is in operation, and not by us", "see that no other master leads it")
            self._phase, self._since_ns, self._moved_ns = _Phase.SEARCH, seen.t_ns, seen.t_ns
            self._renewed = not seen.statusword & StatusWord.HOMING_ATTAINED
            self._last_m = seen.position_m
            self.started = True
            return ControlWord.START_HOMING
        if seen.state is self._walked:
            return None
        self._walked = seen.state
        return next_controlword(seen.state, enable=True, at_rest=False)

    def _search(self, seen: Feedback, stop: bool) -> int | None:
        self._follow(seen)
        trouble = self._trouble(seen, stop) or self._astray(seen)
        if trouble is not None:
            return self._fail(seen, *trouble)
        attained, reached = (seen.statusword & bit for bit in (StatusWord.HOMING_ATTAINED, StatusWord.TARGET_REACHED))
        self._renewed |= not attained
        still_s = (seen.t_ns - self._moved_ns) * 1e-9
        fresh = self._renewed or (self._method in WHERE_IT_STANDS and still_s > OLD_BITS_S)
        if attained and reached and fresh:
            return self._brake(seen)
        if still_s > STILL_MAX_S:
            return self._fail(
                seen,
                f"the cart has not moved for {STILL_MAX_S:g} s and the drive does not say that it is homed",
                "see that nothing holds the cart, that the available stroke (607Bh:2) is not 0 and which homing method "
                "the drive's web page shows",
            )
        if seen.t_ns > self._due_ns:
            return self._fail(seen, "the search takes too long", "see whether the switch of the homing method is there")
        return None

    def _trouble(self, seen: Feedback, stop: bool) -> tuple[str, str] | None:
        """What ends a walk and a search alike."""
        if seen.faults():
            return f"the drive reports {', '.join(seen.faults())}", "see to its cause, then --reset-fault"
        if not seen.remote:
            return "the enable input DI7 is low", "release the hardware e-stop, and home anew"
        if stop:
            return "it was broken off by a person", "what the axis shows is not to be trusted until it is homed"
        if self._phase is _Phase.SEARCH and seen.state is not DriveState.OPERATION_ENABLED:
            return f"the drive fell back to '{seen.state.value}' by itself", _OTHER_CAUSE
        return None

    def _astray(self, seen: Feedback) -> tuple[str, str] | None:
        if seen.statusword & StatusWord.HOMING_ERROR and (seen.t_ns - self._since_ns) * 1e-9 > OLD_BITS_S:
            return "the drive says that homing failed (bit 13 of 6041h)", _OTHER_CAUSE
        if self._fast_polls >= TOO_FAST_POLLS:
            return (
                f"the cart runs at {abs(seen.velocity_m_s):.3f} m/s, {self._speed_m_s:g} m/s were asked for",
                "compare drivers.rail.units_per_m with the feed that the drive's web page shows",
            )
        if self._path_m > PATH_MAX_M:
            return (
                f"the cart has gone {self._path_m:.2f} m by the axis, the rail has {2 * RAIL_TRAVEL_M:g} m",
                "see whether the switch of the homing method is there, and drivers.rail.units_per_m",
            )
        return None

    def _follow(self, seen: Feedback) -> None:
        """Way, standstill and speed. The step of the axis as its zero is set is no way."""
        step_m = abs(seen.position_m - self._last_m)
        if step_m >= MOVED_M:
            self._path_m += step_m if step_m < 0.02 else 0.0
            self._last_m, self._moved_ns = seen.position_m, seen.t_ns
        too_fast = abs(seen.velocity_m_s) > FASTER * self._speed_m_s + TOO_FAST_M_S
        self._fast_polls = self._fast_polls + 1 if too_fast else 0

    def _fail(self, seen: Feedback, what: str, remedy: str) -> int | None:
        self.failure = what, remedy
        return self._brake(seen, ControlWord.ENABLE_AND_HALT)

    def _brake(self, seen: Feedback, word: int | None = None) -> int | None:
        self._phase, self._since_ns = _Phase.BRAKE, seen.t_ns
        if seen.state is DriveState.OPERATION_ENABLED:
            return word
        return self._end(seen)

    def _end(self, seen: Feedback) -> int | None:
        """Switch off at rest, or when it has braked for long enough, once; then see that it is off."""
        for_s = (seen.t_ns - self._since_ns) * 1e-9
        if self._phase is _Phase.BRAKE:
            word = next_controlword(seen.state, enable=False, at_rest=seen.at_rest or for_s > BRAKE_MAX_S)
            if word is not None or seen.at_ease or for_s > BRAKE_MAX_S:
                self._phase, self._since_ns = _Phase.OFF, seen.t_ns
            return word
        if seen.at_ease:
            self._phase = _Phase.OVER
        elif for_s > OFF_MAX_S:
            self._phase = _Phase.OVER
            before = f"{self.failure[0]}; and then " if self.failure else ""
            where = f"'{seen.state.value}' (statusword 0x{seen.statusword:04X})"
            self.failure = f"{before}the drive does not switch off: it stays in {where}", "press the hardware e-stop"
        return None
