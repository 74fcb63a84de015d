"""What one poll of the drive finds, and what it means."""

from collections.abc import Callable
from typing import NamedTuple

from softarm.drivers.rail import dryve
from softarm.drivers.rail.cia402 import DriveState, StatusWord, decode_state
from softarm.drivers.rail.dryve_link import DryveLink
from softarm.drivers.rail.settings import Settings

AT_REST_M_S = 0.02  # a swinging arm keeps pulling at a cart that stands
FAULTY = (DriveState.FAULT, DriveState.FAULT_REACTION)
_AT_EASE = (DriveState.NOT_READY, DriveState.SWITCH_ON_DISABLED, DriveState.READY, DriveState.FAULT, DriveState.INVALID)


class Feedback(NamedTuple):
    """What one poll of the drive found."""

    t_ns: int  # when the position was asked for
    state: DriveState
    statusword: int
    position_m: float
    velocity_m_s: float
    error_code: int

    @property
    def remote(self) -> bool:
        """The enable input DI7."""
        return bool(self.statusword & StatusWord.REMOTE)

    @property
    def at_rest(self) -> bool:
        """No speed worth braking."""
        return abs(self.velocity_m_s) < AT_REST_M_S

    @property
    def at_ease(self) -> bool:
        """Out of operation."""
        return self.state in _AT_EASE

    def faults(self) -> tuple[str, ...]:
        """The drive's fault in words."""
        if self.state is DriveState.INVALID:
            return (f"{self.state.value} (statusword 0x{self.statusword:04X})",)
        if self.state in FAULTY:
            return (f"{dryve.ERROR_CODES.get(self.error_code, 'unknown error')} (0x{self.error_code:04X})",)
        return ()


def poll(drive: DryveLink, settings: Settings, clock: Callable[[], int]) -> Feedback:
    """Ask for all of it. `clock`: nanoseconds. Raises as `DryveLink.read`."""
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


def homed(drive: DryveLink) -> bool | None:
    """What the drive says of its zero; None of one that refuses the question or is silent. Else raises as `read`."""
    try:
        return bool(drive.read(dryve.HOMING_STATUS) & 1)
    except (dryve.DryveRefusal, dryve.DryveMismatch, TimeoutError):  # the object is the vendor's, and optional
        return None
