"""Conversion of the server's clock: drift, one-sided delays, a clock that is set, an impossible echo."""

import math
import random
import statistics

import pytest

from softarm.drivers.bridge.clock import ECHOES_MIN, EchoClock

# Clock rate of a recorded server.
HZ = 3_312_787
START = 5_000_000_000_000
WAY_NS = 120_000


class Servers:
    """Clock with an offset that runs `ppm` faster; echoes have delays."""

    def __init__(self, ppm: float, seed: int = 1) -> None:
        self.rate, self.random, self.ahead_ns = 1 + ppm * 1e-6, random.Random(seed), 77_000_000_000_000

    def ticks(self, now_ns: int) -> int:
        return int(((now_ns - START) * self.rate + self.ahead_ns) * HZ / 1e9)

    def echo(self, clock: EchoClock, now_ns: int, out_ns: float = 0, back_ns: float = 0) -> None:
        there = now_ns + WAY_NS + round(out_ns)
        clock.add(now_ns, there + WAY_NS + round(back_ns), self.ticks(there))


def play(
    clock: EchoClock, server: Servers, seconds: float, begin_s: float = 0.0, out: float = 0, back: float = 0
) -> list[float]:
    """Send two echoes a second with random delays, and return the errors of stamps after ten seconds."""
    errors = []
    for step in range(round(seconds * 2)):
        now = START + round((begin_s + step / 2) * 1e9)
        queue = server.random.expovariate
        server.echo(clock, now, queue(1) * out, queue(1) * back)
        if clock.is_ready and step > 20:
            then = now - 8_000_000
            error = abs(clock.here_ns(server.ticks(then)) - then)
            assert error <= 1e9 * clock.uncertainty_s + 1, step
            errors.append(error)
    return errors


@pytest.mark.parametrize("ppm", [-50.0, 0.0, 50.0])
@pytest.mark.parametrize(("out_us", "back_us"), [(0, 0), (400, 400), (2000, 0), (0, 2000)])
def test_stamps_are_right_despite_drift_and_delays(ppm, out_us, back_us):
    clock, server = EchoClock(HZ), Servers(ppm)
    errors = play(clock, server, 120, out=1e3 * out_us, back=1e3 * back_us)
    queue_ns = 1e3 * max(out_us, back_us)
    assert max(errors) < 1_000 + 1.5 * queue_ns
    assert statistics.median(errors) < 1_000 + 0.25 * queue_ns
    assert clock.drift_ppm == pytest.approx(-ppm, abs=0.01 if queue_ns == 0 else 2.0)
    assert clock.restarts == 0


def test_frames_are_stamped_after_a_few_echoes():
    clock, server = EchoClock(HZ), Servers(50.0)
    assert clock.uncertainty_s == math.inf
    for step in range(ECHOES_MIN):
        assert not clock.is_ready
        server.echo(clock, START + step * 20_000_000)
    assert clock.is_ready
    then = START + 100_000_000
    assert abs(clock.here_ns(server.ticks(then)) - then) < 10_000


def test_a_clock_that_was_set_is_followed_at_the_second_echo():
    clock, server = EchoClock(HZ), Servers(20.0)
    play(clock, server, 60)
    server.ahead_ns -= 3_600_000_000_000
    server.echo(clock, START + 60_000_000_000)
    assert clock.restarts == 0
    for step in range(1, ECHOES_MIN + 1):
        server.echo(clock, START + 60_000_000_000 + step * 500_000_000)
    assert clock.restarts == 1
    then = START + 64_000_000_000
    assert clock.is_ready
    assert abs(clock.here_ns(server.ticks(then)) - then) < 200_000


def test_one_impossible_echo_is_ignored():
    clock, server = EchoClock(HZ), Servers(0.0)
    play(clock, server, 20)
    before = clock.here_ns(server.ticks(START))
    clock.add(START + 20_500_000_000, START + 20_400_000_000, server.ticks(START))
    clock.add(START + 20_500_000_000, START + 20_501_000_000, server.ticks(START))
    server.echo(clock, START + 21_000_000_000)
    assert clock.restarts == 0
    assert clock.here_ns(server.ticks(START)) == pytest.approx(before, abs=2000)


def test_a_minute_of_slow_echoes_is_accepted_in_the_end():
    clock, server = EchoClock(HZ), Servers(30.0)
    play(clock, server, 60)
    play(clock, server, 240, begin_s=60, out=3e6, back=3e6)
    then = START + 299_000_000_000
    assert abs(clock.here_ns(server.ticks(then)) - then) < 1e9 * clock.uncertainty_s < 3e6
