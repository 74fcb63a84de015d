"""What one poll of the drive finds, and what it means."""

from typing import NamedTuple

from softarm.drivers.rail import dryve
from softarm.drivers.rail.cia402 import DriveState, StatusWord

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
