"""Control tick: every fault with its stop, and how a soft stop ends."""

import dataclasses
import math

import numpy as np
import pytest

from softarm.daemon.control.records import EStop, Mode, Problems
from softarm.daemon.runtime.offline import Lockstep
from softarm.daemon.tick import HALF_SWING_S
from softarm.drivers.regulator.driver import reading_of
from softarm.drivers.regulator.teensy import Fault, RegulatorState
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal
from softarm.schemas.messages import SAFE, Command, Pose, RailReading
from softarm.schemas.model import Model
from tests.daemon.rig import PERIOD_NS, Rig, Steady, spoil

STOPS = {
    "rail_fault": {"of": "rail", "faults": ("E12 limit switch",)},
    "remote_off": {"of": "rail", "remote": False},
    "rail_outside": {"of": "rail", "position_m": 0.275},
    "not_finite": {"of": "rail", "velocity_m_s": math.nan},
    "regulator_fault": {"of": "pressure", "faults": ("supply low",)},
    "pressure_outside": {"of": "pressure", "pressure_kpa": 23.0},
}


@pytest.mark.parametrize("name", STOPS)
def test_a_device_that_fails_stops_the_arm_and_latches(name):
    rig = Rig().swinging()
    rig.tick(**spoil(rig, **STOPS[name]))
    assert rig.outputs.mode is Mode.STOPPED
    assert rig.outputs.estop is EStop.ENGAGED
    assert rig.outputs.sent == SAFE
    assert name in [event.name for event in rig.outputs.events]
    assert (rig.outputs.goal.state, rig.outputs.goal.reason) == ("failed", rig.outputs.last_stop)
    rig.tick("acknowledge")
    assert rig.outputs.reset_devices
    rig.tick("acknowledge")
    assert rig.outputs.mode is Mode.DISARMED


def test_a_drive_that_does_not_follow_stops_the_arm():
    """The cart runs at full speed against its set-points."""
    rig = Rig().swinging()
    for ticks in range(1, 30):
        rig.tick(rail=RailReading(rig.now + PERIOD_NS, 0.0, -1.0, True))
        if rig.outputs.mode is not Mode.ARMED:
            break
    assert ticks < 15
    assert (rig.outputs.mode, rig.outputs.estop) == (Mode.STOPPED, EStop.ENGAGED)
    assert "does not follow the drive's set-points" in rig.outputs.last_stop


@pytest.mark.parametrize(
    ("device", "event"), [("pressure", "pressure_stale"), ("rail", "rail_stale"), ("mocap", "mocap_stale")]
)
def test_a_silent_sensor_causes_a_soft_stop_in_time(device, event):
    rig = Rig().swinging()
    frozen = () if device == "mocap" else getattr(rig.inputs(), device)
    for ticks in range(1, 10):
        rig.tick(**{device: frozen})
        if rig.outputs.mode is not Mode.ARMED:
            break
    assert ticks <= 6  # 200 ms
    assert rig.outputs.mode is Mode.STOPPING
    assert rig.outputs.sent == Command(True, 0.0, 0.0)
    assert rig.outputs.events[0].name == f"{device}_stale"
    assert rig.outputs.goal.state == "failed"
    for _ in range(1 + math.ceil(HALF_SWING_S * 30)):  # the other sensors are back, and what is seen is still
        rig.tick()
    assert rig.outputs.mode is Mode.DISARMED
    assert rig.outputs.sent == SAFE


@pytest.mark.parametrize("event", ["rail_stale", "rail_link_lost"])
def test_a_soft_stop_ends_at_once_if_the_axis_is_silent(event):
    """Only the disarmed command makes the regulator's board open DI7, which stops such a drive."""
    rig = Rig().swinging()
    gone = RailReading(rig.now, 0.0, 0.5, True, linked=event == "rail_stale")  # at half a metre a second
    while rig.tick(rail=gone).mode is Mode.ARMED:
        pass
    assert (rig.outputs.mode, [event.name for event in rig.outputs.events]) == (Mode.STOPPING, [event])
    rig.tick(rail=gone)
    assert (rig.outputs.mode, rig.outputs.sent) == (Mode.DISARMED, SAFE)


