"""Dead reckoning of cart and tip during a dropout."""

import math

import pytest

from softarm.daemon.control.alignment import ReadingHistory
from softarm.daemon.control.dead_reckoning import DeadReckoning, Readings, Strength, TipModel, TrackedPose
from softarm.daemon.control.plausibility import REACH_MAX_M, REACH_MIN_M

MS = 1_000_000
HINGE_M = 0.965


def swing(lag_ns=0, cart_off_m=0.0, strength=1.0, angle=0.3):
    """Return a robot that follows the model, with poses every 8 ms and readings of axis and pressure."""
    model, axis, pressure = TipModel(), ReadingHistory(), ReadingHistory()
    rate, seen = -1.0, []
    for step in range(60):
        t_ns = round(step * 1e9 / 120)
        cart_m, cart_m_s, cart_m_s2 = (
            0.1 * math.sin(0.04 * step),
            0.1 * 0.04 * 120 * math.cos(0.04 * step),
            -0.1 * (0.04 * 120) ** 2 * math.sin(0.04 * step),
        )
        kpa = 2.0 + 0.1 * step
        axis.add(t_ns, cart_m, cart_m_s)
        pressure.add(t_ns, kpa)
        length = 0.44 + model.bent_m(angle, kpa)
        cart_y_m = cart_m + cart_off_m
        tip = (cart_y_m + length * math.sin(angle), HINGE_M - length * math.cos(angle))
        seen.append(TrackedPose(t_ns + lag_ns, cart_y_m, *tip))
        rate += (strength * model.own_rad_s2(angle, rate, kpa) + model.pulled_rad_s2(angle, cart_m_s2)) / 120
        angle += rate / 120
    return seen, Readings(axis, pressure, lag_ns)


@pytest.mark.parametrize("lag_ms", [0, 46])
@pytest.mark.parametrize("cart_off_m", [0.0, 0.02])
def test_a_robot_like_the_model_is_extrapolated_to_a_millimetre(lag_ms, cart_off_m):
    """Late cameras and a shifted frame do not matter: the cart continues from its tracked position."""
    seen, readings = swing(lag_ms * MS, cart_off_m)
    reckoning = DeadReckoning(seen[16], seen[20], readings)
    assert reckoning.at(seen[20].t_ns) == pytest.approx(seen[20])
    for then in (seen[24], seen[28], seen[32], seen[40]):
        assert reckoning.at(then.t_ns) == pytest.approx(then, abs=0.003)


@pytest.mark.parametrize("strength", [0.75, 1.0, 1.2])
def test_the_arms_strength_is_estimated_from_its_swing(strength):
    seen, readings = swing(strength=strength, angle=0.9)
    estimate = Strength()
    for pose in seen[::4]:
        estimate.update(pose, readings)
    assert estimate.value == pytest.approx(strength, abs=0.05)


def test_the_constants_are_the_fitted_ones():
    model = TipModel()
    assert model.own_rad_s2(0.0, 0.0, 0.0) == pytest.approx(-0.9854)  # by itself towards -y
    assert model.own_rad_s2(0.1, 0.0, 0.0) == pytest.approx(-0.9854 - 5.333)  # and back, with a period of 0.86 s
    assert model.own_rad_s2(0.0, 1.0, 0.0) == pytest.approx(-0.9854 - 0.6769)
    assert model.own_rad_s2(0.0, 0.0, 10.0) == pytest.approx(-0.9854 - 5.02)
    assert model.pulled_rad_s2(0.0, 2.0) == pytest.approx(-5.046)  # left behind by the cart
    assert model.pulled_rad_s2(math.pi / 3, 2.0) == pytest.approx(-2.523)
    assert model.bent_m(0.5, 0.0) == pytest.approx(-0.0031725)
    assert model.bent_m(0.5, 10.0) == pytest.approx(-0.0031725 + 0.002494)
    assert model.deviation_m(0.0) == 0.0015  # the cameras' noise
    assert model.deviation_m(0.1) == pytest.approx(0.0075)


# One step of 25 ms after a tracked one: three samples of the fitted constants' data.

STEP_NS, DT_S = 25 * MS, 1 / 120
IDLE = TipModel(*[0.0] * 8)  # an arm that nothing turns and nothing bends


def at_angle(t_ns, angle, length_m=0.44, cart_y_m=0.0):
    return TrackedPose(t_ns, cart_y_m, cart_y_m + length_m * math.sin(angle), HINGE_M - length_m * math.cos(angle))


def reckoned(model, before, seen, axis_m_s2=0.0, kpa=(0.0, 0.0), step_ns=STEP_NS, strength=1.0):
    """Return the extrapolated angle and length of an arm tracked at two angles and two pressures in kPa."""
    axis, pressure = ReadingHistory(), ReadingHistory()
    for t_ns in (0, STEP_NS, STEP_NS + step_ns):
        axis.add(t_ns, 0.0, axis_m_s2 * t_ns * 1e-9)
        pressure.add(t_ns, kpa[t_ns > STEP_NS])
    readings = Readings(axis, pressure, 0)
    reckoning = DeadReckoning(at_angle(0, before), at_angle(STEP_NS, seen), readings, strength, model)
    found = reckoning.at(STEP_NS + step_ns)
    y_m, down_m = found.tip_y_m - found.cart_y_m, HINGE_M - found.tip_z_m
    return math.atan2(y_m, down_m), math.hypot(y_m, down_m)


