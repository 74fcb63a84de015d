"""Safety filter: every sent command keeps cart and muscle within their limits."""

import math
from collections import deque
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from softarm.common.braking import CREEP_MAX_M_S
from softarm.daemon.control.safety import SafetyFilter
from softarm.daemon.runtime.offline import Lockstep
from softarm.schemas.config import Config, DryveRail, Limits, PressureLimits, RailLimits
from softarm.schemas.goals import Goal
from softarm.schemas.messages import SAFE, Command, RailReading
from softarm.schemas.policy import Observation
from tests.daemon.rig import BangBang

PERIOD = 1 / 30
RAIL, PRESSURE = RailLimits(), PressureLimits()
HOLD_S = DryveRail().hold_s
SOON_NS = round(PERIOD * 1e9)


def make(**limits) -> SafetyFilter:
    return SafetyFilter(Limits(**limits), PERIOD, HOLD_S)


def read(position: float, velocity: float, t_ns: int = 0) -> RailReading:
    return RailReading(t_ns, position, velocity, True)


MIDDLE = read(0.0, 0.0)
any_number = st.floats(allow_nan=True, allow_infinity=True)
readings = st.none() | st.builds(read, any_number, any_number, st.integers(-(10**9), 10**9))


@given(st.lists(st.tuples(any_number, any_number, readings), min_size=1, max_size=20))
def test_every_sent_command_is_within_every_limit(steps):
    safety = make()
    pressure = 0.0
    for tick, (velocity, kpa, rail) in enumerate(steps):
        sent, clamps = safety.apply(Command(True, velocity, kpa), rail, tick * SOON_NS)
        assert abs(sent.cart_velocity_m_s) <= RAIL.velocity_max_m_s
        assert PRESSURE.min_kpa <= sent.pressure_kpa <= PRESSURE.max_kpa
        nothing_known = "non_finite" in clamps
        assert nothing_known or abs(sent.pressure_kpa - pressure) <= PRESSURE.slew_max_kpa_s * PERIOD + 1e-9
        pressure = sent.pressure_kpa


@given(st.floats(-1, 1), st.floats(PRESSURE.min_kpa, PRESSURE.max_kpa))
@example(0.0, PRESSURE.min_kpa)
@example(0.0, PRESSURE.max_kpa)
def test_an_action_within_the_limits_passes_untouched_in_the_middle_of_the_rail(velocity, kpa):
    wanted = Command(True, velocity, kpa)
    assert make().apply(wanted, MIDDLE, 0) == (wanted, ())


class RampingCart:
    """Drive in velocity mode at 1 kHz with latency and a disturbing arm."""

    def __init__(self, position: float, pulls) -> None:
        self.position, self.velocity = position, 0.0
        self._pulls = pulls
        self._queue = deque([0.0] * round(RAIL.latency_s * 1000))
        self.track: list[tuple[float, float]] = []  # position and velocity of every millisecond

    def advance(self, set_point: float, tick: int, steps: int) -> None:
        pull = self._pulls[tick % len(self._pulls)]
        for step in range(steps):
            self.track.append((self.position, self.velocity))
            self._queue.append(set_point if step < HOLD_S * 1000 else 0.0)
            gap = self._queue.popleft() - self.velocity
            ramp = 6.0 + pull * math.copysign(1.0, gap)  # the arm pulls towards +y
            self.velocity += math.copysign(min(abs(gap), ramp / 1000), gap)
            self.position += self.velocity / 1000


@given(
    st.lists(st.floats(-3, 3), min_size=5, max_size=60),
    st.floats(-0.2, 0.2),
    st.lists(st.floats(-2, 2), min_size=1, max_size=10),
    st.lists(st.integers(0, 150), min_size=1, max_size=5) | st.just([0]),
    st.lists(st.sampled_from([33, 33, 34, 67, 133]), min_size=1, max_size=5),
)
def test_no_sequence_of_actions_drives_the_cart_past_its_limits(velocities, start, pulls, ages, pauses):
    """The limits hold for readings of any age and any skipped ticks."""
    safety = make()
    cart = RampingCart(start, pulls)
    cart.advance(0.0, 0, 1)
    for tick, velocity in enumerate([*velocities, 1.0, 1.0, 1.0, 1.0, 1.0]):
        now = len(cart.track) - 1
        then = max(0, now - ages[tick % len(ages)])
        seen = read(*cart.track[then], then * 1_000_000)
        sent, _ = safety.apply(Command(True, velocity, 0.0), seen, now * 1_000_000)
        cart.advance(sent.cart_velocity_m_s, tick, pauses[tick % len(pauses)])
    assert all(RAIL.position_min_m <= position <= RAIL.position_max_m for position, _ in cart.track)


