"""Session of a tool with a drive that no daemon controls: polling, fault reset and homing.

Every connection begins and ends with a stop.
"""

import socket
import time
from collections.abc import Callable
from typing import NamedTuple, Self, TypeVar

from softarm.drivers.base import DeviceError
from softarm.drivers.rail import dryve
from softarm.drivers.rail.cia402 import DriveState
from softarm.drivers.rail.commissioning.search import Search
from softarm.drivers.rail.drive import Drive
from softarm.drivers.rail.dryve_link import EXCHANGE_ERRORS, LINK_ERRORS, describe_error, is_ready
from softarm.drivers.rail.feedback import Feedback
from softarm.drivers.rail.settings import Settings

T = TypeVar("T")

POLL_S = 0.02
# How long a drive that may move is retried after its connection failed.
RECONNECT_S = 2.0
# Acceleration of the homing.
ACCELERATION_M_S2 = 0.5

# Homing methods of CiA 402 that the D1 has.
METHODS = {
    -1: "to an end of travel, sensed by the motor",
    17: "to the negative limit switch",
    18: "to the positive limit switch",
    33: "to the encoder's index, in negative direction",
    34: "to the encoder's index, in positive direction",
    35: "none: the present position becomes the zero",
    37: "none: the present position becomes the zero",
}


class Homed(NamedTuple):
    """Result of a successful homing.

    `position_m` is the cart's position from the middle of the rail, `axis_m` from the drive's zero. `confirmed` is
    whether the drive reports that it is homed (2014h), or None if it does not report it.
    """

    position_m: float
    axis_m: float
    confirmed: bool | None


class DriveSession:
    """Context manager of a session. On entry the drive is brought to rest and disabled.

    `was_operating` is true if it was in operation then. Every method raises DeviceError if the drive does not answer,
    or does not accept a setting.
    """

    def __init__(
        self,
        settings: Settings,
        clock: Callable[[], int] = time.monotonic_ns,
        pause: Callable[[float], object] = time.sleep,
        on_exchange: Callable[[], object] = lambda: None,
    ) -> None:
        """Prepare a session; `on_exchange` is called some hundred times a second during a homing."""
        self.settings, self.clock, self.pause = settings, clock, pause
        self.was_operating = False
        self._on_exchange = on_exchange
        self._drive = Drive(settings, self._wait, pause)

    def __enter__(self) -> Self:
        try:
            self.was_operating = self._connect()
        except LINK_ERRORS as error:
            self._drive.close()
            raise self._described(error) from error
        return self

    def __exit__(self, *_: object) -> None:
        self._drive.close()

    def poll(self) -> Feedback:
        """Return the drive's present state."""
        return self._request(lambda: self._drive.poll(self.clock))

    def homed(self) -> bool | None:
        """Return whether the drive reports that it is homed, or None if it does not report it."""
        return self._request(self._drive.read_homed)

    def method(self) -> int | None:
        """Return the drive's homing method, a key of `METHODS`, or None if it does not report one."""

        def ask() -> int | None:
            try:
                return self._drive.link.read(dryve.HOMING_METHOD)
            except (dryve.DryveRefusal, dryve.DryveMismatch):
                return None

        return self._request(ask)

    def reset_fault(self) -> None:
        """Reset a drive in fault; nothing moves."""
        if self.poll().state is DriveState.FAULT:
            self._request(self._drive.reset_fault)

    def home(
        self,
        speed_m_s: float,
        creep_m_s: float,
        stop: Callable[[], bool] = lambda: False,
        report: Callable[[Feedback], object] = lambda seen: None,
    ) -> Homed:
        """Let the drive find its zero by its own method. It is disabled when this returns or raises.

        Args:
            speed_m_s: Speed towards the switch.
            creep_m_s: Speed towards the zero.
            stop: Called at every poll; True brakes and disables the drive.
            report: Receives the result of every poll.
        """
        method = self.method()
        self._request(lambda: self._configure(speed_m_s, creep_m_s))
        search = Search(speed_m_s, creep_m_s, method, self.clock())
        try:
            self._search(search, stop, report)
        except LINK_ERRORS as error:
            raise self._recover(error, search) from error
        if search.failure is not None:
            raise self._error("home", *search.failure)
        self._request(lambda: self._drive.link.write(dryve.MODE, dryve.PROFILE_VELOCITY))
        seen, confirmed = self.poll(), self.homed()
        if confirmed is False:
            problem = "the search succeeded, but the drive reports that it is not homed (2014h)"
            raise self._error("home", problem, "home it again")
        return Homed(seen.position_m, self.settings.axis_m(seen.position_m), confirmed)

    def _search(self, search: Search, stop: Callable[[], bool], report: Callable[[Feedback], object]) -> None:
        missed = False
        while not search.over:
            try:
                seen = self._drive.poll(self.clock)
            except EXCHANGE_ERRORS:
                if missed:
                    raise
                missed = True
                continue
            missed = False
            report(seen)
            word = search.next(seen, stop())
            if word is not None:
                self._drive.link.write(dryve.CONTROLWORD, word)
            self.pause(POLL_S)

    def _configure(self, speed_m_s: float, creep_m_s: float) -> None:
        """Set homing mode, ramps and speeds, and read each back. Nothing moves."""
        drive, ramps, units = self._drive.link, self.settings, self.settings.units
        for entry, value in (
            (dryve.DECELERATION, units(ramps.acceleration_m_s2)),
            (dryve.QUICK_STOP, units(ramps.quick_stop_m_s2)),
            (dryve.HOMING_SPEED, units(speed_m_s)),
            (dryve.HOMING_CREEP, units(creep_m_s)),
            (dryve.HOMING_ACCELERATION, units(ACCELERATION_M_S2)),
        ):
            if (difference := drive.configure(entry, value)) is not None:
                remedy = "set it on the drive's web page, or choose another --speed; nothing moved"
                raise self._error("configure", difference, remedy)
        if (difference := drive.configure_mode(dryve.HOMING, self.pause)) is not None:
            raise self._error("configure", difference, "check the drive's web page; nothing moved")

    def _recover(self, error: Exception, search: Search) -> DeviceError:
        """Brake on the failed connection and on new ones, and return the error with the outcome."""
        if search.may_move:
            self._drive.brake()
        until_s = time.monotonic() + RECONNECT_S
        while True:
            self._drive.close()
            try:
                self._connect()
                outcome = "a new connection disabled the drive"
                break
            except LINK_ERRORS:
                if time.monotonic() > until_s:
                    outcome = "the drive cannot be reached, and MAY STILL MOVE: press the hardware e-stop"
                    break
                self.pause(POLL_S)
        command, problem, remedy = describe_error(error, connected=True)
        return self._error(command, f"the connection failed during homing ({problem}); {outcome}", remedy)

    def _connect(self) -> bool:
        """Connect, bring the drive to rest and return whether it was in operation."""
        self._drive.open()
        return self._drive.bring_to_rest()

    def _wait(self, line: socket.socket, events: int, seconds: float) -> bool:
        self._on_exchange()
        return is_ready(line, events, seconds)

    def _request(self, ask: Callable[[], T]) -> T:
        try:
            return ask()
        except LINK_ERRORS as error:
            raise self._described(error) from error

    def _described(self, error: Exception) -> DeviceError:
        return self._error(*describe_error(error, connected=self._drive.connected))

    def _error(self, command: str, problem: str, remedy: str) -> DeviceError:
        return DeviceError(f"{self.settings.host}:{self.settings.port}", command, problem, remedy)
