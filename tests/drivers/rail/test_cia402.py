"""The drive's state machine as the master reads it."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from softarm.drivers.rail.cia402 import ControlWord, DriveState, StatusWord, decode_state, next_controlword


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
def test_statuswords(statusword: int, state: DriveState) -> None:
    assert decode_state(statusword) is state


def test_remote_is_bit_9() -> None:
    assert 0x0640 & StatusWord.REMOTE
    assert not 0x0440 & StatusWord.REMOTE


def test_the_walk_up_takes_one_word_a_state() -> None:
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
def test_every_statusword_is_one_state(statusword: int) -> None:
    assert decode_state(statusword) in DriveState
    assert decode_state(statusword) is decode_state(statusword | 0xFF00)  # the upper byte says nothing of it
