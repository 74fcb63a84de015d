"""The drive's state machine as the master reads it."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from softarm.drivers.rail.cia402 import Control, State, Status, decode_state, next_controlword


@pytest.mark.parametrize(
    ("statusword", "state"),
    [
        (0x0640, State.SWITCH_ON_DISABLED),  # manual, page 103
        (0x0440, State.SWITCH_ON_DISABLED),
        (0x0221, State.READY),
        (0x0223, State.SWITCHED_ON),
        (0x0627, State.OPERATION_ENABLED),  # the others: seen on real drives
        (0x1627, State.OPERATION_ENABLED),
        (0x0608, State.FAULT),
        (0x2208, State.FAULT),
        (0x1608, State.FAULT),
        (0x020F, State.FAULT_REACTION),
        (0x0207, State.QUICK_STOP),
        (0x0200, State.NOT_READY),
        (0x2704, State.INVALID),
    ],
)
def test_statuswords(statusword: int, state: State) -> None:
    assert decode_state(statusword) is state


def test_remote_is_bit_9() -> None:
    assert 0x0640 & Status.REMOTE
    assert not 0x0440 & Status.REMOTE


def test_the_walk_up_takes_one_word_a_state() -> None:
    words = [
        next_controlword(state, enable=True, at_rest=True)
        for state in (State.SWITCH_ON_DISABLED, State.READY, State.SWITCHED_ON, State.OPERATION_ENABLED)
    ]
    assert words == [0x0006, 0x0007, 0x000F, None]


def test_operation_ends_only_at_rest() -> None:
    assert next_controlword(State.OPERATION_ENABLED, enable=False, at_rest=False) is None
    assert next_controlword(State.OPERATION_ENABLED, enable=False, at_rest=True) == Control.SHUTDOWN


@given(st.sampled_from(State), st.booleans(), st.booleans())
def test_no_word_resets_a_fault_or_ends_a_quick_stop(state: State, enable: bool, at_rest: bool) -> None:
    word = next_controlword(state, enable, at_rest)
    assert word is None or not word & 0x80
    if state in (State.FAULT, State.FAULT_REACTION, State.QUICK_STOP, State.INVALID, State.NOT_READY):
        assert word is None


@given(st.integers(0, 0xFFFF))
def test_every_statusword_is_one_state(statusword: int) -> None:
    assert decode_state(statusword) in State
    assert decode_state(statusword) is decode_state(statusword | 0xFF00)  # the upper byte says nothing of it
