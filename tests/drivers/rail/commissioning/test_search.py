"""Homing: one controlword moves the cart, once, and none does after a halt."""

import itertools
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from softarm.drivers.rail.cia402 import DriveState, decode_state
from softarm.drivers.rail.commissioning.search import STILL_MAX_S, Search
from softarm.drivers.rail.enabling import ENABLE_MAX_S
from softarm.drivers.rail.feedback import Feedback

POLL_NS = 20_000_000
REMOTE, REACHED, ATTAINED, ERROR = 0x0200, 0x0400, 0x1000, 0x2000
ENABLE = (0x40, 0x21, 0x23)
RUN = 0x27
START, HALT, OFF = 0x001F, 0x010F, 0x0006


def seen(word: int, t_ns: int = 0, position_m: float = 0.0, velocity_m_s: float = 0.0, code: int = 0) -> Feedback:
    return Feedback(t_ns, decode_state(word), word, position_m, velocity_m_s, code)


class Played:
    """Search that receives feedback every 20 ms."""

    def __init__(self, method: int | None = 17) -> None:
        self.search = Search(0.05, 0.01, method, 0)
        self.t_ns, self.words = 0, []  # type: ignore[var-annotated]

    def show(self, word: int, position_m: float = 0.0, velocity_m_s: float = 0.0, stop: bool = False) -> int | None:
        self.t_ns += POLL_NS
        sent = self.search.next(seen(word | REMOTE, self.t_ns, position_m, velocity_m_s), stop)
        self.words += [] if sent is None else [sent]
        return sent

    def begin(self, bits: int = REACHED) -> None:
        for state in (*ENABLE, RUN):
            self.show(state | bits)
        assert self.words == [0x0006, 0x0007, 0x000F, START]

    @property
    def failure(self) -> str:
        return "; ".join(self.search.failure or ())


def test_a_successful_search_ends_disabled() -> None:
    played = Played()
    played.begin()
    for step in range(100):
        assert played.show(RUN, -0.001 * step, -0.05) is None
    assert played.show(RUN | ATTAINED, -0.1) is None
    played.show(RUN | ATTAINED | REACHED, 0.0)
    assert played.show(RUN | ATTAINED | REACHED) == OFF
    assert not played.search.over
    played.show(0x21)
    assert played.search.over
    assert played.search.failure is None
    assert played.words[4:] == [OFF]


def test_bits_of_the_search_before_are_ignored() -> None:
    played = Played()
    played.begin(bits=REACHED | ATTAINED)
    for step in range(10):
        assert played.show(RUN | ATTAINED | REACHED, -0.001 * step, -0.05) is None
    played.show(RUN, -0.02)
    played.show(RUN | ATTAINED | REACHED, 0.0)
    assert played.search.failure is None
    assert played.show(RUN | ATTAINED | REACHED) == OFF


def test_a_method_without_motion_may_never_clear_its_bit() -> None:
    played = Played(method=37)
    played.begin(bits=REACHED | ATTAINED)
    while not played.search.over:
        played.show(RUN | ATTAINED | REACHED if OFF not in played.words[3:] else 0x21)
    assert played.search.failure is None


@pytest.mark.parametrize(
    ("show", "says"),
    [
        (lambda p: p.show(0x08), "the drive reports unknown error"),
        (lambda p: p.show(0x0F), "the drive reports"),
        (lambda p: p.show(0x2704 & ~REMOTE), "invalid boot state"),
        (lambda p: p.search.next(seen(RUN, p.t_ns), False), "DI7"),
        (lambda p: p.show(RUN, stop=True), "a person interrupted it"),
        (lambda p: p.show(0x07), "fell back to 'quick stop active'"),
        (lambda p: p.show(0x40), "fell back to 'switch-on disabled'"),
        (lambda p: [p.show(RUN | ERROR) for _ in range(20)], "homing failed (bit 13"),
        (lambda p: [p.show(RUN, -0.01 * n, -0.5) for n in range(5)], "0.05 m/s were requested"),
        (lambda p: [p.show(RUN, 0.003 * n) for n in range(2000)], "the axis counted 1.3"),
        (lambda p: [p.show(RUN) for _ in range(round(STILL_MAX_S / 0.02) + 2)], "has not moved for 3 s"),
        (lambda p: [p.show(RUN, 0.001 * (n // 70 % 2)) for n in range(4000)], "takes too long"),
    ],
)
def test_a_failure_brakes_disables_and_is_reported(show: Any, says: str) -> None:
    played = Played()
    played.begin()
    before = len(played.words)
    show(played)
    assert says in played.failure
    for _ in range(200):
        played.show(0x40 if OFF in played.words[before:] else RUN)
    assert played.search.over
    assert set(played.words[before:]) <= {HALT, OFF}


def test_a_drive_that_cannot_be_enabled_ends_the_search() -> None:
    played = Played()
    for _ in range(round(ENABLE_MAX_S / 0.02) + 3):
        played.show(0x40)
    assert played.words == [0x0006]
    assert "stays in 'switch-on disabled'" in played.failure
    assert played.search.over


def test_a_drive_enabled_by_another_master_is_not_started() -> None:
    played = Played()
    assert played.show(RUN) == HALT
    assert "another master has enabled the drive" in played.failure


def test_a_drive_that_cannot_be_disabled_is_reported() -> None:
    played = Played()
    played.begin()
    played.show(RUN, stop=True)
    for _ in range(300):
        played.show(RUN)
    assert played.words[4:] == [HALT, OFF]
    assert "press the hardware e-stop" in played.failure


words = st.sampled_from([*ENABLE, RUN, RUN, RUN, 0x07, 0x0F, 0x08, 0x2704]).flatmap(
    lambda state: st.sampled_from([0, REMOTE, REMOTE, REMOTE | REACHED | ATTAINED, REMOTE | ERROR]).map(
        lambda bits: state | bits
    )
)
looks = st.tuples(words, st.floats(-0.4, 0.4), st.floats(-1, 1), st.booleans(), st.integers(1, 40))


@given(st.lists(looks, max_size=80), st.integers(0, 4))
def test_for_any_feedback_one_controlword_moves_and_none_after_a_failure(shown: list[Any], steps: int) -> None:
    played = Played()
    for state in (*ENABLE, RUN)[:steps]:
        played.show(state)
    for word, position_m, velocity_m_s, stop, polls in shown:
        for _ in range(polls):
            failed = played.search.failure is not None
            played.t_ns += POLL_NS
            look = seen(word, played.t_ns, position_m, velocity_m_s)
            sent = played.search.next(look, stop and polls % 7 == 0)
            if sent is None:
                continue
            played.words.append(sent)
            in_operation = look.state is DriveState.OPERATION_ENABLED
            assert not in_operation or sent & 0x0F == 0x0F or sent == OFF
            if failed or played.search.failure is not None:
                assert sent in (HALT, OFF)
                assert sent != HALT or in_operation
            if sent == START:
                assert in_operation
                assert played.words[-2] == 0x000F
    assert played.words.count(START) <= 1
    after = list(itertools.dropwhile(lambda word: word not in (HALT, START), played.words))
    assert set(after[1:]) <= {HALT, OFF}
    assert after.count(HALT) <= 1
    assert after.count(OFF) <= 1
