"""Bring a drive to rest, whatever it does and whoever led it before: what each connection begins with."""

import contextlib
import time
from collections.abc import Callable

from softarm.drivers.rail import dryve
from softarm.drivers.rail.cia402 import ControlWord, DriveState, decode_state
from softarm.drivers.rail.dryve_link import DryveLink

BRAKE_MAX_S = 1.0  # from 1 m/s at 6 m/s^2 it takes 0.17 s
HALT_TRIES, HALT_AGAIN_S = 20, 0.01  # a drive that refuses to say how it is

Pause = Callable[[float], object]  # let so many seconds pass


def come_to_rest(drive: DryveLink, at_rest: int, pause: Pause) -> bool:
    """Halt, wait until it is slower than `at_rest` in its units, `BRAKE_MAX_S` at most, switch off.

    Whether it was in operation. Raises as `DryveLink.read`.
    """
    operating = _halt(drive, pause)
    until_s = time.monotonic() + BRAKE_MAX_S
    while abs(drive.read(dryve.VELOCITY)) > at_rest and time.monotonic() < until_s:
        pause(0.01)
    drive.write(dryve.CONTROLWORD, ControlWord.SHUTDOWN if operating else ControlWord.RESET_AND_HALT)
    return operating


def _halt(drive: DryveLink, pause: Pause) -> bool:
    """Whether the drive was in operation; if so it brakes now. While it refuses to say, it is told to stop."""
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
            pause(HALT_AGAIN_S)
            with contextlib.suppress(dryve.DryveRefusal):
                drive.write(dryve.TARGET_VELOCITY, 0)
    raise AssertionError("the last try returns or raises")
