"""Control tick: every fault with its stop, and how a soft stop ends."""

import dataclasses
import math

import pytest

from softarm.daemon.control.records import EStop, Mode
from softarm.daemon.runtime.offline import Lockstep
from softarm.daemon.tick import HALF_SWING_S
from softarm.drivers.regulator.driver import reading_of
from softarm.drivers.regulator.teensy import Fault, RegulatorState
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal
from softarm.schemas.messages import SAFE, Command, RailReading
from softarm.schemas.model import Model
from tests.daemon.rig import PERIOD_NS, Rig, Steady


def test_a_device_that_fails_stops_the_arm_and_latches():
    rig = Rig().swinging()
    rig.tick(rail={"faults": ("E12 limit switch",)})
    assert rig.outputs.mode is Mode.STOPPED
    assert rig.outputs.estop is EStop.ENGAGED
    assert rig.outputs.sent == SAFE
    assert "rail_fault" in [event.name for event in rig.outputs.events]
    assert (rig.outputs.goal.state, rig.outputs.goal.reason) == ("failed", rig.outputs.last_stop)
    rig.tick("acknowledge")
    assert rig.outputs.reset_devices
    rig.tick("acknowledge")
    assert rig.outputs.mode is Mode.DISARMED


def test_a_drive_that_does_not_follow_stops_the_arm():
    """The cart runs at full speed against its set-points."""
    rig = Rig().swinging()
    for ticks in range(1, 30):
        rig.tick(rail={"velocity_m_s": -1.0})
        if rig.outputs.mode is not Mode.ARMED:
            break
    assert ticks < 15
    assert (rig.outputs.mode, rig.outputs.estop) == (Mode.STOPPED, EStop.ENGAGED)
    assert "does not follow the drive's set-points" in rig.outputs.last_stop


@pytest.mark.parametrize("device", ["pressure", "rail", "mocap"])
def test_a_silent_sensor_causes_a_soft_stop_in_time(device):
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
    rig.ticks(1 + math.ceil(HALF_SWING_S * 30))  # the other sensors are back, and what is seen is still
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


def test_a_late_camera_stops_softly_and_arming_may_be_repeated():
    """The stamps hide the delay; the cart, which moves to and fro, shows it."""
    model, policy = Model(), Steady((0.4, 0.0))
    model.effects["mocap.latency"] = {"delay": 0.12}
    daemon = Lockstep(Config(), policy, model)
    daemon.arm()
    daemon.tick(daemon.request("goal", Goal("reach", 0.0, 0.9)))
    for tick in range(30):
        policy.action[0] = -0.4 if 10 < tick < 20 else 0.4
        daemon.tick()
    while daemon.outputs.mode is Mode.STOPPING:
        daemon.tick()
    assert daemon.outputs.mode is Mode.DISARMED
    assert "latency is too high (120 ms, allowed 100 ms)" in daemon.outputs.last_stop
    assert daemon.arm().mode is Mode.ARMED


@pytest.mark.parametrize(
    ("requests", "spoilt"),
    [((), {"rail": {"remote": False}}), ((), {"pressure": {"armed": False}}), (("stop",), {})],
)
def test_the_policy_is_not_asked_in_the_tick_in_which_something_stops(requests, spoilt):
    rig = Rig().swinging()
    steps = len(rig.policy.seen)
    rig.tick(*requests, **spoilt)
    assert (len(rig.policy.seen), rig.outputs.action) == (steps, None)


@pytest.mark.parametrize(
    ("velocity_m_s", "mode"),
    [(-0.019, Mode.DISARMED), (0.019, Mode.DISARMED), (-0.021, Mode.STOPPING), (0.021, Mode.STOPPING)],
)
def test_a_cart_is_braked_below_two_centimetres_a_second(velocity_m_s, mode):
    rig = Rig().armed()
    rig.tick("disarm", rail={"velocity_m_s": velocity_m_s})
    assert rig.outputs.mode is mode
    assert rig.outputs.sent == (SAFE if mode is Mode.DISARMED else Command(True, 0.0, 0.0))


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
        assert rig.outputs.sent == Command(True, 0.0, 0.0)
        rig.tick(**({} if ticks % every == 1 else {"mocap": ()}))
        ticks += 1
    assert ticks == held  # 301: the tick that begins it, and ten seconds
    assert rig.outputs.sent == SAFE


def test_a_soft_stop_waits_one_second_for_the_cart():
    rig = Rig().armed()
    rig.tick("disarm", rail={"velocity_m_s": 0.1})
    ticks = 1
    while rig.outputs.mode is Mode.STOPPING:
        rig.tick(rail={"velocity_m_s": 0.1})
        ticks += 1
    assert ticks == 31  # the tick that begins it, and a second


@pytest.mark.parametrize("answer", [RuntimeError("tensor on the wrong planet"), (math.nan, 1.0), None])
def test_a_broken_policy_never_reaches_the_actuators(answer):
    rig = Rig(Steady(answer)).armed()
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
    assert (rig.outputs.action is not None) is (mode is Mode.ARMED)
    assert rig.outputs.missed_total == missed
    late = {1: "1 skipped, 33 ms late", 2: "2 skipped, 67 ms late", 3: "3 in a row, 100 ms late"}[missed]
    assert late in rig.outputs.events[0].text
    assert rig.outputs.events[0].name == ("ticks_missed" if missed == 3 else "tick_late")


def test_arming_waits_until_the_last_stop_is_over():
    rig = Rig().armed()
    for request in ("disarm", "arm"):
        rig.tick(request, rail={"velocity_m_s": 0.3})  # the cart still rolls
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


@pytest.mark.parametrize(("bridge_s", "flown"), [(0.15, 5), (0.06, 2), (0.0, 2)])
def test_a_lost_tip_is_extrapolated_for_a_limited_time(bridge_s, flown):
    rig = Rig(config=Config(failsafe={"mocap_bridge_s": bridge_s})).swinging()
    rig.tip_tracked = False
    for ticks in range(1, 10):
        rig.tick()
        names = [event.name for event in rig.outputs.events]
        if rig.outputs.mode is not Mode.ARMED:
            break
        assert ("mocap_bridged" in names) == (bridge_s > 0 and ticks * PERIOD_NS * 1e-9 <= bridge_s + 0.0167)
    assert ticks == flown + 1
    assert "mocap_stale" in names
    assert rig.outputs.observed.bridged_ns == 0