def test_a_regulator_that_vented_by_itself_is_a_soft_stop_only():
    rig = Rig().swinging()
    state = RegulatorState(41, False, Fault.TIME_TO_LIVE, 0.5)
    rig.tick(pressure=reading_of(state, rig.now + PERIOD_NS))
    assert [event.name for event in rig.outputs.events] == ["regulator_vented"]
    assert rig.outputs.mode is Mode.STOPPING
    rig.tick(pressure=reading_of(state, rig.now + PERIOD_NS))
    assert (rig.outputs.mode, rig.outputs.estop) == (Mode.DISARMED, EStop.CLEAR)
    assert rig.tick(pressure=reading_of(state, rig.now + PERIOD_NS)).arming_refusals == ()


@pytest.mark.parametrize("fault", [fault for fault in Fault if fault is not Fault.TIME_TO_LIVE])
def test_every_other_fault_of_the_regulator_stops_and_latches(fault):
    rig = Rig().swinging()
    state = RegulatorState(41, False, fault | Fault.TIME_TO_LIVE, 0.5)
    rig.tick(pressure=reading_of(state, rig.now + PERIOD_NS))
    assert "regulator_fault" in [event.name for event in rig.outputs.events]
    assert (rig.outputs.mode, rig.outputs.estop) == (Mode.STOPPED, EStop.ENGAGED)


def test_a_late_loop_raises_no_clock_event():
    """The loop reads after it stamps its tick, so frames may arrive between."""
    rig = Rig().swinging()
    inputs, late_ns = rig.inputs(), 20_000_000
    frames = [
        dataclasses.replace(f, t_capture_ns=f.t_capture_ns + late_ns, t_receive_ns=f.t_receive_ns + late_ns)
        for f in inputs.mocap
    ]
    rig.tick(mocap=tuple(frames), t_ns=inputs.t_ns)
    assert rig.outputs.mode is Mode.ARMED
    assert rig.outputs.events == ()
    rig.tick()
    assert rig.outputs.observed.bridged_ns == 0  # nor does it expect the cameras to be ahead of it from now on


def test_an_axis_that_disagrees_with_mocap_for_long_stops():
    rig = Rig().swinging()
    for ticks in range(1, 20):
        rig.tick(rail=RailReading(rig.now, 0.05, 0.0, True))
        if rig.outputs.mode is Mode.STOPPED:
            break
    assert ticks == 10  # 150 ms in which a late camera might explain it, and five ticks
    assert "50 mm apart" in rig.outputs.last_stop


def test_a_late_camera_warns_with_its_milliseconds_and_flies():
    """The stamps hide the delay; the moving axis shows it."""
    late = swung_under_late_cameras(0.06)
    assert late.outputs.mode is Mode.ARMED
    (event,) = [event for event in late.outputs.events if event.name.startswith(("mocap", "rail"))]
    assert event.name == "mocap_late"
    assert 55 <= float(event.text.partition("(")[2].partition(" ms")[0]) <= 65


def test_a_late_camera_stops_softly_and_arming_may_be_repeated():
    late = swung_under_late_cameras(0.12)
    assert late.outputs.mode is Mode.STOPPING
    while late.outputs.mode is Mode.STOPPING:
        late.tick()
    assert late.outputs.mode is Mode.DISARMED
    assert "latency is too high (120 ms, allowed 100 ms)" in late.outputs.last_stop
    assert late.arm().mode is Mode.ARMED


def swung_under_late_cameras(delay_s):
    """Move the cart to and fro for a second with an unreported camera delay."""
    model = Model()
    model.effects["mocap.latency"] = {"delay": delay_s}
    policy = Steady((0.4, 0.0))
    daemon = Lockstep(Config(), policy, model)
    daemon.arm()
    daemon.tick(daemon.request("goal", Goal("reach", 0.0, 0.9)))
    for tick in range(30):
        policy.action[0] = -0.4 if 10 < tick < 20 else 0.4
        daemon.tick()
    return daemon


@pytest.mark.parametrize(
    ("requests", "spoilt"),
    [((), {"of": "rail", "remote": False}), ((), {"of": "pressure", "armed": False}), (("stop",), {"of": "rail"})],
)
def test_the_policy_is_not_asked_in_the_tick_in_which_something_stops(requests, spoilt):
    rig = Rig().swinging()
    steps = len(rig.policy.seen)
    rig.tick(*requests, **spoil(rig, **spoilt))
    assert (len(rig.policy.seen), rig.outputs.action) == (steps, None)


@pytest.mark.parametrize(("velocity_m_s", "mode"), [(0.019, Mode.DISARMED), (0.021, Mode.STOPPING)])
def test_a_cart_is_braked_below_two_centimetres_a_second(velocity_m_s, mode):
    rig = Rig().armed()
    rig.tick("disarm", **spoil(rig, of="rail", velocity_m_s=velocity_m_s))
    assert rig.outputs.mode is mode


