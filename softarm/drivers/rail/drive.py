"""The drive as its masters use it: one connection after another, each of which begins and ends with a stop."""

import contextlib
from collections.abc import Callable

from softarm.drivers.rail import dryve
from softarm.drivers.rail.cia402 import ControlWord
from softarm.drivers.rail.dryve_link import CONNECT_S, DryveLink, Wait
from softarm.drivers.rail.feedback import AT_REST_M_S, Feedback, poll
from softarm.drivers.rail.rest import Pause, bring_to_rest
from softarm.drivers.rail.settings import Settings


class Drive:
    """Drive at one address. `target` is the velocity that was sent last on this connection, in drive units.

    Every method but `close` raises one of `dryve_link.LINK_ERRORS`.
    """

    def __init__(self, settings: Settings, wait: Wait, pause: Pause) -> None:
        self.settings = settings
        self.target = 0
        self._wait, self._pause = wait, pause
        self._link: DryveLink | None = None

    @property
    def connected(self) -> bool:
        """Whether a connection is open."""
        return self._link is not None

    @property
    def link(self) -> DryveLink:
        """The open connection. Raises EOFError without one."""
        if self._link is None:
            raise EOFError("there is no connection")
        return self._link

    def open(self) -> None:
        """Connect, unless a connection is open."""
        if self._link is None:
            address = (self.settings.host, self.settings.port)
            self._link = DryveLink.open(address, self._wait, CONNECT_S, self.settings.timeout_s)

    def close(self) -> None:
        """Send a stop and close the connection, if one is open."""
        link, self._link = self._link, None
        self.target = 0
        if link is not None:
            link.close()

    def stop(self) -> None:
        """Send a stop without waiting for the answer."""
        self.target = 0
        self.link.stop()

    def brake(self) -> None:
        """Brake in any mode if a connection is open, without waiting for the answer; a broken one is ignored."""
        if self._link is not None:
            with contextlib.suppress(OSError):
                self._link.halt()

    def set_velocity(self, target: int) -> None:
        """Set the velocity in drive units."""
        self.target = target
        self.link.write(dryve.TARGET_VELOCITY, target)

    def bring_to_rest(self) -> bool:
        """Brake, disable the drive, and return whether it was in operation."""
        return bring_to_rest(self.link, self.settings.units(AT_REST_M_S), self._pause)

    def configure_velocity_mode(self) -> str | None:
        """Set the mode and the ramps, read them back and return the first difference as text, or None."""
        drive, settings = self.link, self.settings
        difference = drive.configure_mode(dryve.PROFILE_VELOCITY, self._pause)
        ramp = settings.units(settings.acceleration_m_s2)
        for entry, value in (
            (dryve.ACCELERATION, ramp),
            (dryve.DECELERATION, ramp),
            (dryve.QUICK_STOP, settings.units(settings.quick_stop_m_s2)),
        ):
            found = drive.configure(entry, value)
            difference = difference or found
        return difference

    def reset_fault(self) -> None:
        """Reset the fault. Bit 7 acts on its rising edge, and the D1 then needs HALT before it can be enabled."""
        for word in (ControlWord.RESET_AND_HALT, ControlWord.FAULT_RESET, ControlWord.RESET_AND_HALT):
            self.link.write(dryve.CONTROLWORD, word)

    def poll(self, clock: Callable[[], int]) -> Feedback:
        """Read the drive's state, stamped by `clock` in ns."""
        return poll(self.link, self.settings, clock)
