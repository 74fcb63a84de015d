"""Events raised by the readings of a tick, with their numbers and thresholds."""

import math
from dataclasses import replace

import pytest

from softarm.daemon.control.checks import device_events
from softarm.daemon.control.dead_reckoning import TipModel
from softarm.daemon.control.observer import Observer
from softarm.daemon.control.records import Inputs, Problems
from softarm.schemas.config import Config
from softarm.schemas.messages import MocapFrame, Pose, PressureReading, RailReading
from softarm.schemas.robot import RAIL_EXCURSION_M

MS = 1_000_000
NOW = 7_000 * MS
PRESSURE = PressureReading(NOW, 3.0, armed=True, sequence=41)
RAIL = RailReading(NOW, 0.0, 0.0, enabled=True)
HANGING = (Pose(0.0, 0.965, 0.0), *[Pose(0.0, 0.7, 0.0)] * 4, Pose(0.0, 0.52, 0.0))
FRAME = MocapFrame(1, NOW - 8 * MS, NOW, HANGING)
HEALTHY = Inputs(t_ns=NOW, mocap=(FRAME,), pressure=PRESSURE, rail=RAIL)
CONFIG = Config.model_validate({"failsafe": {"arming_frames": 1}})


def raised(*inputs: Inputs, engaged: bool = True, config: Config = CONFIG) -> dict[str, str]:
    """Return the events of the last tick with their details."""
    observer = Observer(config)
    for each in inputs:
        observer.update(each)
    return {event.name: event.detail for event in device_events(inputs[-1], observer, config, engaged)}


@pytest.mark.parametrize(
    ("reading", "silent", "device"), [("pressure", None, "regulator"), ("rail", None, "rail"), ("mocap", (), "mocap")]
)
def test_a_silent_device_is_missing_with_its_reason(reading, silent, device):
    gone = replace(HEALTHY, **{reading: silent})
    assert raised(gone) == {f"{reading}_missing": "none since the start"}
    said = Problems(**{device: "no such port"})
    assert raised(replace(gone, problems=said)) == {f"{reading}_missing": "none since the start; no such port"}


# The regulator


def of_pressure(*, engaged: bool = True, problem: str | None = None, **changes) -> dict[str, str]:
    reading = replace(PRESSURE, **changes)
    return raised(replace(HEALTHY, pressure=reading, problems=Problems(regulator=problem)), engaged=engaged)


def test_a_stale_pressure_raises_no_other_event():
    limit_ms = round(CONFIG.failsafe.pressure_stale_s * 1e3)
    assert of_pressure(t_receive_ns=NOW - (limit_ms - 1) * MS) == {}
    old = {"t_receive_ns": NOW - (limit_ms + 1) * MS, "pressure_kpa": 99.0, "faults": ("supply low",), "armed": False}
    assert of_pressure(**old) == {"pressure_stale": f"{limit_ms + 1} ms old, allowed {limit_ms} ms"}
    assert of_pressure(**old, problem="silent") == {
        "pressure_stale": f"{limit_ms + 1} ms old, allowed {limit_ms} ms; silent"
    }


def test_a_pressure_within_the_sensors_tolerance_is_inside():
    limits = CONFIG.limits.pressure
    low, high = limits.min_kpa - limits.sensor_tolerance_kpa, limits.max_kpa + limits.sensor_tolerance_kpa
    assert limits.sensor_tolerance_kpa > 0.1
    for allowed in (low, limits.min_kpa, limits.max_kpa, high):
        assert of_pressure(pressure_kpa=allowed) == {}
    for beyond in (low - 0.05, high + 0.05):
        assert of_pressure(pressure_kpa=beyond) == {
            "pressure_outside": f"{beyond:.1f} kPa, allowed {low:.1f} to {high:.1f} kPa"
        }


def test_a_regulators_faults_are_reported_with_other_events():
    found = of_pressure(faults=("supply low", "sensor out of span"), pressure_kpa=99.0)
    assert found.keys() == {"regulator_fault", "pressure_outside"}
    assert found["regulator_fault"] == "supply low, sensor out of span"


def test_a_regulator_that_is_off_vented_by_itself_only_if_it_should_be_on():
    assert of_pressure(armed=False) == {"regulator_vented": "last accepted command: number 41"}
    assert of_pressure(armed=False, engaged=False) == {}


# The axis


