import math

import numpy as np
import pytest

from softarm.daemon.control.dead_reckoning import TipModel
from softarm.daemon.control.observer import Observer, as_array
from softarm.daemon.control.records import Inputs
from softarm.schemas.config import Config
from softarm.schemas.messages import MocapFrame, Pose, PressureReading, RailReading
from softarm.schemas.policy import OBSERVATION

MS = 1_000_000


def frame(t_ms, cart=0.0, tip=(0.0, 0.52), sequence=None, tracked=True, way_ms=0):
    bodies = [Pose(cart, 0.965, 0.0), *[Pose(0.0, 0.6, 0.0)] * 4, Pose(*tip, 0.0, tracked)]
    return MocapFrame(t_ms if sequence is None else sequence, t_ms * MS, (t_ms + way_ms) * MS, tuple(bodies))


def feed(observer, t_ms, *frames, pressure=5.0, rail=(0.0, 0.0)):
    now = t_ms * MS
    observer.update(
        Inputs(
            t_ns=now,
            mocap=frames,
            pressure=PressureReading(now, pressure, True),
            rail=RailReading(now, *rail, True),
        )
    )
    return observer.observe(now, previous_cart_velocity_m_s=0.25)


def test_the_observation_has_the_documented_order():
    observer = Observer(Config())
    feed(observer, 0, frame(0, cart=0.1, tip=(-0.1, 0.55)))
    observed = feed(observer, 40, frame(40, cart=0.12, tip=(-0.14, 0.56)))
    names = [signal.name for signal in OBSERVATION]
    assert dict(zip(names, observed.values, strict=True)) == pytest.approx(
        {
            "cart_position": 0.12,
            "cart_velocity": 0.5,
            "tip_y": -0.14,
            "tip_z": 0.56,
            "tip_vy": -1.0,
            "tip_vz": 0.25,
            "previous_cart_velocity_command": 0.25,
            "pressure": 5.0,
        }
    )


def test_velocities_are_differences_over_about_one_control_step():
    """A late or early tick has another newest frame."""
    observer = Observer(Config())
    feed(observer, 33, frame(16, cart=0.009), frame(24, tip=(0.0, 0.521)), frame(29, cart=0.009))
    observed = feed(observer, 66, frame(33, cart=0.009, tip=(0.0, 0.521)), frame(41, cart=0.009), frame(58, cart=0.034))
    assert observed.values.cart_velocity_m_s == pytest.approx(0.034 / 0.034)
    assert observed.mocap_age_ns == 8 * MS
    observed = feed(observer, 70, frame(66, cart=0.045, tip=(0.0, 0.521)))  # four milliseconds after the last
    assert observed.values.cart_velocity_m_s == pytest.approx(0.036 / 0.033)


def test_every_frame_of_a_tick_is_seen():
    observer = Observer(Config())
    feed(
        observer,
        33,
        frame(16, tip=(0.0, 0.6)),
        frame(24, tip=(-0.01, 0.6)),
        frame(24, tip=(0.03, 0.6)),
        frame(33, tip=(0.0, 0.6)),
    )
    assert [(one.t_ns, one.tip_y_m) for one in observer.seen] == [(16 * MS, 0.0), (24 * MS, -0.01), (33 * MS, 0.0)]
    feed(observer, 66)
    assert observer.seen == ()


def velocities(observed):
    return observed.values.cart_velocity_m_s, observed.values.tip_vy_m_s, observed.values.tip_vz_m_s


def test_no_velocity_spans_a_gap_or_precedes_the_second_frame():
    observer = Observer(Config())
    assert velocities(feed(observer, 0, frame(0))) == (0.0, 0.0, 0.0)
    assert velocities(feed(observer, 33, frame(33, cart=0.01, tip=(0.01, 0.53)))) != (0.0, 0.0, 0.0)
    assert velocities(feed(observer, 133, frame(133, cart=0.05, tip=(0.05, 0.53)))) != (0.0, 0.0, 0.0)
    assert velocities(feed(observer, 234, frame(234, cart=0.1, tip=(0.1, 0.53)))) == (0.0, 0.0, 0.0)