def test_a_soft_stop_holds_the_cart_until_the_arm_no_longer_swings():
    rig = Rig().armed()
    for tick in range(90):
        swing_m = 0.1 if tick < 60 else 0.03  # 0.57 m/s at most, then 0.17
        rig.tip = (swing_m * math.sin(2 * math.pi * rig.now * 1e-9 / 1.1), 0.52)
        rig.tick(*["disarm"] * (tick == 10))
        if tick == 60:
            assert rig.outputs.mode is Mode.STOPPING
        if rig.outputs.mode is Mode.DISARMED:
            break
        assert rig.outputs.sent == Command(True, 0.0, 0.0)
    assert 60 + 10 < tick <= 61 + math.ceil(30 * HALF_SWING_S)


def test_an_arm_at_a_turning_point_is_not_at_rest():
    """The arm's speed is 0.31 m/s at most and below 0.3 for 0.44 s at each turn."""
    rig = Rig().armed()
    for tick in range(90):
        rig.tip = (0.055 * math.sin(2 * math.pi * rig.now * 1e-9 / 1.1), 0.52)
        rig.tick(*["disarm"] * (tick == 10))
    assert rig.outputs.mode is Mode.STOPPING


@pytest.mark.parametrize(("every", "held"), [(3, 24), (4, 301)])
def test_an_arm_tracked_too_rarely_is_not_at_rest(every, held):
    """The newest frame is up to 75 ms old, then up to 108; above 100 ms it is stale."""
    rig = Rig().armed()
    rig.tip = (0.02, 0.52)  # 0.6 m/s, and still from there
    rig.tick("disarm")
    ticks = 1
    while rig.outputs.mode is Mode.STOPPING:
        rig.tick(**({} if ticks % every == 1 else {"mocap": ()}))
        ticks += 1
    assert ticks == held


def test_an_untracked_arm_is_held_for_ten_seconds():
    rig = Rig().swinging()
    ticks = 0
    while rig.outputs.mode is not Mode.STOPPING:
        rig.tick(mocap=())
    while rig.outputs.mode is Mode.STOPPING:
        assert rig.outputs.sent == Command(True, 0.0, 0.0)
        rig.tick(mocap=())
        ticks += 1
    assert ticks == 301  # the tick that begins it, and ten seconds
    assert rig.outputs.sent == SAFE


def test_a_soft_stop_waits_one_second_for_the_cart():
    rig = Rig().armed()
    rig.tick("disarm", **spoil(rig, of="rail", velocity_m_s=0.1))
    ticks = 1
    while rig.outputs.mode is Mode.STOPPING:
        rig.tick(**spoil(rig, of="rail", velocity_m_s=0.1))
        ticks += 1
    assert ticks == 31  # the tick that begins it, and a second


@pytest.mark.parametrize("velocity_m_s", [-0.5, 0.5])
def test_a_cart_that_rolls_either_way_is_not_braked_yet(velocity_m_s):
    rig = Rig().armed()
    rig.tick("disarm", **spoil(rig, of="rail", velocity_m_s=velocity_m_s))
    assert rig.outputs.mode is Mode.STOPPING
    assert rig.outputs.sent == Command(True, 0.0, 0.0)
    rig.tick()
    assert rig.outputs.mode is Mode.DISARMED


def test_a_device_that_switches_itself_off_ends_the_swing():
    for changes in ({"of": "rail", "enabled": False}, {"of": "pressure", "armed": False}):
        rig = Rig().swinging()
        rig.tick(**spoil(rig, **changes))
        assert rig.outputs.mode is Mode.STOPPING


class Broken(Steady):
    def __init__(self, answer):
        super().__init__()
        self.answer = answer

    def step(self, observation, goal):
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer


@pytest.mark.parametrize(
    "answer",
    [
        RuntimeError("tensor on the wrong planet"),
        np.array([math.nan, 1.0], dtype=np.float32),
        np.array([0.1, math.inf], dtype=np.float32),
        np.zeros(3, dtype=np.float32),
        np.zeros((1, 2), dtype=np.float32),
        None,
        "left",
    ],
)
def test_a_broken_policy_never_reaches_the_actuators(answer):
    rig = Rig(Broken(answer)).armed()
    rig.tick("goal", goal=Goal("reach", -0.2, 0.6))
    assert rig.outputs.sent == Command(True, 0.0, 0.0)
    assert rig.outputs.mode is Mode.STOPPING
    assert rig.outputs.policy_fault
    assert rig.outputs.goal.state == "failed"
    rig.tick()
    assert rig.outputs.mode is Mode.DISARMED
    rig.tick("arm")
    assert rig.outputs.results[-1].accepted