def of_rail(*, engaged: bool = True, problem: str | None = None, config: Config = CONFIG, **changes) -> dict[str, str]:
    inputs = replace(HEALTHY, rail=replace(RAIL, **changes), problems=Problems(rail=problem))
    return raised(inputs, engaged=engaged, config=config)


def test_a_stale_axis_raises_no_other_event():
    limit_ms = round(CONFIG.failsafe.rail_stale_s * 1e3)
    assert of_rail(t_receive_ns=NOW - (limit_ms - 1) * MS) == {}
    old = {"t_receive_ns": NOW - (limit_ms + 1) * MS, "position_m": 9.0, "remote": False, "enabled": False}
    assert of_rail(**old, faults=("E12",), cycle_max_ns=10**9) == {
        "rail_stale": f"{limit_ms + 1} ms old, allowed {limit_ms} ms"
    }


def test_a_lost_link_of_the_axis_raises_no_other_event():
    gone = {"linked": False, "t_receive_ns": 0, "position_m": 9.0, "remote": False}
    assert of_rail(**gone, problem="its process ended") == {"rail_link_lost": "its process ended"}


@pytest.mark.parametrize("side", [-1, 1])
def test_an_overrun_warns_and_beyond_two_centimetres_is_outside(side):
    limits = CONFIG.limits.rail
    end = limits.position_max_m if side > 0 else limits.position_min_m

    def beyond(by_m: float) -> dict[str, str]:
        there = Pose(end + side * by_m, 0.965, 0.0), *HANGING[1:-1], Pose(end + side * by_m, 0.52, 0.0)
        inputs = replace(HEALTHY, mocap=(replace(FRAME, bodies=there),))
        return raised(replace(inputs, rail=replace(RAIL, position_m=end + side * by_m)))

    assert beyond(RAIL_EXCURSION_M - 1e-4) == {}
    assert beyond(RAIL_EXCURSION_M + 1e-4) == {
        "rail_overrun": f"{RAIL_EXCURSION_M * 1e3:.0f} mm beyond it, allowed {RAIL_EXCURSION_M * 1e3:.0f} mm"
    }
    assert beyond(0.0199)["rail_overrun"].startswith("20 mm beyond it")
    assert "rail_outside" not in beyond(0.0199)
    assert beyond(0.0201)["rail_outside"] == (
        f"at {end + side * 0.0201:.3f} m, allowed {limits.position_min_m:.3f} to {limits.position_max_m:.3f} m"
    )


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
def test_a_nan_or_infinite_reading_is_reported_as_such_only(number):
    assert of_pressure(pressure_kpa=number) == {"not_finite": "pressure"}
    for field in ("position_m", "velocity_m_s"):
        assert of_rail(**{field: number}) == {"not_finite": "rail position or velocity"}


def test_all_faults_of_the_drive_are_reported():
    assert of_rail(remote=False, faults=("E12 limit switch", "E20"), enabled=False) == {
        "remote_off": "",
        "rail_fault": "E12 limit switch, E20",
        "rail_disabled": "operation is not enabled",
    }
    assert of_rail(enabled=False, problem="drive is in fault")["rail_disabled"] == (
        "operation is not enabled; drive is in fault"
    )
    assert of_rail(enabled=False, engaged=False) == {}


def test_a_long_cycle_warns_and_one_beyond_the_latency_is_too_slow():
    period_ms = 1e3 / CONFIG.control.rate_hz
    counted_ms = 60.0
    config = Config.model_validate({"limits": {"rail": {"latency_s": 0.06}}, "failsafe": {"arming_frames": 1}})

    def cycle(p50_ms: float, max_ms: float, config: Config = config) -> dict[str, str]:
        return of_rail(config=config, cycle_p50_ns=round(p50_ms * MS), cycle_max_ns=round(max_ms * MS))

    assert cycle(3, period_ms - 1) == {}
    assert cycle(3, period_ms + 1) == {"rail_slow": "median 3 ms, longest 34 ms in the last second"}
    assert cycle(counted_ms - 1, counted_ms + 20) == {"rail_slow": "median 59 ms, longest 80 ms in the last second"}
    assert cycle(counted_ms + 1, counted_ms + 20) == {
        "rail_too_slow": "median 61 ms, longest 80 ms in the last second; allowed 60 ms"
    }
    short = Config.model_validate({"limits": {"rail": {"latency_s": 0.01}}, "failsafe": {"arming_frames": 1}})
    assert cycle(20, 25, short) == {}  # a tick's length is waited for in any case
    assert cycle(35, 40, short) == {"rail_too_slow": "median 35 ms, longest 40 ms in the last second; allowed 33 ms"}


