"""State machine of the drive, decoded from its statusword."""

from softarm.drivers.rail.cia402 import DriveState, decode_state, next_controlword

# The standard's table: low byte of the statusword, x for bits that do not encode the state.
STANDARD = {
    "x0xx0000": DriveState.NOT_READY,
    "x1xx0000": DriveState.SWITCH_ON_DISABLED,
    "x01x0001": DriveState.READY,
    "x01x0011": DriveState.SWITCHED_ON,
    "x01x0111": DriveState.OPERATION_ENABLED,
    "x00x0111": DriveState.QUICK_STOP,
    "x0xx1111": DriveState.FAULT_REACTION,
    "x0xx1000": DriveState.FAULT,
}
TOWARDS_OPERATION = {
    DriveState.SWITCH_ON_DISABLED: 0x0006,
    DriveState.READY: 0x0007,
    DriveState.SWITCHED_ON: 0x000F,
}


def fits(low_byte: int, pattern: str) -> bool:
    return all(bit in ("x", shown) for bit, shown in zip(pattern, f"{low_byte:08b}", strict=True))


def test_every_statusword_decodes_as_in_the_standards_table() -> None:
    for low_byte in range(256):
        states = [state for pattern, state in STANDARD.items() if fits(low_byte, pattern)]
        for upper_byte in range(256):
            assert [decode_state(upper_byte << 8 | low_byte)] == (states or [DriveState.INVALID])


def test_each_state_has_one_controlword_and_no_word_resets_a_fault_or_ends_a_quick_stop() -> None:
    for state in DriveState:
        for at_rest in (False, True):
            assert next_controlword(state, True, at_rest) == TOWARDS_OPERATION.get(state)
            ends = state is DriveState.SWITCHED_ON or (state is DriveState.OPERATION_ENABLED and at_rest)
            assert next_controlword(state, False, at_rest) == (0x0006 if ends else None)