def test_a_long_dropout_clears_the_velocities():
    observer = Observer(Config(failsafe={"mocap_bridge_s": 0.0}))
    feed(observer, 0, frame(0))
    feed(observer, 33, frame(33, cart=0.033, tip=(0.033, 0.53)))
    assert velocities(feed(observer, 133)) != (0.0, 0.0, 0.0)
    assert velocities(feed(observer, 134)) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    "unusable",
    [
        frame(24, tip=(-0.11, 0.52), sequence=34),  # older than the newest
        frame(33, tip=(-0.11, 0.52), sequence=34),
        frame(66, tip=(-0.1, 0.3)),  # farther from the cart than the arm is long
        frame(66, tracked=False),
        frame(66, tip=(math.nan, 0.5)),
        frame(66, cart=math.inf),
    ],
)
def test_an_unusable_frame_changes_no_observation(unusable):
    observer = Observer(Config())
    feed(observer, 33, frame(33, tip=(-0.1, 0.52)))
    observed = feed(observer, 66, unusable)
    assert (observed.values.tip_y_m, observed.values.tip_z_m, observed.mocap_age_ns) == (-0.1, 0.52, 33 * MS)
    assert (observer.seen, observer.frames_in_a_row) == ((), 1)
    assert observer.newest is unusable


def test_the_age_of_motion_capture_is_of_its_newest_good_frame():
    observer = Observer(Config())
    assert observer.mocap_age_ns(0) is None
    feed(observer, 40, frame(16), frame(24), frame(31), frame(39, tracked=False))
    assert observer.mocap_age_ns(50 * MS) == 19 * MS


def test_the_reported_lateness_is_the_average_of_the_stamps():
    observer = Observer(Config())
    assert (observer.mocap_late_ns(), observer.bridged_ns, observer.tip_deviation_m) == (0, 0, 0.0)
    feed(observer, 33, frame(20, way_ms=4), frame(24, way_ms=8))
    assert observer.mocap_late_ns() == 6 * MS


def test_a_policy_gets_eight_values_or_ten_with_tracking():
    observer = Observer(Config())
    for t_ms in (0, 33, 66, 99):
        observed = feed(observer, t_ms, *([frame(t_ms)] if t_ms < 60 else []))
    blind, sighted = as_array(observed, wants_tracking=False), as_array(observed, wants_tracking=True)
    assert (blind.dtype, sighted.dtype) == (np.float32, np.float32)
    assert blind == pytest.approx(observed.values)
    assert sighted == pytest.approx((*observed.values, 0.066, observed.tip_deviation_m))


def test_every_sensor_has_its_own_age():
    observer = Observer(Config())
    now = 100 * MS
    pressure, rail = PressureReading(now - 7 * MS, 5.0, True), RailReading(now - 3 * MS, 0.0, 0.0, True)
    observer.update(Inputs(t_ns=now, mocap=(frame(88),), pressure=pressure, rail=rail))
    observed = observer.observe(now, 0.0)
    assert (observed.mocap_age_ns, observed.pressure_age_ns, observed.rail_age_ns) == (12 * MS, 7 * MS, 3 * MS)
    assert observed.mocap_sequence == 88


def test_a_dropout_restarts_the_count_of_frames_for_arming():
    observer = Observer(Config())
    feed(observer, 33, frame(16), frame(24), frame(33))
    assert observer.frames_in_a_row == 3
    feed(observer, 300)
    assert observer.frames_in_a_row == 0


@pytest.mark.parametrize(
    ("axis_ms", "seen_ms", "axis_m", "speed_m_s", "apart_m"),
    [
        (490, 490, 0.25, 0.0, 0.2),
        (401, 401, 0.25, 0.0, 0.2),
        (400, 400, 0.25, 0.0, 0.2),
        (399, 490, 0.25, 0.0, None),  # older than what is flown by
        (490, 399, 0.25, 0.0, None),
        (490, 490, -0.15, 0.0, 0.2),
        (490, 490, 0.25, 0.4, 0.1),  # for 0.15 s of a camera and 0.1 s
        (490, 490, 0.25, -0.4, 0.1),
        (490, 490, 0.25, 2.0, 0.0),
    ],
)
def test_an_axis_is_compared_from_its_first_reading_on(axis_ms, seen_ms, axis_m, speed_m_s, apart_m):
    """A cart is seen at 0.05 m; the tick is at 500 ms."""
    observer = Observer(Config())
    reading = RailReading(axis_ms * MS, axis_m, speed_m_s, True)
    observer.update(Inputs(t_ns=500 * MS, mocap=(frame(seen_ms, cart=0.05, tip=(0.05, 0.52)),), rail=reading))
    assert observer.apart_m == pytest.approx(apart_m)


