"""The drive as its masters use it: one connection after another, each of which begins and ends with a stop."""

import contextlib
import time
from collections.abc import Callable

from softarm.drivers.rail import dryve
from softarm.drivers.rail.cia402 import ControlWord, DriveState, decode_state
from softarm.drivers.rail.dryve_link import CONNECT_S, DryveLink, Wait
from softarm.drivers.rail.enabling import BRAKE_MAX_S
from softarm.drivers.rail.feedback import AT_REST_M_S, FAULTY, Feedback
from softarm.drivers.rail.settings import Settings

# For a drive that refuses to report its state.
HALT_TRIES, HALT_PAUSE_S = 20, 0.01
BRAKE_PAUSE_S = 0.01


class Drive:
    """Drive at one address. `target` is the velocity that was sent last on this connection, in drive units.

    Every method but `close` raises one of `dryve_link.LINK_ERRORS`.
    """

    def __init__(self, settings: Settings, wait: Wait, pause: Callable[[float], object]) -> None:
        self.settings = settings
        self.target = 0
        self.is_halting = False  # found in operation by `bring_to_rest`, and not disabled yet
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
        self.link.send(dryve.TARGET_VELOCITY, 0)

    def brake(self) -> None:
        """Brake in any mode if a connection is open, without waiting for the answer; a broken one is ignored."""
        if self._link is not None:
            with contextlib.suppress(OSError):
                self._link.send(dryve.CONTROLWORD, ControlWord.ENABLE_AND_HALT)

    def set_velocity(self, target: int) -> None:
        """Set the velocity in drive units."""
        self.target = target
        self.link.write(dryve.TARGET_VELOCITY, target)

    def bring_to_rest(self) -> bool:
        """Brake for `BRAKE_MAX_S` at most, disable the drive, and return whether it was in operation.

        This is the first action on every connection, in any state of the drive.
        """
        drive, operating = self.link, self._halt()
        until_s = time.monotonic() + BRAKE_MAX_S
        at_rest = self.settings.units(AT_REST_M_S)
        while abs(drive.read(dryve.VELOCITY)) > at_rest and time.monotonic() < until_s:
            self._pause(BRAKE_PAUSE_S)
        drive.write(dryve.CONTROLWORD, ControlWord.SHUTDOWN if operating else ControlWord.RESET_AND_HALT)
        self.is_halting = False
        return operating

    def _halt(self) -> bool:
        """Brake a drive in operation and return whether it was; stop it blindly while it refuses to answer."""
        drive = self.link
        for left in reversed(range(HALT_TRIES)):
            try:
                operating = decode_state(drive.read(dryve.STATUSWORD)) is DriveState.OPERATION_ENABLED
                self.is_halting = operating
                if operating:
                    drive.write(dryve.TARGET_VELOCITY, 0)
                    drive.write(dryve.CONTROLWORD, ControlWord.ENABLE_AND_HALT)
                return operating
            except dryve.DryveRefusal:
                if not left:
                    raise
                self._pause(HALT_PAUSE_S)
                with contextlib.suppress(dryve.DryveRefusal):
                    drive.write(dryve.TARGET_VELOCITY, 0)
        raise AssertionError("the last try returns or raises")

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
        drive, settings = self.link, self.settings
        statusword = drive.read(dryve.STATUSWORD)
        t_ns = clock()
        position = drive.read(dryve.POSITION)
        velocity = drive.read(dryve.VELOCITY)
        state = decode_state(statusword)
        return Feedback(
            t_ns=t_ns,
            state=state,
            statusword=statusword,
            position_m=settings.position_m(position),
            velocity_m_s=settings.velocity_m_s(velocity),
            error_code=drive.read(dryve.ERROR_CODE) if state in FAULTY else 0,
        )

    def read_homed(self) -> bool | None:
        """Return whether the drive reports a valid zero, or None if it does not answer this optional object."""
        try:
            return bool(self.link.read(dryve.HOMING_STATUS) & 1)
        except (dryve.DryveRefusal, dryve.DryveMismatch, TimeoutError):
            return None