@pytest.mark.parametrize(("missed", "mode"), [(1, Mode.ARMED), (2, Mode.ARMED), (3, Mode.STOPPING)])
def test_late_ticks_warn_and_many_in_a_row_stop(missed, mode):
    rig = Rig().swinging()
    rig.tick(missed=missed, late_ns=missed * PERIOD_NS)
    assert rig.outputs.mode is mode
    assert rig.outputs.missed_total == missed
    late = {1: "1 skipped, 33 ms late", 2: "2 skipped, 67 ms late", 3: "3 in a row, 100 ms late"}[missed]
    assert late in rig.outputs.events[0].text
    assert rig.outputs.events[0].name == ("ticks_missed" if missed == 3 else "tick_late")


def test_arming_waits_until_the_last_stop_is_over():
    rig = Rig().armed()
    for request in ("disarm", "arm"):
        rig.tick(request, rail=RailReading(rig.now + PERIOD_NS, 0.0, 0.3, True))  # the cart still rolls
    assert "still stopping" in rig.reasons()
    rig.tick()
    rig.tick("arm")
    assert rig.outputs.mode is Mode.ARMING


def test_a_stop_has_the_time_of_its_tick_and_keeps_it():
    rig = Rig().armed()
    assert rig.outputs.last_stop_ns is None
    stopped = rig.tick("stop").t_ns
    assert [rig.tick().last_stop_ns for _ in range(5)] == [stopped] * 5
    rig.tick("acknowledge")
    rig.tick("arm")
    rig.tick()
    assert (rig.outputs.mode, rig.outputs.last_stop_ns) == (Mode.ARMED, stopped)
    soft = rig.tick("disarm").t_ns
    assert [rig.tick().last_stop_ns for _ in range(5)] == [soft] * 5
    replayed = Rig()
    replayed.tick()
    replayed.controller.resume(rig.outputs)
    assert replayed.tick().last_stop_ns == soft


def test_a_stop_from_before_the_daemon_has_no_time():
    assert Rig().tick(latched="a hand").last_stop_ns is None


@pytest.mark.parametrize(
    ("position_m", "said"), [(0.2549, None), (-0.2549, None), (0.2561, "6 mm"), (-0.2692, "19 mm"), (0.2701, None)]
)
def test_an_overrun_of_the_soft_limit_of_millimetres_only_warns(position_m, said):
    """An overrun beyond the filter's margin warns; farther out it stops the arm."""
    rig = Rig().swinging()
    rig.tick(**spoil(rig, of="rail", position_m=position_m))
    texts = [event.text for event in rig.outputs.events if event.name == "rail_overrun"]
    assert len(texts) == (said is not None)
    assert said is None or said in texts[0]
    assert (rig.outputs.mode is Mode.STOPPED) is (abs(position_m) > 0.27)


def test_the_loss_of_the_rails_process_is_a_soft_stop_that_names_it():
    rig = Rig().swinging()
    lost = RailReading(rig.now, 0.0, 0.0, False, linked=False)
    rig.tick(rail=lost, problems=Problems(rail="the rail's process ended: by itself"))
    assert [event.name for event in rig.outputs.events] == ["rail_link_lost"]
    assert "the rail's process ended: by itself" in rig.outputs.last_stop
    assert rig.outputs.mode is Mode.STOPPING
    assert rig.tick(rail=lost).arming_refusals