def test_no_observation_before_every_sensor_has_delivered():
    whole = {"mocap": (frame(0),), "pressure": PressureReading(0, 5.0, True), "rail": RailReading(0, 0.0, 0.0, True)}
    for unheard in (*whole, None):
        observer = Observer(Config())
        observer.update(Inputs(t_ns=0, **{name: reading for name, reading in whole.items() if name != unheard}))
        assert (observer.observe(0, 0.0) is None) is (unheard is not None)


def test_ticks_of_disagreement_are_counted_in_a_row():
    """Disagreement counts once no allowed delay explains it."""
    observer = Observer(Config())
    counted, apart_m = [], []
    for tick in range(14):
        feed(observer, 40 * tick, frame(40 * tick), rail=(0.02 if tick == 7 else 0.05, 0.0))
        counted.append(observer.disagreeing_ticks)
        apart_m.append(observer.apart_m)
    assert (apart_m[6], apart_m[7]) == pytest.approx((0.05, 0.02))
    assert counted == [0, 0, 0, 0, 1, 2, 3, 0, 0, 0, 0, 0, 1, 2]
    feed(observer, 560, rail=(0.5, 0.0))  # no frame: nothing to be compared
    assert (observer.apart_m, observer.disagreeing_ticks) == (pytest.approx(0.05), 2)


def test_a_silent_axis_or_camera_never_disagrees():
    """The cart moves while one sensor is silent and the other continues."""
    for silent in ("rail", "mocap"):
        observer = Observer(Config())
        for tick in range(40):
            cart = 0.02 * min(tick, 20)
            frames = () if silent == "mocap" and tick > 10 else (frame(33 * tick, cart=cart, tip=(cart, 0.52)),)
            at = min(tick, 10) if silent == "rail" else tick
            reading = RailReading(33 * at * MS, 0.02 * min(at, 20), 0.6 if at < 20 else 0.0, True)
            observer.update(Inputs(t_ns=33 * tick * MS, mocap=frames, rail=reading))
            assert observer.disagreeing_ticks == 0


# Dropouts


def place_m(t_ms):
    """Return a cart read every 33 ms that accelerates at 165 ms."""
    return 3e-4 * t_ms + 3e-4 * max(0, t_ms - 165)


def fly(observer, t_ms, *, seen=True, age_ms=8):
    """Return one tick of that cart."""
    taken = t_ms - age_ms
    frames = [frame(taken, cart=place_m(taken), tip=(place_m(taken), 0.53))] if seen else []
    return feed(observer, t_ms, *frames, rail=(place_m(t_ms), 0.0))


def test_during_a_dropout_the_cart_follows_the_axis():
    """The estimate has the age that the newest frame would have, so steps stay equal."""
    observer = Observer(Config())
    for t_ms in range(0, 166, 33):
        observed = fly(observer, t_ms)
    assert (observed.bridged_ns, observed.tip_deviation_m) == (0, 0.0)
    observed = fly(observer, 198, seen=False)
    assert observed.bridged_ns == 33 * MS
    assert observed.mocap_age_ns == 41 * MS
    assert observed.tip_deviation_m == TipModel().deviation_m(0.033)
    assert observed.values.cart_position_m == pytest.approx(place_m(190))
    assert observed.values.cart_velocity_m_s == pytest.approx((place_m(190) - place_m(157)) / 0.033)
    observed = fly(observer, 231, seen=False)
    assert observed.bridged_ns == 66 * MS
    assert observed.values.cart_position_m == pytest.approx(place_m(223))
    assert observed.values.cart_velocity_m_s == pytest.approx(0.6)
    observed = fly(observer, 264)
    assert (observed.bridged_ns, observed.tip_deviation_m) == (0, 0.0)
    assert observed.values.cart_velocity_m_s == pytest.approx(0.6)


def test_the_estimate_has_the_age_of_the_freshest_frame():
    observer = Observer(Config())
    for t_ms, age_ms in ((0, 20), (33, 8), (66, 14)):
        fly(observer, t_ms, age_ms=age_ms)
    assert fly(observer, 99, seen=False).bridged_ns == (99 - 8 - 52) * MS


