"""Whatever a drive shows, one word moves it, once, and nothing does after a halt."""

import itertools
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from softarm.drivers.rail.cia402 import DriveState, decode_state
from softarm.drivers.rail.commissioning.search import STILL_MAX_S, WALK_MAX_S, Search
from softarm.drivers.rail.feedback import Feedback

POLL_NS = 20_000_000
REMOTE, REACHED, ATTAINED, ERROR = 0x0200, 0x0400, 0x1000, 0x2000
WALK = (0x40, 0x21, 0x23)
RUN = 0x27
START, HALT, OFF = 0x001F, 0x010F, 0x0006


def seen(word: int, t_ns: int = 0, position_m: float = 0.0, velocity_m_s: float = 0.0, code: int = 0) -> Feedback:
    return Feedback(t_ns, decode_state(word), word, position_m, velocity_m_s, code)


class Played:
    """A search that is shown one thing after another, 20 ms apart."""

    def __init__(self, method: int | None = 17) -> None:
        self.search = Search(0.05, 0.01, method, 0)
        self.t_ns, self.words = 0, []  # type: ignore[var-annotated]

    def show(self, word: int, position_m: float = 0.0, velocity_m_s: float = 0.0, stop: bool = False) -> int | None:
        self.t_ns += POLL_NS
        said = self.search.next(seen(word | REMOTE, self.t_ns, position_m, velocity_m_s), stop)
        self.words += [] if said is None else [said]
        return said

    def begin(self, bits: int = REACHED) -> None:
        for state in (*WALK, RUN):
            self.show(state | bits)
        assert self.words == [0x0006, 0x0007, 0x000F, START]

    @property
    def failure(self) -> str:
        return "; ".join(self.search.failure or ())


def test_a_search_that_goes_well_ends_switched_off() -> None:
    played = Played()
    played.begin()
    for step in range(100):
        assert played.show(RUN, -0.001 * step, -0.05) is None
    assert played.show(RUN | ATTAINED, -0.1) is None  # not at rest yet
    played.show(RUN | ATTAINED | REACHED, 0.0)
    assert played.show(RUN | ATTAINED | REACHED) == OFF
    assert not played.search.over
    played.show(0x21)
    assert played.search.over
    assert played.search.failure is None
    assert played.words[4:] == [OFF]


def test_bits_of_the_search_before_are_not_believed() -> None:
    played = Played()
    played.begin(bits=REACHED | ATTAINED)
    for step in range(10):
        assert played.show(RUN | ATTAINED | REACHED, -0.001 * step, -0.05) is None
    played.show(RUN, -0.02)
    played.show(RUN | ATTAINED | REACHED, 0.0)
    assert played.search.failure is None
    assert played.show(RUN | ATTAINED | REACHED) == OFF


def test_a_method_that_takes_where_it_stands_may_never_show_its_bit_low() -> None:
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
        (lambda p: p.show(RUN, stop=True), "broken off by a person"),
        (lambda p: p.show(0x07), "fell back to 'quick stop active'"),
        (lambda p: p.show(0x40), "fell back to 'switch-on disabled'"),
        (lambda p: [p.show(RUN | ERROR) for _ in range(20)], "homing failed (bit 13"),
        (lambda p: [p.show(RUN, -0.01 * n, -0.5) for n in range(5)], "0.05 m/s were asked for"),
        (lambda p: [p.show(RUN, 0.003 * n) for n in range(2000)], "has gone 1.3"),
        (lambda p: [p.show(RUN) for _ in range(round(STILL_MAX_S / 0.02) + 2)], "has not moved for 3 s"),
        (lambda p: [p.show(RUN, 0.001 * (n // 70 % 2)) for n in range(4000)], "takes too long"),
    ],
)
def test_what_goes_wrong_is_braked_switched_off_and_said(show: Any, says: str) -> None:
    played = Played()
    played.begin()
    before = len(played.words)
    show(played)
    assert says in played.failure
    for _ in range(200):
        played.show(0x40 if OFF in played.words[before:] else RUN)
    assert played.search.over
    assert set(played.words[before:]) <= {HALT, OFF}


def test_a_drive_that_stays_where_it_is_in_the_walk_is_given_up() -> None:
    played = Played()
    for _ in range(round(WALK_MAX_S / 0.02) + 3):
        played.show(0x40)
    assert played.words == [0x0006]
    assert "stays in 'switch-on disabled'" in played.failure
    assert played.search.over


def test_a_drive_that_somebody_else_has_put_into_operation_is_not_started() -> None:
    played = Played()
    assert played.show(RUN) == HALT
    assert "not by us" in played.failure


def test_a_drive_that_does_not_switch_off_is_told_as_such() -> None:
    played = Played()
    played.begin()
    played.show(RUN, stop=True)
    for _ in range(300):
        played.show(RUN)
    assert played.words[4:] == [HALT, OFF]
    assert "press the hardware e-stop" in played.failure


words = st.sampled_from([*WALK, RUN, RUN, RUN, 0x07, 0x0F, 0x08, 0x2704]).flatmap(
    lambda state: st.sampled_from([0, REMOTE, REMOTE, REMOTE | REACHED | ATTAINED, REMOTE | ERROR]).map(
        lambda bits: state | bits
    )
)
looks = st.tuples(words, st.floats(-0.4, 0.4), st.floats(-1, 1), st.booleans(), st.integers(1, 40))


@given(st.lists(looks, max_size=80), st.integers(0, 4))
def test_whatever_it_shows_one_word_moves_it_once_and_none_after_trouble(shown: list[Any], walked: int) -> None:
    played = Played()
    for state in (*WALK, RUN)[:walked]:
        played.show(state)
    for word, position_m, velocity_m_s, stop, polls in shown:
        for _ in range(polls):
            troubled = played.search.failure is not None
            played.t_ns += POLL_NS
            look = seen(word, played.t_ns, position_m, velocity_m_s)
            said = played.search.next(look, stop and polls % 7 == 0)
            if said is None:
                continue
            played.words.append(said)
            in_operation = look.state is DriveState.OPERATION_ENABLED
            assert not in_operation or said & 0x0F == 0x0F or said == OFF  # bits 0 to 3
            if troubled or played.search.failure is not None:
                assert said in (HALT, OFF)
                assert said != HALT or in_operation
            if said == START:
                assert in_operation
                assert played.words[-2] == 0x000F
    assert played.words.count(START) <= 1
    after = list(itertools.dropwhile(lambda word: word not in (HALT, START), played.words))
    assert set(after[1:]) <= {HALT, OFF}
    assert after.count(HALT) <= 1
    assert after.count(OFF) <= 1