def under_way(velocity: float) -> SafetyFilter:
    """Return a filter that sent one velocity for ten ticks ending at t = -1."""
    safety = make()
    for tick in range(-10, 0):
        safety.apply(Command(True, velocity, 0.0), read(-0.2, velocity, tick * SOON_NS), tick * SOON_NS)
    return safety


@pytest.mark.parametrize("age_s", [0.0, 0.03, 0.15])
def test_braking_begins_at_the_braking_distance(age_s):
    """At 0.9 m/s: age of the reading, latency and hold time of the link, then v^2 / 2a.

    And what an arm may have dragged the cart along since the reading.
    """
    distance = 0.9 * (age_s + RAIL.latency_s + HOLD_S) + 0.9**2 / (2 * RAIL.braking_m_s2) + RAIL.margin_m
    distance += CREEP_MAX_M_S * age_s
    for offset, passes in ((-0.002, True), (0.002, False)):
        seen = read(RAIL.position_max_m - distance + offset, 0.9, -round(age_s * 1e9))
        sent, clamps = under_way(0.9).apply(Command(True, 0.9, 0.0), seen, 0)
        assert (sent.cart_velocity_m_s == 0.9) is passes
        assert ("rail_position_max" in clamps) is not passes


def test_braking_by_the_link_after_a_pause_is_assumed():
    """A cart at 0.5 m/s may have stopped or still roll: the filter assumes that it rolls."""
    seen = read(0.13, 0.5, -SOON_NS)
    fresh, _ = under_way(0.5).apply(Command(True, 0.5, 0.0), seen, 0)
    later, _ = under_way(0.5).apply(Command(True, 0.5, 0.0), seen, 4 * SOON_NS)
    never, _ = under_way(0.5).apply(Command(True, 0.5, 0.0), replace(seen, position_m=-0.2), 4 * SOON_NS)
    assert fresh.cart_velocity_m_s < 0.5
    assert later.cart_velocity_m_s < 0.5
    assert never.cart_velocity_m_s == 0.5


def test_a_reading_that_is_too_old_is_ignored():
    old_ns = 500_000_000
    for age_ns, unknown in ((old_ns, False), (old_ns + 1000, True)):
        sent, clamps = make().apply(Command(True, -0.1, 3.0), MIDDLE, age_ns)
        assert ("rail_unknown" in clamps) is unknown
        assert sent.pressure_kpa == 3.0
        assert not unknown or sent.cart_velocity_m_s == 0.0


def test_a_stamp_ahead_of_the_clock_is_a_reading_of_now():
    wanted = Command(True, 0.8, 0.0)
    ahead, now = (make().apply(wanted, read(0.1, 0.5, t_ns), 0) for t_ns in (10_000_000, 0))
    assert ahead == now


@pytest.mark.parametrize("seed", range(10))
def test_forgotten_commands_can_no_longer_act(seed):
    """With the oldest usable reading and skipped ticks, the law gives the same as with all sent commands."""
    draw = np.random.default_rng(seed)
    safety, sent, now_ns = make(), [], 0
    for _ in range(40):
        now_ns += int(draw.choice([33, 33, 67, 100])) * 1_000_000
        wanted = float(draw.choice([-1.0, 1.0]))
        age_ns = int(draw.choice([0, 250, 450, 499, 500])) * 1_000_000
        seen = read(float(draw.uniform(-0.1, 0.1)), float(draw.uniform(-0.3, 0.3)), now_ns - age_ns)
        set_points = [((now_ns - at_ns) * 1e-9, each) for at_ns, each in sent]
        law = RAIL.braking_law(HOLD_S).bound(wanted, seen.position_m, seen.velocity_m_s, age_ns * 1e-9, set_points)
        passed, _ = safety.apply(Command(True, wanted, 0.0), seen, now_ns)
        assert passed.cart_velocity_m_s == law.velocity_m_s
        sent.append((now_ns, passed.cart_velocity_m_s))


