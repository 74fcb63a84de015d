"""Measured limits of a cart with known limits: safe and not much wider."""

from dataclasses import replace

import numpy as np
import pytest

from softarm.daemon.limits.measured import COUNT_MIN, measure, tolerance_bound
from softarm.schemas.config import Config
from softarm.schemas.robot import RAIL_TRAVEL_M

CARTS = (
    {},
    {"pull_m_s2": 2.0},
    {"ramp_m_s2": 2.0, "latency_s": 0.05, "pull_m_s2": 0.8},
    {"ramp_m_s2": 8.0, "latency_s": 0.1, "pull_m_s2": 3.0, "seconds": 90.0},
    {"ramp_m_s2": 3.0, "latency_s": 0.09, "pull_m_s2": 1.5},
    {"latency_s": 0.01, "pull_m_s2": 2.0, "age_s": 0.03},
    {"pull_m_s2": 2.0, "quantum_m_s": 0.01},
    {"pull_m_s2": 2.0, "jitter_s": 0.003},
)


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind", [*CARTS[:1], *(pytest.param(c, marks=pytest.mark.prove) for c in CARTS[1:4]), *CARTS[4:]], ids=str
)
def test_the_limits_of_a_known_cart_are_found_on_the_safe_side(cart, kind):
    ramp, pull = kind.get("ramp_m_s2", 6.0), kind.get("pull_m_s2", 0.0)
    late_s = kind.get("latency_s", 1 / 30) + kind.get("age_s", 0.0)  # a reading's hidden age is latency to who reads it
    found = measure([cart(**kind)], 6.0)
    assert late_s - 0.002 <= found.latency.value <= late_s + 0.012
    assert found.surely.value <= late_s + 0.007
    # Over a whole stretch the arm hardly ever pulls its hardest: 0.6 to 1 of it is what the worst of many show.
    assert ramp - 1.1 * pull - 0.1 <= found.braking.value <= ramp - 0.6 * pull + 0.1
    assert ramp + 0.9 * pull - 0.1 <= found.surge.value <= 1.15 * (ramp + pull)
    assert found.ramp_m_s2 == pytest.approx(ramp, rel=0.1)


def test_only_an_arm_that_pulls_harder_than_the_drive_drags_the_cart(cart):
    """A pull p against a ramp r in a sine of 1.3 Hz gains p - r at most, for one latency."""
    for pull, least, most in ((2.0, 0.0, 0.05), (4.0, 0.05, 0.25)):
        found = measure([cart(ramp_m_s2=2.0, latency_s=0.1, pull_m_s2=pull, seconds=65.0)], 6.0)
        assert least <= found.drag.value <= most


def test_a_velocity_that_is_read_back_late_belongs_to_the_latency(cart):
    fresh, filtered = (measure([cart(pull_m_s2=2.0, filter_s=s)], 6.0).latency for s in (0.0, 0.02))
    assert 0.008 < filtered.median - fresh.median < 0.025


def test_set_points_that_act_late_now_and_then_count(cart):
    found = measure([cart(pull_m_s2=1.0, late=(0.08, 1 / 30))], 6.0)
    assert found.latency.median < 0.04
    assert 0.055 < found.surely.value <= found.latency.value < 0.08


def test_too_little_data_gives_no_measurement(cart):
    found = measure([cart(seconds=10.0)], 6.0)
    assert (found.latency, found.braking, found.surge, found.drag) == (None,) * 4
    assert 0 < found.steps < COUNT_MIN
    assert measure([], 6.0).recordings == 0


def test_a_recording_of_another_ramp_or_of_another_scale_is_left_out_with_the_reason(cart):
    motion = cart(seconds=10.0)
    slow = Config.model_validate({"drivers": {"rail": {"acceleration_m_s2": 4.0}}})
    wrong = replace(motion, velocity_m_s=2.0 * motion.velocity_m_s)
    still = replace(motion, velocity_m_s=0.0 * motion.velocity_m_s)
    away = replace(motion, position_m=motion.position_m + 1.0)
    found = measure([motion, replace(motion, config=slow), wrong, still, away], 6.0)
    assert found.recordings == 1
    assert found.left_out == (
        "cart: was recorded with drivers.rail.acceleration_m_s2 4, not 6",
        "cart: the axis's velocity is 2 times the slope of its position: check drivers.rail first",
        "cart: the cart did not move",
        f"cart: the cart was never within {RAIL_TRAVEL_M - 0.01:g} m of the centre: home the axis, check centre_m",
    )


def test_mechanical_stops_and_a_disabled_drive_do_not_count(cart):
    motion = cart()
    hit = np.abs(motion.position_m) > 0.1  # as if a stop stood there and threw the cart back
    thrown = replace(
        motion,
        position_m=np.where(hit, 3 * motion.position_m, motion.position_m),
        velocity_m_s=np.where(hit, -2 * motion.velocity_m_s, motion.velocity_m_s),
    )
    off = replace(motion, obeyed=np.zeros(len(motion.sent_s), dtype=bool))
    assert measure([thrown], 6.0).brakings < measure([motion], 6.0).brakings
    free = measure([motion, thrown], 6.0)
    assert free.surge is None or free.surge.value < 7.0
    assert measure([off], 6.0).steps == 0


@pytest.mark.parametrize("count", [59, 100, 299, 1000])
def test_the_bound_holds_in_95_of_100_samples(count):
    """Order statistics: from 299 values 99 % are bounded, from fewer a smaller share, which is reported."""
    rng = np.random.default_rng(3)
    bounds = [tolerance_bound(rng.exponential(size=count), 1.0) for _ in range(1000)]
    share = bounds[0].share
    assert share == pytest.approx(0.99 if count >= 299 else 0.05 ** (1 / count))
    true = -np.log(1 - share)  # of the exponential distribution
    assert np.mean([bound.value >= true for bound in bounds]) > 0.93


def test_the_minimum_is_bounded_from_below():
    values = np.arange(1000.0)
    assert tolerance_bound(values, 1.0, least=True).value == 999.0 - tolerance_bound(values, 1.0).value
    assert tolerance_bound(values[:58], 1.0) is None
