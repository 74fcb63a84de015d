import math

import pytest

from softarm.daemon.control.observer import Observer
from softarm.daemon.control.records import Inputs
from softarm.schemas.config import Config
from softarm.schemas.messages import MocapFrame, Pose, PressureReading, RailReading
from softarm.schemas.policy import OBSERVATION

MS = 1_000_000


def frame(t_ms, cart=0.0, tip=(0.0, 0.52), sequence=None, tracked=True):
    bodies = [Pose(cart, 0.965, 0.0), *[Pose(0.0, 0.6, 0.0)] * 4, Pose(*tip, 0.0, tracked)]
    return MocapFrame(t_ms if sequence is None else sequence, t_ms * MS, t_ms * MS, tuple(bodies))


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


def test_the_observation_has_the_papers_order():
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


def test_velocities_are_differenced_over_the_step_that_comes_nearest_to_a_control_step():
    """Whichever tick it came in: a tick that was late or early has other frames for its newest."""
    observer = Observer(Config())
    feed(observer, 33, frame(16, cart=0.009), frame(24, tip=(0.0, 0.521)), frame(29, cart=0.009))
    observed = feed(observer, 66, frame(33, cart=0.009, tip=(0.0, 0.521)), frame(41, cart=0.009), frame(58, cart=0.034))
    assert observed.values.cart_velocity_m_s == pytest.approx(0.034 / 0.034)
    assert observed.mocap_age_ns == 8 * MS
    observed = feed(observer, 70, frame(66, cart=0.045, tip=(0.0, 0.521)))  # four milliseconds after the last
    assert observed.values.cart_velocity_m_s == pytest.approx(0.036 / 0.033)


def test_a_camera_as_fast_as_the_loop_is_differenced_from_tick_to_tick():
    observer = Observer(Config())
    feed(observer, 33, frame(33, cart=0.0))
    observed = feed(observer, 100, frame(100, cart=0.067))
    assert observed.values.cart_velocity_m_s == pytest.approx(1.0)


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


def test_a_tick_without_a_frame_keeps_the_last_velocities_and_ages_where_nothing_is_bridged():
    observer = Observer(Config(failsafe={"mocap_bridge_s": 0.0}))
    feed(observer, 0, frame(0))
    feed(observer, 33, frame(33, cart=0.033))
    observed = feed(observer, 66)
    assert observed.values.cart_velocity_m_s == pytest.approx(1.0)
    assert observed.mocap_age_ns == 33 * MS


def velocities(observed):
    return observed.values.cart_velocity_m_s, observed.values.tip_vy_m_s, observed.values.tip_vz_m_s


def test_nothing_is_differenced_across_a_gap_nor_before_there_are_two_frames():
    observer = Observer(Config())
    assert velocities(feed(observer, 0, frame(0))) == (0.0, 0.0, 0.0)
    assert velocities(feed(observer, 33, frame(33, cart=0.01, tip=(0.01, 0.53)))) != (0.0, 0.0, 0.0)
    assert velocities(feed(observer, 500, frame(500, cart=0.2, tip=(0.2, 0.55)))) == (0.0, 0.0, 0.0)


def test_two_frames_of_one_tick_are_differenced():
    observer = Observer(Config())
    observed = feed(observer, 40, frame(0), frame(33, cart=0.033))
    assert observed.values.cart_velocity_m_s == pytest.approx(1.0)


def test_cameras_that_are_silent_for_long_show_no_velocity_any_more():
    observer = Observer(Config(failsafe={"mocap_bridge_s": 0.0}))
    feed(observer, 0, frame(0))
    feed(observer, 33, frame(33, cart=0.033, tip=(0.033, 0.53)))
    assert velocities(feed(observer, 133)) != (0.0, 0.0, 0.0)
    assert velocities(feed(observer, 134)) == (0.0, 0.0, 0.0)


def test_a_frame_that_was_taken_before_the_newest_is_not_used():
    observer = Observer(Config())
    feed(observer, 33, frame(33, tip=(-0.1, 0.52)))
    observed = feed(observer, 66, frame(24, tip=(-0.11, 0.52), sequence=34))
    assert observed.values.tip_y_m == -0.1
    assert observer.seen == ()


