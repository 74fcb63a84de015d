"""Bringing a drive to rest from any state: the first action on every connection."""

import contextlib
import time
from collections.abc import Callable

from softarm.drivers.rail import dryve
from softarm.drivers.rail.cia402 import ControlWord, DriveState, decode_state
from softarm.drivers.rail.dryve_link import DryveLink

# From 1 m/s at 6 m/s^2 braking takes 0.17 s.
BRAKE_MAX_S = 1.0
# For a drive that refuses to report its state.
HALT_TRIES, HALT_PAUSE_S = 20, 0.01

# Waits for a number of seconds.
Pause = Callable[[float], object]


def bring_to_rest(drive: DryveLink, at_rest: int, pause: Pause) -> bool:
    """Halt the drive, wait up to `BRAKE_MAX_S` until it is slow, and disable it.

    Args:
        drive: Connection to the drive.
        at_rest: Speed below which the drive counts as at rest, in its own units.
        pause: Waits for a number of seconds.

    Returns:
        Whether the drive was in operation.

    Raises:
        Exception: One of `dryve_link.LINK_ERRORS`.
    """
    operating = _halt(drive, pause)
    until_s = time.monotonic() + BRAKE_MAX_S
    while abs(drive.read(dryve.VELOCITY)) > at_rest and time.monotonic() < until_s:
        pause(0.01)
    drive.write(dryve.CONTROLWORD, ControlWord.SHUTDOWN if operating else ControlWord.RESET_AND_HALT)
    return operating


def _halt(drive: DryveLink, pause: Pause) -> bool:
    """Brake a drive in operation and return whether it was; stop it blindly while it refuses to answer."""
    for left in reversed(range(HALT_TRIES)):
        try:
            operating = decode_state(drive.read(dryve.STATUSWORD)) is DriveState.OPERATION_ENABLED
            if operating:
                drive.write(dryve.TARGET_VELOCITY, 0)
                drive.write(dryve.CONTROLWORD, ControlWord.ENABLE_AND_HALT)
            return operating
        except dryve.DryveRefusal:
            if not left:
                raise
            pause(HALT_PAUSE_S)
            with contextlib.suppress(dryve.DryveRefusal):
                drive.write(dryve.TARGET_VELOCITY, 0)
    raise AssertionError("the last try returns or raises")