@pytest.mark.parametrize(
    ("p50_ms", "max_ms", "latency_s", "named"),
    [
        (20, 33, 1 / 30, []),
        (20, 34, 1 / 30, ["rail_slow"]),
        (34, 40, 1 / 30, ["rail_too_slow"]),
        (34, 40, 0.05, ["rail_slow"]),
        (51, 60, 0.05, ["rail_too_slow"]),
        (34, 40, 0.01, ["rail_too_slow"]),
    ],
)
def test_a_slow_drive_stops_the_arm_and_one_slow_cycle_warns(p50_ms, max_ms, latency_s, named):
    config = Config.model_validate({"limits": {"rail": {"latency_s": latency_s}}})
    rig = Rig(config=config).swinging()
    cycles = {"cycle_p50_ns": p50_ms * 1_000_000, "cycle_max_ns": max_ms * 1_000_000}
    rig.tick(rail=RailReading(rig.now + PERIOD_NS, 0.0, 0.0, True, **cycles))
    assert [event.name for event in rig.outputs.events] == named
    assert rig.outputs.mode is (Mode.STOPPING if named == ["rail_too_slow"] else Mode.ARMED)
    assert (rig.outputs.rail_cycle_p50_ms, rig.outputs.rail_cycle_max_ms) == (p50_ms, max_ms)
    for event in rig.outputs.events:
        assert f"median {p50_ms} ms, longest {max_ms} ms in the last second" in event.text


def test_mocap_stamped_in_the_future_is_not_used():
    rig = Rig().swinging()
    frames = rig.inputs().mocap
    rig.now -= PERIOD_NS
    rig.tick(
        mocap=tuple(dataclasses.replace(f, t_capture_ns=f.t_receive_ns + 50_000_000 + i) for i, f in enumerate(frames))
    )
    assert rig.outputs.mode is Mode.STOPPING
    assert "0.050 s ahead of CLOCK_MONOTONIC" in rig.outputs.last_stop


def test_a_mirrored_frame_is_named_and_is_no_fault_of_the_axis():
    daemon = Lockstep(Config(), Steady((0.4, 0.0)))
    read = daemon.robot.mocap.read

    def mirrored(now_ns):
        frames = read(now_ns)
        return tuple(dataclasses.replace(f, bodies=tuple(b._replace(y_m=-b.y_m) for b in f.bodies)) for f in frames)

    daemon.robot.mocap.read = mirrored
    daemon.arm()
    daemon.tick(daemon.request("goal", Goal("reach", 0.0, 0.9)))
    for _ in range(15):
        daemon.tick()
    assert "report opposite directions" in daemon.outputs.last_stop
    assert daemon.outputs.estop is EStop.CLEAR


def test_a_stop_request_latches_until_acknowledged():
    rig = Rig().swinging()
    rig.tick("stop")
    assert (rig.outputs.mode, rig.outputs.sent) == (Mode.STOPPED, SAFE)
    rig.tick("arm")
    assert "emergency stop is latched" in rig.reasons()
    rig.tick("acknowledge")
    assert rig.outputs.mode is Mode.DISARMED
    rig.tick("arm")
    assert rig.outputs.mode is Mode.ARMING


def respoil_bodies(rig, place, pose):
    """Return the newest frames with one body changed."""
    frames = rig.inputs().mocap
    rig.now -= PERIOD_NS
    return tuple(dataclasses.replace(f, bodies=(*f.bodies[:place], pose, *f.bodies[place + 1 :])) for f in frames)


def test_a_nan_pose_stops_the_arm():
    rig = Rig().swinging()
    rig.tick(mocap=respoil_bodies(rig, 5, Pose(math.nan, 0.5, 0.0)))
    assert rig.outputs.mode is Mode.STOPPED
    assert "NaN or infinity" in rig.outputs.last_stop


def test_a_lost_marker_set_of_a_middle_link_only_warns():
    rig = Rig().swinging()
    rig.tick(mocap=respoil_bodies(rig, 2, Pose(0.0, 0.7, 0.0, tracked=False)))
    assert rig.outputs.mode is Mode.ARMED
    assert [event.name for event in rig.outputs.events] == ["mocap_body_lost"]
    assert "link2" in rig.outputs.events[0].text


@pytest.mark.parametrize(("bridge_s", "flown"), [(0.15, 5), (0.06, 2), (0.0, 2)])
def test_a_lost_tip_is_extrapolated_for_a_limited_time(bridge_s, flown):
    rig = Rig(config=Config(failsafe={"mocap_bridge_s": bridge_s})).swinging()
    for ticks in range(1, 10):
        rig.tick(mocap=respoil_bodies(rig, 5, Pose(0.0, 0.5, 0.0, tracked=False)))
        names = [event.name for event in rig.outputs.events]
        if rig.outputs.mode is not Mode.ARMED:
            break
        assert ("mocap_bridged" in names) == (bridge_s > 0 and ticks * PERIOD_NS * 1e-9 <= bridge_s + 0.0167)
    assert ticks == flown + 1
    assert "mocap_stale" in names
    assert rig.outputs.observed.bridged_ns == 0