def test_resume_replaces_the_last_command():
    """A replay continues from the recorded command of axis and muscle."""
    safety = make(pressure=PressureLimits(slew_max_kpa_s=60.0))
    safety.apply(Command(True, -1.0, 0.0), MIDDLE, 0)
    safety.resume(Command(True, 0.4, 10.0))
    assert list(safety.sent) == [(0, 0.4)]
    sent, _ = safety.apply(Command(True, 1.0, 20.0), replace(MIDDLE, t_receive_ns=SOON_NS), SOON_NS)
    assert sent.pressure_kpa == pytest.approx(12.0)


def test_the_memory_of_commands_is_bounded():
    safety = make()
    for tick in range(2000):
        safety.apply(Command(True, 0.1, 0.0), None if tick < 1000 else MIDDLE, tick * SOON_NS)
    assert len(safety.sent) < 30


AT_MAX, AT_MIN = read(RAIL.position_max_m, 0.0), read(RAIL.position_min_m, 0.0)


@pytest.mark.parametrize(
    ("wanted", "seen", "sent", "clamps"),
    [
        ((1.5, 0.0), MIDDLE, (1.0, 0.0), ("rail_velocity",)),
        ((0.0, 21.0), MIDDLE, (0.0, 20.0), ("pressure_max",)),
        ((0.0, -1.0), MIDDLE, (0.0, PRESSURE.min_kpa), ("pressure_min",)),
        # At the end of the rail only motion inwards is allowed.
        ((1.0, 0.0), AT_MAX, (-0.1, 0.0), ("rail_position_max",)),
        ((-1.0, 0.0), AT_MAX, (-1.0, 0.0), ()),
        ((-1.0, 0.0), AT_MIN, (0.1, 0.0), ("rail_position_min",)),
        # Without a known position the cart brakes; with NaN or infinity the muscle vents as well.
        ((0.5, 3.0), None, (0.0, 3.0), ("rail_unknown",)),
        ((0.0, 3.0), None, (0.0, 3.0), ()),
        ((math.nan, 10.0), MIDDLE, (0.0, 0.0), ("non_finite",)),
        ((0.1, math.inf), MIDDLE, (0.0, 0.0), ("non_finite",)),
        ((1.0, 10.0), read(math.nan, 0.0), (0.0, 0.0), ("non_finite",)),
    ],
)
def test_every_clamp_has_its_command_and_name(wanted, seen, sent, clamps):
    assert make().apply(Command(True, *wanted), seen, 0) == (Command(True, *sent), clamps)


def test_a_disabled_command_stays_disabled():
    assert make().apply(Command(False, 1.0, 9.0), read(0.28, 0.5), 0) == (SAFE, ())


def test_the_pressure_slew_is_kept():
    safety = make(pressure=PressureLimits(slew_max_kpa_s=60.0))
    first, clamps = safety.apply(Command(True, 0.0, 20.0), MIDDLE, 0)
    assert first.pressure_kpa == pytest.approx(2.0)
    assert clamps == ("pressure_slew",)
    second, _ = safety.apply(Command(True, 0.0, 20.0), MIDDLE, SOON_NS)
    assert second.pressure_kpa == pytest.approx(4.0)


class Swinging(BangBang):
    """Policy that pushes the cart with the arm's swing, or against it."""

    def __init__(self, sense: float) -> None:
        super().__init__(0)
        self._sense = sense

    def step(self, observation, goal):
        swing = float(np.sign(Observation(*observation).tip_vy_m_s))
        return np.array([self._sense * swing, 20.0 * (swing < 0)], dtype=np.float32)


@pytest.mark.parametrize("policy", [BangBang(0), Swinging(1.0), Swinging(-1.0)], ids=["random", "with", "against"])
def test_on_the_simulated_robot_no_policy_passes_the_limits(policy):
    """The limits hold with the arm's pull, which the filter does not model."""
    flights = Lockstep(Config(), policy)
    for start in (-0.2, 0.0, 0.2):
        flight = flights.fly(Goal("reach", 0.59, 0.51), start)
        assert flight.status.state == "failed"  # out of time, not stopped by the failsafe
        assert 0.1 < flight.max_cart_m <= 0.25
