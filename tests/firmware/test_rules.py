"""Promises of the firmware in addition to the page's rules: relay, sensor, clock and tokens."""

import itertools
import math
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from softarm.drivers.regulator.cobs import Deframer, frame
from softarm.drivers.regulator.teensy import Fault, Hello, RegulatorCommand, RegulatorState, Welcome, decode, encode

MS = 1_000_000
# Shortest time of an open relay.
OPEN_MS = 1000
WRAP_MS = 2**32 / 1000


class Host:
    """Host's end of the board's line, with a manual clock."""

    def __init__(self, board: Any, now_ms: float = 0.0) -> None:
        self.board, self.now_ns = board, round(now_ms * MS)
        self.token, self.sequence = 0, 0
        self.sensor: tuple[float, bool] = (1.0, True)
        self.accepted_ns: float = -math.inf
        self.live_ns = 0
        self._deframer = Deframer()
        board.watch(self.now_ns)

    def say(self, message: Any) -> Any:
        self.sequence += 1
        said = frame(encode(message, self.sequence, 0))
        [body] = self._deframer.feed(self.board.receive(said, self.now_ns, *self.sensor))
        return decode(body)[0]

    def greet(self) -> "Host":
        answer = self.say(Hello())
        assert isinstance(answer, Welcome)
        self.token = answer.token
        self.board.watch(self.now_ns)
        return self

    def command(self, armed: bool, kpa: float = 5.0, live_ms: int = 100, wrong: int = 0) -> RegulatorState:
        answer: RegulatorState = self.say(RegulatorCommand(self.token ^ wrong, live_ms / 1000, armed, kpa))
        if answer.accepted_sequence == self.sequence:
            self.accepted_ns, self.live_ns = self.now_ns, live_ms * MS
        self.board.watch(self.now_ns)
        return answer

    def wait(self, milliseconds: float) -> None:
        self.now_ns += round(milliseconds * MS)
        self.board.watch(self.now_ns)

    def talk(self, milliseconds: float, armed: bool = False) -> "Host":
        """Send a command every 33 ms, the first at once."""
        for _ in range(math.ceil(milliseconds / 33)):
            self.command(armed)
            self.wait(33)
        return self

    def armed(self) -> "Host":
        """Send disarmed commands until the relay closes, then armed ones."""
        self.greet().talk(OPEN_MS + 100).talk(33, armed=True)
        assert (self.board.armed, self.board.relay_closed) == (True, True)
        return self


@pytest.fixture
def host(make_board: Any) -> Host:
    return Host(make_board(itertools.count(7).__next__))


# The relay


def test_the_relay_closes_for_disarmed_commands(host: Host) -> None:
    assert not host.board.relay_closed
    host.greet()
    assert not host.board.relay_closed
    host.talk(OPEN_MS - 33)
    host.command(False)
    host.now_ns = OPEN_MS * MS - 1000
    host.board.watch(host.now_ns)
    assert not host.board.relay_closed
    host.wait(0.001)
    assert host.board.relay_closed
    assert not host.board.armed


def test_a_latched_fault_keeps_the_relay_open_until_a_disarmed_command(host: Host) -> None:
    host.armed().wait(101)
    host.talk(3 * OPEN_MS, armed=True)
    assert not host.board.relay_closed
    host.talk(33)
    assert host.board.relay_closed


@pytest.mark.parametrize("how", ["disarmed", "hello", "silence"])
def test_every_disarming_opens_the_relay_for_a_second(host: Host, how: str) -> None:
    host.armed()
    if how == "disarmed":
        host.command(False)
    elif how == "hello":
        host.greet()
    else:
        host.wait(200)
    assert (host.board.armed, host.board.relay_closed) == (False, False)
    host.talk(OPEN_MS - 33)
    assert not host.board.relay_closed
    host.talk(66)
    assert host.board.relay_closed


def test_a_hello_opens_the_relay_at_once_even_when_disarmed(host: Host) -> None:
    host.greet().talk(OPEN_MS + 100)
    host.command(False)
    assert host.board.relay_closed
    host.board.receive(frame(encode(Hello(), 9999, 0)), host.now_ns, 1.0)
    assert not host.board.relay_closed


@pytest.mark.parametrize("bad", [{"wrong": 1}, {"kpa": 20.5}, {"kpa": math.nan}, {"live_ms": 251}])
def test_rejected_commands_do_not_keep_the_relay_closed(host: Host, bad: dict[str, Any]) -> None:
    host.armed()
    for _ in range(6):
        host.command(False, **bad)
        host.wait(33)
    assert not host.board.relay_closed


