"""A tool's visit to a drive that no daemon leads: one connection after another, a stop first and last on each.

What it does beside looking is `home`: the drive's own search for its zero.
"""

import contextlib
import select
import socket
import time
from collections.abc import Callable
from types import TracebackType
from typing import NamedTuple, Self, TypeVar

from softarm.drivers.base import DeviceError
from softarm.drivers.rail import dryve, feedback
from softarm.drivers.rail.cia402 import ControlWord, DriveState
from softarm.drivers.rail.commissioning.search import Search
from softarm.drivers.rail.dryve_link import CONNECT_S, EXCHANGE_ERRORS, LINK_ERRORS, DryveLink, explained
from softarm.drivers.rail.feedback import AT_REST_M_S, Feedback
from softarm.drivers.rail.rest import come_to_rest
from softarm.drivers.rail.settings import Settings

T = TypeVar("T")

POLL_S = 0.02
AGAIN_S = 2.0  # how long a drive that may move is tried for when its connection is gone
ACCELERATION_M_S2 = 0.5  # of a search

METHODS = {  # of CiA 402, as far as the D1 has them
    -1: "to an end of travel, felt by the motor",
    17: "to the negative limit switch",
    18: "to the positive limit switch",
    33: "to the encoder's index, the negative way",
    34: "to the encoder's index, the positive way",
    35: "none: it takes the place where it stands for its zero",
    37: "none: it takes the place where it stands for its zero",
}


class Homed(NamedTuple):
    """What came of a search that went well."""

    position_m: float  # of the cart from the middle of the rail, by `drivers.rail.centre_m`
    axis_m: float  # from the drive's zero
    confirmed: bool | None  # the drive says that it is homed (2014h); None: it does not say