# Motion capture


def later(ms: float, **changes) -> Inputs:
    """Return a healthy tick without a frame, given the age of the last frame."""
    now = FRAME.t_capture_ns + round(ms * MS)
    pressure, rail = replace(PRESSURE, t_receive_ns=now), replace(RAIL, t_receive_ns=now)
    return replace(HEALTHY, t_ns=now, mocap=(), pressure=pressure, rail=rail, **changes)


def test_motion_capture_is_stale_from_its_limit_on():
    limit_ms = round(CONFIG.failsafe.mocap_stale_s * 1e3)
    assert "mocap_stale" not in raised(HEALTHY, later(limit_ms - 1))
    said = Problems(mocap="silent")
    assert raised(HEALTHY, later(limit_ms + 1, problems=said)) == {
        "mocap_stale": f"{limit_ms + 1} ms old, allowed {limit_ms} ms; silent"
    }


def tick(number: int, *, place_m: float = 0.0, axis_m: float = 0.0, speed_m_s: float = 0.0, **changes) -> Inputs:
    """Return a tick with one frame of a hanging arm, whose cart the axis may read elsewhere."""
    now = NOW + number * 33 * MS
    bodies = tuple(pose._replace(y_m=place_m + 1e-5 * number) for pose in HANGING)
    fresh = Inputs(
        t_ns=now,
        mocap=(MocapFrame(number + 1, now - 8 * MS, now, bodies),),
        pressure=replace(PRESSURE, t_receive_ns=now),
        rail=replace(RAIL, t_receive_ns=now, position_m=axis_m, velocity_m_s=speed_m_s),
    )
    return replace(fresh, **changes)


def test_a_dropout_is_bridged_and_reported_with_its_error():
    seen = [tick(number) for number in range(1, 10)]
    dropout = [tick(number, mocap=(), problems=Problems(mocap="silent")) for number in range(10, 20)]
    for ticks in (1, 2, 4):
        off_mm = TipModel().deviation_m(ticks * 0.033) * 1e3
        assert raised(*seen, *dropout[:ticks]) == {
            "mocap_bridged": f"for {ticks * 33} ms, tip known to {off_mm:.0f} mm; silent"
        }
    assert raised(*seen, *dropout[:3], tick(13)) == {}
    late = tick(10).mocap[0]
    late = replace(late, t_capture_ns=late.t_capture_ns - 24 * MS)
    assert raised(*seen, tick(10, mocap=(late,))) == {}  # carried on as well, but something was seen
    assert raised(*seen, *dropout).keys() == {"mocap_stale"}


def test_motion_capture_settles_with_the_frame_that_makes_arming_possible():
    config = Config.model_validate({"failsafe": {"arming_frames": 3}})
    second = replace(FRAME, sequence=2, t_capture_ns=FRAME.t_capture_ns + 4 * MS)
    third = replace(FRAME, sequence=3, t_capture_ns=FRAME.t_capture_ns + 8 * MS)
    assert raised(replace(HEALTHY, mocap=(FRAME, second)), config=config) == {"mocap_settling": "2 of 3 frames"}
    assert raised(replace(HEALTHY, mocap=(FRAME, second, third)), config=config) == {}


def seen(place: int, pose: Pose) -> Inputs:
    return replace(HEALTHY, mocap=(replace(FRAME, bodies=(*HANGING[:place], pose, *HANGING[place + 1 :])),))


def test_implausible_frames_are_named():
    """Three frames stamped 50 ms in the future; `test_plausibility.py` tests every kind."""
    frames = (replace(FRAME, sequence=n, t_capture_ns=NOW + 50 * MS + n) for n in (2, 3, 4))
    assert raised(HEALTHY, replace(HEALTHY, mocap=tuple(frames))).keys() == {"mocap_clock"}