def test_every_sensor_has_an_age_of_its_own():
    observer = Observer(Config())
    now = 100 * MS
    pressure, rail = PressureReading(now - 7 * MS, 5.0, True), RailReading(now - 3 * MS, 0.0, 0.0, True)
    observer.update(Inputs(t_ns=now, mocap=(frame(88),), pressure=pressure, rail=rail))
    observed = observer.observe(now, 0.0)
    assert (observed.mocap_age_ns, observed.pressure_age_ns, observed.rail_age_ns) == (12 * MS, 7 * MS, 3 * MS)
    assert observed.mocap_sequence == 88


@pytest.mark.parametrize("bad", [{"tracked": False}, {"tip": (math.nan, 0.5)}, {"cart": math.inf}])
def test_a_frame_without_cart_or_tip_is_not_used(bad):
    observer = Observer(Config())
    feed(observer, 0, frame(0, tip=(-0.1, 0.6)))
    observed = feed(observer, 33, frame(33, **bad))
    assert (observed.values.tip_y_m, observed.values.tip_z_m) == (-0.1, 0.6)
    assert observed.mocap_age_ns == 33 * MS
    assert observer.newest.t_capture_ns == 33 * MS


def test_lost_frames_are_counted_by_the_bridges_own_numbers():
    observer = Observer(Config())
    feed(observer, 0, frame(0, sequence=7))
    feed(observer, 33, frame(8, sequence=8), frame(33, sequence=12))
    assert observer.frames_lost == 3
    feed(observer, 66, frame(66, sequence=14))
    assert observer.frames_lost == 4
    feed(observer, 99, frame(80, sequence=14), frame(99, sequence=3))  # sent twice; the bridge was started again
    assert observer.frames_lost == 4


def test_silence_starts_the_count_of_frames_for_arming_again():
    observer = Observer(Config())
    feed(observer, 33, frame(16), frame(24), frame(33))
    assert observer.frames_in_a_row == 3
    feed(observer, 300)
    assert observer.frames_in_a_row == 0


def test_the_axis_is_compared_with_mocap_at_one_instant():
    """A cart at 1 m/s read 20 ms before the frame is 20 mm further by then: no disagreement."""
    observer = Observer(Config())
    for tick in range(8):
        now, cart = 40 * tick * MS, 0.04 * tick
        reading = RailReading(now - 30 * MS, cart - 0.03, 1.0, True)
        observer.update(
            Inputs(t_ns=now, mocap=(frame(40 * tick - 10, cart=cart - 0.01, tip=(cart, 0.6)),), rail=reading)
        )
    assert observer.apart_m == pytest.approx(0.0, abs=1e-3)


def test_no_observation_before_every_sensor_has_been_heard():
    whole = {"mocap": (frame(0),), "pressure": PressureReading(0, 5.0, True), "rail": RailReading(0, 0.0, 0.0, True)}
    for unheard in (*whole, None):
        observer = Observer(Config())
        observer.update(Inputs(t_ns=0, **{name: heard for name, heard in whole.items() if name != unheard}))
        assert (observer.observe(0, 0.0) is None) is (unheard is not None)


def test_ticks_of_disagreement_are_counted_in_a_row():
    """From when no camera, as late as they may be, can explain it."""
    observer = Observer(Config())
    counted = []
    for tick in range(14):
        feed(observer, 40 * tick, frame(40 * tick), rail=(0.02 if tick == 7 else 0.05, 0.0))
        counted.append(observer.disagreeing_ticks)
    assert counted == [0, 0, 0, 0, 1, 2, 3, 0, 0, 0, 0, 0, 1, 2]


def test_a_silent_axis_and_a_silent_camera_disagree_with_nobody():
    """The cart was under way when the one fell silent; the other goes on."""
    for silent in ("rail", "mocap"):
        observer = Observer(Config())
        for tick in range(40):
            cart = 0.02 * min(tick, 20)
            frames = () if silent == "mocap" and tick > 10 else (frame(33 * tick, cart=cart, tip=(cart, 0.52)),)
            at = min(tick, 10) if silent == "rail" else tick
            reading = RailReading(33 * at * MS, 0.02 * min(at, 20), 0.6 if at < 20 else 0.0, True)
            observer.update(Inputs(t_ns=33 * tick * MS, mocap=frames, rail=reading))
            assert observer.disagreeing_ticks == 0


def test_a_frame_of_another_number_of_bodies_cannot_be_made():
    with pytest.raises(ValueError, match=r"6 bodies \(cart, link1, .*\), not 2"):
        MocapFrame(1, 0, 0, (Pose(0.0, 0.965, 0.0), Pose(0.0, 0.5, 0.0)))