SPOKEN = st.one_of(
    st.tuples(st.just("wait"), st.sampled_from([1, 33, 99, 100, 101, 250, 999, 1000, 1500])),
    st.tuples(st.just("talk"), st.integers(33, 1500), st.booleans()),
    st.tuples(st.just("command"), st.booleans(), st.sampled_from([1, 100, 250]), st.integers(0, 1)),
    st.just(("greet",)),
)


@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(SPOKEN, max_size=25), st.sampled_from([0.0, WRAP_MS - 700, 3 * WRAP_MS - 2000]))
def test_the_relay_is_closed_only_when_allowed(make_board: Any, script: list[Any], start_ms: float) -> None:
    host = Host(make_board(itertools.count(7).__next__), start_ms)
    was_closed = was_armed = False
    opened_ns = host.now_ns
    watch = host.board.watch

    def look(now_ns: int) -> None:
        nonlocal was_closed, was_armed, opened_ns
        watch(now_ns)
        closed, armed = host.board.relay_closed, host.board.armed
        if closed:
            assert now_ns - host.accepted_ns < host.live_ns
            assert Fault.TIME_TO_LIVE not in host.board.faults
            assert was_closed or now_ns - opened_ns >= OPEN_MS * MS
            assert armed or not was_armed or not was_closed
        elif was_closed:
            opened_ns = now_ns
        was_closed, was_armed = closed, armed

    host.board.watch = look
    host.greet()
    for kind, *rest in script:
        if kind == "command":
            armed, live_ms, wrong = rest
            host.command(armed, live_ms=live_ms, wrong=wrong)
        else:
            getattr(host, kind)(*rest)


# The clock


@pytest.mark.parametrize("left_ms", [0.001, 50.0, 99.999, 100.0])
def test_the_time_to_live_expires_across_the_wrap_of_the_clock(make_board: Any, left_ms: float) -> None:
    host = Host(make_board(), WRAP_MS - 2 * OPEN_MS)
    host.armed()
    last_ns = round((WRAP_MS - left_ms) * MS)
    while host.now_ns < last_ns:
        host.now_ns = min(host.now_ns + 33 * MS, last_ns)
        assert host.command(True).armed
    host.wait(99.999)
    assert host.board.armed
    host.wait(0.001)
    assert not host.board.armed


def test_after_an_hour_of_silence_the_board_is_still_disarmed(host: Host) -> None:
    host.armed()
    for _ in range(2 * 72):  # over the wrap: 72 minutes, half a minute at a time
        host.wait(30_000)
        assert (host.board.armed, host.board.relay_closed, host.board.set_point_kpa) == (False, False, 0.0)
    assert host.command(True).faults == Fault.TIME_TO_LIVE


def test_a_clock_that_goes_backwards_vents(host: Host) -> None:
    host.armed().wait(-1)
    assert (host.board.armed, host.board.relay_closed) == (False, False)


# The sensor and the token


@pytest.mark.parametrize("kpa", [math.nan, math.inf, -math.inf])
def test_a_broken_sensor_gives_a_finite_number_and_a_fault(host: Host, kpa: float) -> None:
    host.armed().sensor = (kpa, True)
    assert host.command(True) == RegulatorState(host.sequence, True, Fault.SENSOR, 0.0)
    host.sensor = (-12.5, False)
    assert host.command(True) == RegulatorState(host.sequence, True, Fault.SENSOR, -12.5)
    host.sensor = (-12.5, True)
    assert host.command(True, kpa=25.0).faults == Fault.RANGE
    assert host.command(True) == RegulatorState(host.sequence, True, Fault(0), -12.5)


def test_each_of_several_hellos_has_a_token_and_the_last_is_valid(host: Host) -> None:
    hellos = b"".join(frame(encode(Hello(), sequence, 0)) for sequence in (1, 2, 3))
    answers = Deframer().feed(host.board.receive(hellos, host.now_ns, 0.0))
    tokens = [decode(body)[0].token for body in answers]
    assert len(set(tokens)) == 3
    host.sequence = 3
    for token, faults in zip(tokens, (Fault.TOKEN, Fault.TOKEN, Fault(0)), strict=True):
        host.token = token
        assert host.command(False).faults == faults