def test_bodies_that_are_not_tracked_are_named():
    first = seen(2, Pose(0.0, 0.7, 0.0, tracked=False)).mocap[0]
    bodies = (*first.bodies[:4], Pose(0.0, 0.6, 0.0, tracked=False), first.bodies[5])
    assert raised(replace(HEALTHY, mocap=(replace(first, bodies=bodies),))) == {"mocap_body_lost": "link2, link4"}


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("field", ["y_m", "z_m", "angle_rad"])
@pytest.mark.parametrize("place", [0, 3, 5])
def test_a_nan_pose_is_reported_if_the_body_is_tracked(place, field, number):
    pose = HANGING[place]._replace(**{field: number})
    assert raised(seen(place, pose))["not_finite"] == "motion capture pose"
    assert "not_finite" not in raised(seen(place, pose._replace(tracked=False)))


def test_motion_capture_that_moves_against_the_axis_is_mirrored():
    def swung(number: int) -> Inputs:
        cart_m, speed_m_s = 0.15 * math.sin(0.15 * number), 0.15 * 4.5 * math.cos(0.15 * number)
        return tick(number, place_m=-cart_m, axis_m=cart_m, speed_m_s=speed_m_s)

    mirrored = raised(*map(swung, range(40)))
    assert mirrored["mocap_mirrored"] == "the cart moves opposite to the axis"
    assert "rail_disagrees" not in mirrored  # its remedy, homing the axis, would be wrong


def arriving(late_ms: float) -> Inputs:
    """Return a frame with a delay by its stamps."""
    return replace(HEALTHY, mocap=(replace(FRAME, t_capture_ns=NOW - round(late_ms * MS)),))


def test_late_poses_warn_and_beyond_the_limit_stop_the_arm():
    allowed_ms = round(CONFIG.failsafe.mocap_late_max_s * 1e3)
    assert raised(arriving(29)) == {}
    assert raised(arriving(31)) == {"mocap_late": "31 ms"}
    assert raised(arriving(allowed_ms - 1))["mocap_late"] == f"{allowed_ms - 1} ms"
    late = raised(arriving(allowed_ms + 1))
    assert late["mocap_too_late"] == f"{allowed_ms + 1} ms, allowed {allowed_ms} ms"
    assert "mocap_late" not in late


# The axis's zero


@pytest.mark.parametrize(("homed", "events"), [(None, {}), (True, {}), (False, {"rail_not_homed": ""})])
def test_an_axis_that_is_not_homed_is_reported(homed, events):
    assert of_rail(homed=homed) == events


def test_the_position_of_an_unhomed_axis_counts_only_while_engaged():
    lost = [replace(each, rail=replace(each.rail, homed=False)) for each in ticks(0, 12, axis_m=-0.3)]
    assert raised(*lost, engaged=False) == {"rail_not_homed": ""}
    assert set(raised(*lost)) == {"rail_not_homed", "rail_outside", "rail_disagrees"}


def ticks(begin: int, count: int, **where) -> list[Inputs]:
    return [tick(number, **where) for number in range(begin, begin + count)]


def before_arming(*inputs: Inputs) -> dict[str, str]:
    return raised(*inputs, engaged=False)


def test_a_wrong_zero_is_reported_from_the_first_reading():
    for count in range(1, 14):
        assert before_arming(*ticks(0, count, axis_m=-0.2)) == {"rail_disagrees": "200 mm apart"}
        assert before_arming(*ticks(0, count, place_m=0.02)) == {}


def test_an_axis_that_returns_with_another_zero_is_reported_at_once():
    before, gone = ticks(0, 12), ticks(12, 40, rail=RAIL)
    assert "rail_disagrees" not in before_arming(*before, *gone)
    for count in range(1, 14):
        back = before_arming(*before, *gone, *ticks(52, count, axis_m=-0.2))
        assert {name for name in back if name.startswith("rail")} == {"rail_disagrees"}


def test_an_axis_that_comes_back_while_the_cart_moves_may_be_ahead_of_late_cameras():
    [first] = ticks(0, 1, axis_m=0.1)
    moving = replace(first, rail=replace(first.rail, velocity_m_s=0.5))
    assert before_arming(first) == {"rail_disagrees": "100 mm apart"}
    assert before_arming(moving) == {}


def test_one_disagreeing_tick_does_not_stop_an_armed_arm():
    """A late camera may explain the first 150 ms; five ticks in a row follow."""
    agreed = ticks(0, 12)
    found = [count for count in range(1, 14) if "rail_disagrees" in raised(*agreed, *ticks(12, count, axis_m=0.1))]
    assert found == list(range(10, 14))
