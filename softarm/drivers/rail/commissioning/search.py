"""The drive's homing as its master sees it: feedback goes in, the next controlword comes out. Pure.

One controlword moves the cart, 001Fh. It is sent once, to a drive in operation at rest. Any failure, or Ctrl-C, is
answered by 010Fh, which brakes; at rest the drive is disabled. Nothing moves after that.
"""

from enum import Enum, auto

from softarm.drivers.rail.cia402 import ControlWord, DriveState, StatusWord, next_controlword
from softarm.drivers.rail.enabling import BRAKE_MAX_S, ENABLE_MAX_S
from softarm.drivers.rail.feedback import Feedback
from softarm.schemas.robot import RAIL_TRAVEL_M

# No homing method leaves the axis at rest for longer before it has finished.
STILL_MAX_S = 3.0
OFF_MAX_S = 1.0
# For this time after 001Fh the statusword may still describe the search before.
OLD_BITS_S = 0.25
MOVED_M = 0.001
# To one end and to the other.
PATH_MAX_M = 2 * (2 * RAIL_TRAVEL_M) + 0.1
# Too fast: faster than requested by this factor and margin, in so many polls in a row.
FASTER, TOO_FAST_M_S, TOO_FAST_POLLS = 2.0, 0.02, 3
# Methods that take the present position as the zero: nothing moves.
WITHOUT_MOTION = (35, 37)

_OTHER_CAUSE = "look for the cause on the drive's web page; nothing else moved"


class _Phase(Enum):
    ENABLE = auto()
    SEARCH = auto()
    BRAKE = auto()
    OFF = auto()
    OVER = auto()


