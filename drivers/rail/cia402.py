"""The state machine of a CiA 402 drive (IEC 61800-7-201), seen from the master, with the D1's habits.

Pure: a statusword goes in, a state and the next controlword come out.
"""

from enum import Enum, IntFlag


class StatusWord(IntFlag):
    """Bits of the statusword (6041h) that are read beside the state."""

    REMOTE = 1 << 9  # the D1's enable input DI7; while it is low nothing works, not even a fault reset
    TARGET_REACHED = 1 << 10
    AT_REST = 1 << 12  # in profile velocity mode
    HOMING_ATTAINED = 1 << 12  # in homing mode
    HOMING_ERROR = 1 << 13  # in homing mode


class ControlWord:
    """Values of the controlword (6040h)."""

    SHUTDOWN = 0x0006
    SWITCH_ON = 0x0007
    ENABLE_OPERATION = 0x000F
    ENABLE_AND_HALT = 0x010F  # brakes in any mode
    START_HOMING = 0x001F  # bit 4 rises: the one word that moves in homing mode; as it falls the search is broken off
    RESET_AND_HALT = 0x0100  # everything off: igus' samples begin so, and the D1 wants it after a fault
    FAULT_RESET = 0x0080  # acts on the rising edge of bit 7


class DriveState(Enum):
    """Where the drive is."""

    NOT_READY = "not ready to switch on"
    SWITCH_ON_DISABLED = "switch-on disabled"
    READY = "ready to switch on"
    SWITCHED_ON = "switched on"
    OPERATION_ENABLED = "operation enabled"
    QUICK_STOP = "quick stop active"
    FAULT_REACTION = "fault reaction active"
    FAULT = "fault"
    INVALID = "invalid boot state: power-cycle the drive"  # seen on the D1 as 0x2704


_STATES = (  # mask, value, state
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
    """The state in a statusword; INVALID when it matches none."""
    return next((state for mask, value, state in _STATES if statusword & mask == value), DriveState.INVALID)


def next_controlword(state: DriveState, enable: bool, at_rest: bool) -> int | None:
    """The one controlword that leads on from `state`, or None where there is nothing to send.

    Towards operation the drive is walked up step by step; a quick stop is left to end by itself. Away from it
    the drive is shut down, but out of operation only `at_rest`: its brake ramp ends with its power. A fault
    is never reset here.
    """
    if enable:
        return _TOWARDS_OPERATION.get(state)
    if state is DriveState.SWITCHED_ON or (state is DriveState.OPERATION_ENABLED and at_rest):
        return ControlWord.SHUTDOWN
    return None