@pytest.mark.parametrize(
    ("age_ns", "bridged"),
    [(16_666_666, False), (16_666_667, True), (16_666_666 + 150 * MS, True), (16_666_667 + 150 * MS, False)],
)
def test_an_overdue_frame_is_bridged_for_the_allowed_time(age_ns, bridged):
    observer = Observer(Config(failsafe={"mocap_bridge_s": 0.15}))
    for t_ms in (0, 33):
        feed(observer, t_ms, frame(t_ms))
    now_ns = 33 * MS + age_ns
    pressure, rail = PressureReading(now_ns, 5.0, True), RailReading(now_ns, 0.0, 0.0, True)
    observer.update(Inputs(t_ns=now_ns, pressure=pressure, rail=rail))
    assert observer.bridged_ns == (age_ns if bridged else 0)


def test_each_dropout_starts_from_the_last_seen_pose():
    observer = Observer(Config())
    for t_ms, cart in ((0, 0.0), (33, 0.0), (66, None), (99, 0.01), (132, None)):
        observed = feed(observer, t_ms, *([] if cart is None else [frame(t_ms, cart=cart)]))
    assert observed.bridged_ns == 33 * MS
    assert observed.values.cart_position_m == pytest.approx(0.01)


def test_a_late_tick_with_an_extrapolation_keeps_the_next_step():
    """An estimate of a later instant precedes a frame that is old but not overdue."""
    observer = Observer(Config())
    feed(observer, 0, frame(0))
    feed(observer, 33, frame(8), frame(16, cart=0.01), frame(25), frame(33))
    feed(observer, 60)
    assert observer.bridged_ns == 27 * MS
    observed = feed(observer, 66, frame(50, cart=0.03, tip=(0.01, 0.52)))
    assert observed.bridged_ns == 0
    assert observed.values.cart_velocity_m_s == pytest.approx(0.02 / 0.034)


@pytest.mark.parametrize("strength", [0.6, 1.0, 1.4])
def test_an_arm_is_extrapolated_with_its_estimated_strength(strength):
    """A payload swings slower. The cart stands, the pressure is 5 kPa."""
    model, observer, angle, rate = TipModel(), Observer(Config()), 0.8, 0.0
    for t_ms in range(1090):
        rate += strength * model.own_rad_s2(angle, rate, 5.0) * 1e-3
        angle += rate * 1e-3
        if t_ms % 33 == 0:
            length_m = 0.44 + model.bent_m(angle, 5.0)
            tip = (length_m * math.sin(angle), 0.965 - length_m * math.cos(angle))
            observed = feed(observer, t_ms, *([frame(t_ms, tip=tip)] if t_ms < 1000 else []))
    assert observed.bridged_ns == 99 * MS
    assert math.dist(observed.values[2:4], tip) < 0.006


def test_an_unreported_camera_delay_is_estimated_and_extrapolated():
    """40 ms of hidden latency show against the axis; 8 ms of transport are in the stamps."""

    def swung_m(t_ms):
        return 0.15 * math.sin(4.5e-3 * t_ms) + 0.04 * math.sin(11e-3 * t_ms)

    observer = Observer(Config())
    for t_ms in range(0, 1981, 33):
        taken, cart = t_ms - 8, swung_m(t_ms - 48)
        frames = [frame(taken, cart=cart, tip=(cart, 0.53), way_ms=8)] if t_ms < 1900 else []
        speed_m_s = (swung_m(t_ms + 1) - swung_m(t_ms)) * 1e3
        observed = feed(observer, t_ms, *frames, rail=(swung_m(t_ms), speed_m_s))
    assert observer.mocap_late_ns() == pytest.approx(48 * MS, abs=3 * MS)
    assert observed.bridged_ns == 99 * MS
    assert observed.values.cart_position_m == pytest.approx(swung_m(1980 - 48), abs=0.003)


def test_a_frame_of_another_number_of_bodies_cannot_be_made():
    with pytest.raises(ValueError, match=r"6 bodies \(cart, link1, .*\), not 2"):
        MocapFrame(1, 0, 0, (Pose(0.0, 0.965, 0.0), Pose(0.0, 0.5, 0.0)))