class Search:
    """One homing of a configured drive in homing mode, from disabled to disabled.

    `failure` is the cause and the next step of a failed homing.
    """

    def __init__(self, speed_m_s: float, creep_m_s: float, method: int | None, begun_ns: int) -> None:
        """Begin a search at a speed towards the switch and a creep towards the zero; `method` is the drive's."""
        self.failure: tuple[str, str] | None = None
        self._speed_m_s, self._method = speed_m_s, method
        longest_s = PATH_MAX_M / speed_m_s + 0.1 * RAIL_TRAVEL_M / creep_m_s + 2 * STILL_MAX_S
        self._due_ns = begun_ns + round((ENABLE_MAX_S + longest_s) * 1e9)
        self._phase, self._since_ns = _Phase.ENABLE, begun_ns
        # State for which the last controlword was sent.
        self._answered: DriveState | None = None
        # Bit 12 was low, so its next rise belongs to this search.
        self._renewed = False
        self._moved_ns = begun_ns
        self._last_m = self._path_m = 0.0
        self._fast_polls = 0

    @property
    def over(self) -> bool:
        """Whether the search has ended and sends nothing more."""
        return self._phase is _Phase.OVER

    @property
    def may_move(self) -> bool:
        """Whether the drive is in operation, as far as is known."""
        return self._phase in (_Phase.SEARCH, _Phase.BRAKE)

    def next(self, seen: Feedback, stop: bool) -> int | None:
        """Return the controlword to send once now, or None. `stop` ends the search."""
        match self._phase:
            case _Phase.ENABLE:
                return self._enable(seen, stop)
            case _Phase.SEARCH:
                return self._search(seen, stop)
            case _Phase.BRAKE | _Phase.OFF:
                return self._end(seen)
        return None

    def _enable(self, seen: Feedback, stop: bool) -> int | None:
        failure = self._common_failure(seen, stop)
        if failure is None and seen.t_ns - self._since_ns > ENABLE_MAX_S * 1e9:
            failure = f"the drive stays in {seen.state_text()}", "check DI7, load supply and the drive's web page"
        if failure is not None:
            return self._fail(seen, *failure)
        if seen.state is DriveState.OPERATION_ENABLED:
            if self._answered is not DriveState.SWITCHED_ON:
                return self._fail(seen, "another master has enabled the drive", "disconnect the other master")
            self._phase, self._since_ns, self._moved_ns = _Phase.SEARCH, seen.t_ns, seen.t_ns
            self._renewed = not seen.statusword & StatusWord.HOMING_ATTAINED
            self._last_m = seen.position_m
            return ControlWord.START_HOMING
        if seen.state is self._answered:
            return None
        self._answered = seen.state
        return next_controlword(seen.state, enable=True, at_rest=False)

    def _search(self, seen: Feedback, stop: bool) -> int | None:
        self._follow(seen)
        failure = self._common_failure(seen, stop) or self._search_failure(seen)
        if failure is not None:
            return self._fail(seen, *failure)
        attained, reached = (seen.statusword & bit for bit in (StatusWord.HOMING_ATTAINED, StatusWord.TARGET_REACHED))
        self._renewed |= not attained
        still_s = (seen.t_ns - self._moved_ns) * 1e-9
        fresh = self._renewed or (self._method in WITHOUT_MOTION and still_s > OLD_BITS_S)
        if attained and reached and fresh:
            return self._brake(seen)
        if still_s > STILL_MAX_S:
            return self._fail(
                seen,
                f"the cart has not moved for {STILL_MAX_S:g} s and the drive does not report that it is homed",
                "free the cart; on the drive's web page, check the homing method, and that the available stroke "
                "(607Bh:2) is not 0",
            )
        if seen.t_ns > self._due_ns:
            return self._fail(seen, "the search takes too long", "check that the switch of the homing method exists")
        return None

    def _common_failure(self, seen: Feedback, stop: bool) -> tuple[str, str] | None:
        """Return a failure that ends every phase, or None."""
        if seen.faults():
            return f"the drive reports {', '.join(seen.faults())}", "remove its cause, then --reset-fault"
        if not seen.remote:
            return "the enable input DI7 is low", "release the hardware e-stop, then home again"
        if stop:
            return "a person interrupted it", "home again: the position is wrong until then"
        if self._phase is _Phase.SEARCH and seen.state is not DriveState.OPERATION_ENABLED:
            return f"the drive fell back to '{seen.state.value}' by itself", _OTHER_CAUSE
        return None

    def _search_failure(self, seen: Feedback) -> tuple[str, str] | None:
        if seen.statusword & StatusWord.HOMING_ERROR and (seen.t_ns - self._since_ns) * 1e-9 > OLD_BITS_S:
            return "the drive reports that homing failed (bit 13 of 6041h)", _OTHER_CAUSE
        if self._fast_polls >= TOO_FAST_POLLS:
            return (
                f"the cart moves at {abs(seen.velocity_m_s):.3f} m/s, {self._speed_m_s:g} m/s were requested",
                "compare drivers.rail.units_per_m with the feed that the drive's web page shows",
            )
        if self._path_m > PATH_MAX_M:
            return (
                f"the axis counted {self._path_m:.2f} m, the rail is {2 * RAIL_TRAVEL_M:g} m long",
                "check that the switch of the homing method exists, and drivers.rail.units_per_m",
            )
        return None

    def _follow(self, seen: Feedback) -> None:
        """Update path, standstill and speed. The jump of the axis when its zero is set is not part of the path."""
        step_m = abs(seen.position_m - self._last_m)
        if step_m >= MOVED_M:
            self._path_m += step_m if step_m < 0.02 else 0.0
            self._last_m, self._moved_ns = seen.position_m, seen.t_ns
        too_fast = abs(seen.velocity_m_s) > FASTER * self._speed_m_s + TOO_FAST_M_S
        self._fast_polls = self._fast_polls + 1 if too_fast else 0

    def _fail(self, seen: Feedback, problem: str, remedy: str) -> int | None:
        self.failure = problem, remedy
        return self._brake(seen, ControlWord.ENABLE_AND_HALT)

    def _brake(self, seen: Feedback, word: int | None = None) -> int | None:
        self._phase, self._since_ns = _Phase.BRAKE, seen.t_ns
        if seen.state is DriveState.OPERATION_ENABLED:
            return word
        return self._end(seen)

    def _end(self, seen: Feedback) -> int | None:
        """Disable the drive once, at rest or after `BRAKE_MAX_S`, then check that it is disabled."""
        for_s = (seen.t_ns - self._since_ns) * 1e-9
        if self._phase is _Phase.BRAKE:
            word = next_controlword(seen.state, enable=False, at_rest=seen.at_rest or for_s > BRAKE_MAX_S)
            if word is not None or seen.out_of_operation or for_s > BRAKE_MAX_S:
                self._phase, self._since_ns = _Phase.OFF, seen.t_ns
            return word
        if seen.out_of_operation:
            self._phase = _Phase.OVER
        elif for_s > OFF_MAX_S:
            self._phase = _Phase.OVER
            before = f"{self.failure[0]}; and then " if self.failure else ""
            problem = f"{before}the drive cannot be disabled: it stays in {seen.state_text()}"
            self.failure = problem, "press the hardware e-stop"
        return None
