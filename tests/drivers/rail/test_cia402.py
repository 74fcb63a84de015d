"""State machine of the drive, decoded from its statusword."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from softarm.drivers.rail.cia402 import ControlWord, DriveState, StatusWord, decode_state, next_controlword

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


def fits(low_byte: int, pattern: str) -> bool:
    return all(bit in ("x", shown) for bit, shown in zip(pattern, f"{low_byte:08b}", strict=True))


@pytest.mark.parametrize(
    ("statusword", "state"),
    [
        (0x0640, DriveState.SWITCH_ON_DISABLED),  # manual, page 103
        (0x0440, DriveState.SWITCH_ON_DISABLED),
        (0x0221, DriveState.READY),
        (0x0223, DriveState.SWITCHED_ON),
        (0x0627, DriveState.OPERATION_ENABLED),  # the others: seen on real drives
        (0x1627, DriveState.OPERATION_ENABLED),
        (0x0608, DriveState.FAULT),
        (0x2208, DriveState.FAULT),
        (0x1608, DriveState.FAULT),
        (0x020F, DriveState.FAULT_REACTION),
        (0x0207, DriveState.QUICK_STOP),
        (0x0200, DriveState.NOT_READY),
        (0x2704, DriveState.INVALID),
    ],
)
def test_a_statusword_decodes_to_its_state(statusword: int, state: DriveState) -> None:
    assert decode_state(statusword) is state


@pytest.mark.parametrize("low_byte", range(256))
def test_every_low_byte_decodes_as_in_the_standards_table(low_byte: int) -> None:
    states = [state for pattern, state in STANDARD.items() if fits(low_byte, pattern)]
    assert [decode_state(low_byte)] == (states or [DriveState.INVALID])


def bits(word: int) -> set[int]:
    return {bit for bit in range(16) if word >> bit & 1}


def test_bits_of_the_statusword_are_those_of_the_manual() -> None:
    assert [bits(flag) for flag in (StatusWord.REMOTE, StatusWord.TARGET_REACHED, StatusWord.AT_REST)] == [
        {9},
        {10},
        {12},
    ]
    assert [bits(flag) for flag in (StatusWord.HOMING_ATTAINED, StatusWord.HOMING_ERROR)] == [{12}, {13}]
    assert 0x0640 & StatusWord.REMOTE
    assert not 0x0440 & StatusWord.REMOTE


def test_controlwords_have_the_standards_bits() -> None:
    switch_on, voltage, no_quick_stop, operate, start, reset, halt = 0, 1, 2, 3, 4, 7, 8
    assert bits(ControlWord.SHUTDOWN) == {voltage, no_quick_stop}
    assert bits(ControlWord.SWITCH_ON) == {voltage, no_quick_stop, switch_on}
    assert bits(ControlWord.ENABLE_OPERATION) == {voltage, no_quick_stop, switch_on, operate}
    assert bits(ControlWord.ENABLE_AND_HALT) == {voltage, no_quick_stop, switch_on, operate, halt}
    assert bits(ControlWord.START_HOMING) == {voltage, no_quick_stop, switch_on, operate, start}
    assert bits(ControlWord.RESET_AND_HALT) == {halt}
    assert bits(ControlWord.FAULT_RESET) == {reset}


def test_each_state_towards_operation_has_one_controlword() -> None:
    words = [
        next_controlword(state, enable=True, at_rest=True)
        for state in (
            DriveState.SWITCH_ON_DISABLED,
            DriveState.READY,
            DriveState.SWITCHED_ON,
            DriveState.OPERATION_ENABLED,
        )
    ]
    assert words == [0x0006, 0x0007, 0x000F, None]


def test_operation_ends_only_at_rest() -> None:
    assert next_controlword(DriveState.OPERATION_ENABLED, enable=False, at_rest=False) is None
    assert next_controlword(DriveState.OPERATION_ENABLED, enable=False, at_rest=True) == ControlWord.SHUTDOWN


@pytest.mark.parametrize("at_rest", [False, True])
def test_a_drive_that_is_switched_on_but_not_in_operation_is_shut_down_at_once(at_rest: bool) -> None:
    assert next_controlword(DriveState.SWITCHED_ON, enable=False, at_rest=at_rest) == ControlWord.SHUTDOWN
    assert next_controlword(DriveState.READY, enable=False, at_rest=at_rest) is None


@given(st.sampled_from(DriveState), st.booleans(), st.booleans())
def test_no_word_resets_a_fault_or_ends_a_quick_stop(state: DriveState, enable: bool, at_rest: bool) -> None:
    word = next_controlword(state, enable, at_rest)
    assert word is None or not word & 0x80
    if state in (
        DriveState.FAULT,
        DriveState.FAULT_REACTION,
        DriveState.QUICK_STOP,
        DriveState.INVALID,
        DriveState.NOT_READY,
    ):
        assert word is None


@given(st.integers(0, 0xFFFF))
def test_the_upper_byte_does_not_change_the_state(statusword: int) -> None:
    assert decode_state(statusword) is decode_state(statusword | 0xFF00)
