"""State machine of a CiA 402 drive (IEC 61800-7-201) as its master sees it, including the D1's habits.

Pure: a statusword goes in, a state and the next controlword come out.
"""

from enum import Enum, IntFlag


class StatusWord(IntFlag):
    """Bits of the statusword (6041h) that do not encode the state.

    REMOTE is the D1's enable input DI7; while it is low, not even a fault reset works. Bit 12 means AT_REST in
    profile velocity mode and HOMING_ATTAINED in homing mode; bit 13 has a meaning in homing mode alone.
    """

    REMOTE = 1 << 9
    TARGET_REACHED = 1 << 10
    AT_REST = 1 << 12
    HOMING_ATTAINED = 1 << 12
    HOMING_ERROR = 1 << 13


class ControlWord:
    """Values of the controlword (6040h)."""

    SHUTDOWN = 0x0006
    SWITCH_ON = 0x0007
    ENABLE_OPERATION = 0x000F
    # Brakes in any mode.
    ENABLE_AND_HALT = 0x010F
    # Rising bit 4 is the only command that moves the cart in homing mode; falling bit 4 aborts the search.
    START_HOMING = 0x001F
    # Everything off: igus' samples begin with it, and the D1 needs it after a fault.
    RESET_AND_HALT = 0x0100
    # Acts on the rising edge of bit 7.
    FAULT_RESET = 0x0080


class DriveState(Enum):
    """States of a CiA 402 drive, and the D1's invalid boot state (seen as 0x2704)."""

    NOT_READY = "not ready to switch on"
    SWITCH_ON_DISABLED = "switch-on disabled"
    READY = "ready to switch on"
    SWITCHED_ON = "switched on"
    OPERATION_ENABLED = "operation enabled"
    QUICK_STOP = "quick stop active"
    FAULT_REACTION = "fault reaction active"
    FAULT = "fault"
    INVALID = "invalid boot state: power-cycle the drive"


STATES = (  # mask, value, state
    (0x4F, 0x00, DriveState.NOT_READY),
    (0x4F, 0x40, DriveState.SWITCH_ON_DISABLED),
    (0x6F, 0x21, DriveState.READY),
    (0x6F, 0x23, DriveState.SWITCHED_ON),
    (0x6F, 0x27, DriveState.OPERATION_ENABLED),
    (0x6F, 0x07, DriveState.QUICK_STOP),
    (0x4F, 0x0F, DriveState.FAULT_REACTION),
    (0x4F, 0x08, DriveState.FAULT),
)

_TOWARDS_OPERATION = {
    DriveState.SWITCH_ON_DISABLED: ControlWord.SHUTDOWN,
    DriveState.READY: ControlWord.SWITCH_ON,
    DriveState.SWITCHED_ON: ControlWord.ENABLE_OPERATION,
}


def decode_state(statusword: int) -> DriveState:
    """Return the state encoded in a statusword, or INVALID if no state matches."""
    return next((state for mask, value, state in STATES if statusword & mask == value), DriveState.INVALID)


def next_controlword(state: DriveState, enable: bool, at_rest: bool) -> int | None:
    """Return the controlword that leads on from `state`, or None if nothing is to be sent.

    Towards operation the drive is enabled step by step; a quick stop ends by itself. A drive in operation is shut
    down only `at_rest`, because its brake ramp ends with its power. A fault is never reset here.
    """
    if enable:
        return _TOWARDS_OPERATION.get(state)
    if state is DriveState.SWITCHED_ON or (state is DriveState.OPERATION_ENABLED and at_rest):
        return ControlWord.SHUTDOWN
    return None