class Visit:
    """Use as `with Visit(settings) as drive`. On entry the drive is brought to rest and left off, whoever led it.

    Every call raises DeviceError where the drive does not answer or does not take what it is told.
    """

    def __init__(
        self,
        settings: Settings,
        clock: Callable[[], int] = time.monotonic_ns,
        pause: Callable[[float], object] = time.sleep,
        beside: Callable[[], object] = lambda: None,
    ) -> None:
        """`beside` is called at each exchange, some hundred times a second while the drive searches."""
        self.settings, self.clock, self.pause = settings, clock, pause
        self._beside = beside
        self._link: DryveLink | None = None
        self.found_in_operation = False  # when it was visited

    def __enter__(self) -> Self:
        try:
            self.found_in_operation = self._begin()
        except LINK_ERRORS as error:
            self._close()
            raise self._explained(error) from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close()

    def look(self) -> Feedback:
        """How the drive is."""
        return self._asked(lambda drive: feedback.poll(drive, self.settings, self.clock))

    def homed(self) -> bool | None:
        """What the drive says of its zero; None: it does not say."""
        return self._asked(feedback.homed)

    def method(self) -> int | None:
        """The drive's own way to its zero (`METHODS`); None: it does not say."""

        def ask(drive: DryveLink) -> int | None:
            try:
                return drive.read(dryve.HOMING_METHOD)
            except (dryve.DryveRefusal, dryve.DryveMismatch):
                return None

        return self._asked(ask)

    def reset_fault(self) -> None:
        """Of a drive in fault, as when a person acknowledges; nothing moves."""

        def reset(drive: DryveLink) -> None:
            for word in (ControlWord.RESET_AND_HALT, ControlWord.FAULT_RESET, ControlWord.RESET_AND_HALT):
                drive.write(dryve.CONTROLWORD, word)

        if self.look().state is DriveState.FAULT:
            self._asked(reset)

    def home(
        self,
        speed_m_s: float,
        creep_m_s: float,
        stop: Callable[[], bool] = lambda: False,
        tell: Callable[[Feedback], object] = lambda seen: None,
    ) -> Homed:
        """Have the drive find its zero by its own method; it is off when this returns or raises.

        `stop` is asked all the while: True brakes and switches off. `tell` hears what every poll found.
        """
        method = self.method()
        self._asked(lambda drive: self._set_up(drive, speed_m_s, creep_m_s))
        search = Search(speed_m_s, creep_m_s, method, self.clock())
        try:
            self._search(search, stop, tell)
        except LINK_ERRORS as error:
            raise self._lost(error, search) from error
        if search.failure is not None:
            raise self._error("home", *search.failure)
        self._asked(lambda drive: drive.write(dryve.MODE, dryve.PROFILE_VELOCITY))
        seen, confirmed = self.look(), self.homed()
        if confirmed is False:
            raise self._error(
                "home", "the search ended well, and yet the drive says that it is not homed (2014h)", "home it anew"
            )
        return Homed(seen.position_m, self.settings.axis_m(seen.position_m), confirmed)

    def _search(self, search: Search, stop: Callable[[], bool], tell: Callable[[Feedback], object]) -> None:
        missed = False
        while not search.over:
            try:
                seen = feedback.poll(self._drive, self.settings, self.clock)
            except EXCHANGE_ERRORS:
                if missed:
                    raise
                missed = True
                continue
            missed = False
            tell(seen)
            word = search.next(seen, stop())
            if word is not None:
                self._drive.write(dryve.CONTROLWORD, word)
            self.pause(POLL_S)

    def _set_up(self, drive: DryveLink, speed_m_s: float, creep_m_s: float) -> None:
        """Homing mode, ramps and speeds, each read back. Nothing moves."""
        ramps, units = self.settings, self.settings.units
        for entry, value in (
            (dryve.DECELERATION, units(ramps.acceleration_m_s2)),
            (dryve.QUICK_STOP, units(ramps.quick_stop_m_s2)),
            (dryve.HOMING_SPEED, units(speed_m_s)),
            (dryve.HOMING_CREEP, units(creep_m_s)),
            (dryve.HOMING_ACCELERATION, units(ACCELERATION_M_S2)),
        ):
            if (untaken := drive.configure(entry, value)) is not None:
                remedy = "set it on the drive's web page, or choose another --speed; nothing moved"
                raise self._error("set up", untaken, remedy)
        if (untaken := drive.configure_mode(dryve.HOMING, self.pause)) is not None:
            raise self._error("set up", untaken, "look at the drive's web page; nothing moved")

    def _lost(self, error: Exception, search: Search) -> DeviceError:
        """The connection failed: brake on it while it lasts, then on new ones; say what came of it."""
        if search.may_move and self._link is not None:
            with contextlib.suppress(OSError):  # the connection is broken
                self._link.halt()
        until_s = time.monotonic() + AGAIN_S
        while True:
            self._close()
            try:
                self._begin()
                state = "it was switched off over a new one"
                break
            except LINK_ERRORS:
                if time.monotonic() > until_s:
                    state = "the drive cannot be reached, and MAY STILL MOVE: press the hardware e-stop"
                    break
                self.pause(POLL_S)
        command, problem, remedy = explained(error, connected=True)
        return self._error(command, f"the connection failed while it homed ({problem}); {state}", remedy)

    # The link

    def _begin(self) -> bool:
        """Connect and bring the drive to rest. Whether it was in operation."""
        self._link = DryveLink.open(
            (self.settings.host, self.settings.port), self._wait, CONNECT_S, self.settings.timeout_s
        )
        return come_to_rest(self._link, self.settings.units(AT_REST_M_S), self.pause)

    def _wait(self, line: socket.socket, events: int, seconds: float) -> bool:
        """As `dryve_link.Wait`."""
        self._beside()
        poll = select.poll()
        poll.register(line, events)
        return bool(poll.poll(1e3 * max(0.0, seconds)))

    @property
    def _drive(self) -> DryveLink:
        if self._link is None:
            raise EOFError("there is no connection")
        return self._link

    def _asked(self, ask: Callable[[DryveLink], T]) -> T:
        try:
            return ask(self._drive)
        except LINK_ERRORS as error:
            raise self._explained(error) from error

    def _close(self) -> None:
        link, self._link = self._link, None
        if link is not None:
            link.close()

    def _explained(self, error: Exception) -> DeviceError:
        return self._error(*explained(error, connected=self._link is not None))

    def _error(self, command: str, problem: str, remedy: str) -> DeviceError:
        return DeviceError(f"{self.settings.host}:{self.settings.port}", command, problem, remedy)
