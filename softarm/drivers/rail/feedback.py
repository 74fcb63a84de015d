"""One poll of the drive: position, velocity, state and fault."""

from typing import NamedTuple

from softarm.drivers.rail import dryve
from softarm.drivers.rail.cia402 import DriveState, StatusWord

# A swinging arm keeps pulling at a cart at rest.
AT_REST_M_S = 0.02
FAULTY = (DriveState.FAULT, DriveState.FAULT_REACTION)
_OUT_OF_OPERATION = (
    DriveState.NOT_READY,
    DriveState.SWITCH_ON_DISABLED,
    DriveState.READY,
    DriveState.FAULT,
    DriveState.INVALID,
)


class Feedback(NamedTuple):
    """Result of one poll of the drive; `t_ns` is the time of the position request."""

    t_ns: int
    state: DriveState
    statusword: int
    position_m: float
    velocity_m_s: float
    error_code: int

    @property
    def remote(self) -> bool:
        """Whether the enable input DI7 is high."""
        return bool(self.statusword & StatusWord.REMOTE)

    @property
    def at_rest(self) -> bool:
        """Whether the cart is too slow to need braking."""
        return abs(self.velocity_m_s) < AT_REST_M_S

    @property
    def out_of_operation(self) -> bool:
        """Whether the drive is in a state in which it cannot move the cart."""
        return self.state in _OUT_OF_OPERATION

    def state_text(self) -> str:
        """Return the state's name and the statusword, for messages."""
        return f"'{self.state.value}' (statusword 0x{self.statusword:04X})"

    def faults(self) -> tuple[str, ...]:
        """Return the drive's fault in words; empty without one."""
        if self.state is DriveState.INVALID:
            return (f"{self.state.value} (statusword 0x{self.statusword:04X})",)
        if self.state in FAULTY:
            return (f"{dryve.ERROR_CODES.get(self.error_code, 'unknown error')} (0x{self.error_code:04X})",)
        return ()