@pytest.mark.parametrize(("steps", "turned"), [(1, 1), (2, 3), (3, 6)])
def test_torque_acts_from_the_middle_of_the_last_tracked_step(steps, turned):
    """The arm came to rest in the last tracked step under 30 and 10 rad/s^2 of torque and cart."""
    model = IDLE._replace(offset_rad_s2=30.0, cart_1_m=2.0)
    before = 0.5 * 40.0 * 0.025**2
    step_ns = round(steps * DT_S * 1e9)
    angle, _ = reckoned(model, before, 0.0, axis_m_s2=-5.0, step_ns=step_ns)
    assert angle == pytest.approx(turned * 40.0 * DT_S**2, abs=1e-5)


def test_the_pressure_of_each_steps_middle_acts():
    angle, _ = reckoned(IDLE._replace(muscle_rad_s2_kpa=1.0), 0.0, 0.0, kpa=(0.0, 6.0))
    assert angle == pytest.approx(-(1.0 + (1.0 + 3.0) + (1.0 + 3.0 + 5.0)) * DT_S**2)


@pytest.mark.parametrize(("bend_m", "length_m"), [(10.0, REACH_MIN_M), (-10.0, REACH_MAX_M)])
def test_the_length_stays_within_the_arms_range(bend_m, length_m):
    assert reckoned(IDLE._replace(bend_m=bend_m), 0.4, 0.5)[1] == pytest.approx(length_m)


def read(*t_ms, value=0.0):
    past = ReadingHistory()
    for each in t_ms:
        past.add(each * MS, value * each)
    return past


def test_axis_and_pressure_are_read_where_the_frame_shows_them():
    readings = Readings(read(0, 50, 100, value=1.0), read(0, 50, 100, value=2.0), lag_ns=40 * MS)
    assert readings.at(110 * MS) == pytest.approx((70.0, 0.0, 140.0))
    assert Readings(read(0, 100), read(0), 0).at(100 * MS) is None
    assert Readings(read(0), read(0, 100), 0).at(100 * MS) is None


def test_an_axis_silent_at_either_frame_prevents_extrapolation():
    first, second = at_angle(40 * MS, 0.0), at_angle(85 * MS, 0.1)
    for read_ms in ((0, 85), (70, 85), (0,)):  # at both, only at the second, only at the first
        axis, pressure = read(*read_ms), read(0, 85, 110)
        reckoning = DeadReckoning(first, second, Readings(axis, pressure, 0))
        axis.add(110 * MS, 0.0)
        assert (reckoning.at(110 * MS) is not None) is (read_ms == (0, 85))


def test_a_lost_extrapolation_stays_lost():
    axis, pressure = read(0, 33), read(0, 33, 100)
    reckoning = DeadReckoning(at_angle(0, 0.0), at_angle(33 * MS, 0.1), Readings(axis, pressure, 0))
    assert reckoning.at(100 * MS) is None
    axis.add(110 * MS, 0.0)
    assert reckoning.at(110 * MS) is None


# How strong the arm is


def estimated(strength_at, steps_ms, until_ms=1000, angle=0.8):
    """Estimate the strength of an arm that swings under a resting cart, in repeated steps."""
    model, axis, pressure, rate = TipModel(), ReadingHistory(), ReadingHistory(), 0.0
    strength, next_ms, looks = Strength(), 0, 0
    for t_ms in range(until_ms):
        if t_ms == next_ms:
            axis.add(t_ms * MS, 0.0)
            pressure.add(t_ms * MS, 5.0)
            strength.update(at_angle(t_ms * MS, angle), Readings(axis, pressure, 0))
            next_ms += steps_ms[looks % len(steps_ms)]
            looks += 1
        rate += strength_at(t_ms) * model.own_rad_s2(angle, rate, 5.0) * 1e-3
        angle += rate * 1e-3
    return strength.value


@pytest.mark.parametrize("steps_ms", [(33,), (66,), (33, 66)])
def test_the_arms_strength_is_estimated_over_steps_of_up_to_80_ms(steps_ms):
    assert estimated(lambda _: 0.6, steps_ms) == pytest.approx(0.6, abs=0.04)


@pytest.mark.parametrize("steps_ms", [(100,), (33, 100)])
def test_longer_steps_keep_the_nominal_strength(steps_ms):
    assert estimated(lambda _: 0.6, steps_ms) == 1.0


def test_the_strength_is_estimated_over_the_last_second():
    """The estimate forgets a dropped payload."""
    assert estimated(lambda t_ms: 0.6 if t_ms < 1000 else 1.2, (33,), until_ms=2100) == pytest.approx(1.2, abs=0.06)


def test_the_estimated_strength_stays_within_its_bounds():
    assert estimated(lambda _: 0.2, (33,)) == 0.5
    assert estimated(lambda _: 2.5, (33,)) == 1.5


def of_three(angles, silent=False):
    """Estimate from three poses 25 ms apart without pressure; the axis may be silent at another one between."""
    strength, axis = Strength(), read(0, 25, 50, 75)
    readings, blind = Readings(axis, axis, 0), Readings(ReadingHistory(), axis, 0)
    for tick, angle in enumerate(angles):
        if silent and tick == 2:
            strength.update(at_angle(2 * STEP_NS, angle), blind)
        strength.update(at_angle((tick + (silent and tick == 2)) * STEP_NS, angle), readings)
    return strength.value


def test_the_nominal_strength_has_the_weight_of_200():
    """An arm held where it would swing at 10 rad/s^2 has strength zero, weighted by squares."""
    held = (10.0 - 0.9854) / 53.33
    assert of_three([held] * 3) == pytest.approx(200 / (200 + 10.0**2))
    assert of_three([held] * 3, silent=True) == 1.0


def test_damping_counts_for_a_rotating_arm():
    """The angular rate is 5 rad/s in either direction."""
    assert of_three([-0.125, 0.0, 0.125]) == pytest.approx(200 / (200 + (0.9854 + 5.0 * 0.6769) ** 2))
