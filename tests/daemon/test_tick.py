"""Complete control tick: goals, requests and every fault."""

import dataclasses
import math
import time

import numpy as np
import pytest

from softarm.daemon.control.records import EStop, Inputs, Mode, Problems, Request, RequestResult
from softarm.daemon.runtime.offline import Lockstep
from softarm.daemon.tick import HALF_SWING_S, Controller
from softarm.drivers.regulator.driver import reading_of
from softarm.drivers.regulator.teensy import Fault, RegulatorState
from softarm.policies.base import PolicySpec
from softarm.policies.runner import InlineRunner
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal
from softarm.schemas.messages import SAFE, Command, MocapFrame, Pose, PressureReading, RailReading
from softarm.schemas.model import Model

PERIOD_NS = 33_333_333


class Steady:
    """Policy with a constant action that records its observations."""

    spec = PolicySpec("steady", "for tests")

    def __init__(self, action=(0.2, 5.0)):
        self.action = np.array(action, dtype=np.float32)
        self.seen, self.resets = [], 0

    def reset(self):
        self.resets += 1

    def step(self, observation, goal):
        self.seen.append((observation.copy(), goal.copy()))
        return self.action


class Rig:
    """Controller with readings of a robot at rest, any of which a test can change."""

    def __init__(self, policy=None, config=None):
        self.policy = policy or Steady()
        self.controller = Controller(config or Config(), InlineRunner(self.policy))
        self.now = 0
        self.number = 0
        self.sequence = 0
        self.tip = (0.0, 0.52)
        self.cart = 0.0
        self.on = False
        self.outputs = None

    def inputs(self, *kinds, goal=None, **changes):
        self.now += PERIOD_NS
        frames = []
        for _ in range(4):
            self.sequence += 1
            tip = Pose(self.tip[0] + 1e-5 * (self.sequence % 2), self.tip[1], 0.0)  # cameras have noise
            bodies = (Pose(self.cart, 0.965, 0.0), *[Pose(self.cart, 0.7, 0.0)] * 4, tip)
            stamp = self.now - (4 - len(frames)) * 8_000_000
            frames.append(MocapFrame(self.sequence, stamp, self.now, bodies))
        requests = []
        for kind in kinds:
            self.number += 1
            requests.append(Request(self.number, kind, goal))
        return dataclasses.replace(
            Inputs(
                t_ns=self.now,
                mocap=tuple(frames),
                pressure=PressureReading(self.now, 0.0, self.on),
                rail=RailReading(self.now, self.cart, 0.0, self.on),
                requests=tuple(requests),
            ),
            **changes,
        )

    def tick(self, *kinds, goal=None, runners=None, **changes):
        self.outputs = self.controller.tick(self.inputs(*kinds, goal=goal, **changes), runners)
        self.on = self.outputs.sent.enable
        return self.outputs

    def armed(self):
        for _ in range(30):
            self.tick()
        self.tick("arm")
        self.tick()
        assert self.outputs.mode is Mode.ARMED
        return self

    def swinging(self):
        self.armed().tick("goal", goal=Goal("reach", -0.2, 0.6))
        assert self.outputs.action is not None
        return self

    def reasons(self):
        return " ".join(self.outputs.results[-1].reasons)


def test_the_controller_starts_disarmed_and_sends_safe_commands():
    rig = Rig()
    for _ in range(40):
        assert rig.tick().sent == SAFE
    assert rig.outputs.mode is Mode.DISARMED
    assert rig.outputs.arming_refusals == ()


def test_arming_enables_at_rest_then_waits_for_a_goal():
    rig = Rig().armed()
    assert rig.outputs.sent == Command(True, 0.0, 0.0)
    assert rig.policy.seen == []


def test_arming_is_refused_with_all_reasons():
    rig = Rig()
    rig.tick("arm", mocap=(), pressure=None, rail=None, problems=Problems(rail="rail 10.0.0.9:502: refused"))
    assert rig.outputs.mode is Mode.DISARMED
    for words in ("motion capture", "pressure regulator has not answered", "rail 10.0.0.9:502: refused"):
        assert words in rig.reasons()
    rig.tick("arm")
    assert "4 of 30 frames" in rig.reasons()


def test_the_policy_flies_the_goal_and_receives_the_sent_command():
    rig = Rig(Steady((1.7, 25.0))).swinging()
    assert rig.policy.resets == 1
    assert rig.outputs.action == pytest.approx((1.7, 25.0))
    assert rig.outputs.sent == Command(True, 1.0, 20.0)
    assert rig.outputs.clamps == ("rail_velocity", "pressure_max")
    rig.tick()
    observation, goal = rig.policy.seen[-1]
    assert observation[6] == 1.0  # sent, not wanted
    assert goal == pytest.approx([-0.2, 0.6])


def test_ticks_are_counted_from_one_and_a_policy_that_is_not_asked_takes_no_time():
    rig = Rig()
    assert [rig.tick().tick for _ in range(3)] == [1, 2, 3]
    assert (rig.outputs.policy_ns, rig.outputs.policy_fault, rig.outputs.action) == (0, None, None)


def test_velocities_span_a_control_step_and_no_gap():
    rig = Rig(config=Config.model_validate({"failsafe": {"mocap_bridge_s": 0.0}}))
    for cart in (0.0, 0.001, 0.003, 0.006):  # ever faster
        rig.cart = cart
        rig.tick()
    assert rig.outputs.observed.values.cart_velocity_m_s == pytest.approx(0.003 * 30)
    for quiet, velocity_m_s in ((1, 0.06), (3, 0.0)):  # frames 67 and 133 ms apart; 100 ms are stale
        for _ in range(quiet):
            rig.tick(mocap=())
        rig.cart += 0.004
        newest = rig.inputs().mocap[-1:]
        rig.now -= PERIOD_NS
        rig.tick(mocap=newest)
        assert rig.outputs.observed.values.cart_velocity_m_s == pytest.approx(velocity_m_s)


def test_the_rails_cycle_time_is_reported_in_milliseconds():
    rig = Rig()
    assert (rig.tick().rail_cycle_p50_ms, rig.outputs.rail_cycle_max_ms) == (None, None)
    rig.tick(**spoil(rig, of="rail", cycle_p50_ns=3_000_000, cycle_max_ns=7_500_000))
    assert (rig.outputs.rail_cycle_p50_ms, rig.outputs.rail_cycle_max_ms) == (3.0, 7.5)


def test_the_pressure_slew_uses_the_loops_period():
    limits = {"pressure": {"slew_max_kpa_s": 60.0}}
    rig = Rig(Steady((0.0, 20.0)), Config.model_validate({"limits": limits})).swinging()
    assert rig.outputs.sent.pressure_kpa == pytest.approx(60.0 / 30)


def test_a_reached_goal_ends_in_a_hold():
    rig = Rig().swinging()
    for tenth in range(1, 10):
        rig.tip = (-0.02 * tenth, 0.52 + 0.008 * tenth)  # no body jumps
        rig.tick()
    assert rig.outputs.goal.state == "reached"
    assert rig.outputs.sent == Command(True, 0.0, 0.0)
    assert rig.outputs.mode is Mode.ARMED


def test_a_goal_out_of_time_fails_and_holds():
    rig = Rig().swinging()
    for _ in range(100):
        rig.tick()
    assert rig.outputs.goal.state == "failed"
    assert "not reached within 3.33 s" in rig.outputs.goal.reason
    assert len(rig.policy.seen) == 100  # the paper's episode
    assert rig.outputs.sent == Command(True, 0.0, 0.0)


def test_a_new_goal_in_mid_swing_resets_the_policy():
    rig = Rig().swinging()
    rig.tick("goal", goal=Goal("reach", -0.3, 0.7))
    assert rig.outputs.goal.number == 2
    assert rig.policy.resets == 2
    assert rig.policy.seen[-1][1] == pytest.approx([-0.3, 0.7])


class Episode(Steady):
    """Policy without a target that ends after ten steps."""

    spec = PolicySpec("episode", "for tests", needs_target=False, episode_steps=10)


def test_a_run_lasts_for_the_policys_episode():
    rig = Rig(Episode()).armed()
    states = [rig.tick("goal", goal=Goal("run")).goal.state] + [rig.tick().goal.state for _ in range(10)]
    assert states == ["running"] * 10 + ["reached"]
    assert len(rig.policy.seen) == 10
    endless = Episode()
    endless.spec = PolicySpec("endless", "for tests", needs_target=False)
    rig = Rig(endless).armed()
    rig.tick("goal", goal=Goal("run"))
    assert {rig.tick().goal.state for _ in range(300)} == {"running"}


def test_a_policy_accepts_only_its_kind_of_goal_and_hold():
    rig = Rig().armed()
    rig.tick("goal", goal=Goal("run"))
    assert rig.reasons() == (
        "the policy 'steady' needs a target: request a reach goal, or choose another policy "
        "(`softarm policy use NAME`, or Policies on the dashboard)"
    )
    assert rig.outputs.goal.state == "none"
    for policy in (Steady(), Episode()):
        rig = Rig(policy).armed()
        rig.tick("goal", goal=Goal("hold"))
        assert rig.outputs.results[-1] == RequestResult(rig.number, True)
        assert (rig.outputs.goal.state, rig.policy.seen) == ("running", [])


def test_a_goal_ended_by_a_stop_names_it():
    rig = Rig().swinging()
    rig.tick(**spoil(rig, of="rail", faults=("E12 limit switch",)))
    assert rig.outputs.goal.state == "failed"
    assert rig.outputs.goal.reason == rig.outputs.last_stop
    assert "E12 limit switch" in rig.outputs.goal.reason


@pytest.mark.parametrize("kind", ["goal", "cancel_goal"])
def test_hold_and_cancel_keep_the_arm_armed_at_rest(kind):
    rig = Rig().swinging()
    rig.tick(kind, goal=Goal("hold"))
    assert rig.outputs.sent == Command(True, 0.0, 0.0)
    assert rig.outputs.mode is Mode.ARMED


def test_a_goal_without_arming_is_refused():
    rig = Rig()
    rig.tick("goal", goal=Goal("reach", -0.2, 0.6))
    assert rig.reasons() == "the arm is disarmed: arm it first (`softarm arm`, or Arm on the dashboard)"
    assert rig.outputs.goal.state == "none"


def test_a_policy_that_does_not_move_to_targets_refuses_a_reach():
    policy = Steady()
    policy.spec = PolicySpec("still", "", needs_target=False)
    rig = Rig(policy).armed()
    rig.tick("goal", goal=Goal("reach", -0.2, 0.6))
    assert "'still' does not move to targets" in rig.reasons()


def test_the_policy_is_not_changed_under_a_running_goal():
    rig, other = Rig().swinging(), InlineRunner(Steady((0.0, 1.0)))
    rig.tick("policy", runners={rig.number + 1: other})
    assert "a goal is running" in rig.reasons()
    rig.tick("cancel_goal")
    rig.tick("policy", runners={rig.number + 1: other})
    assert rig.outputs.results[-1].accepted
    rig.tick("goal", goal=Goal("reach", -0.2, 0.6))
    assert rig.outputs.sent.pressure_kpa == 1.0


def test_a_policy_may_be_changed_during_a_hold_and_the_old_one_is_closed():
    rig = Rig().armed()
    rig.tick("goal", goal=Goal("hold"))
    closed = []
    rig.controller._policy.close = lambda: closed.append("old")
    rig.tick("policy", runners={rig.number + 1: InlineRunner(Steady((0.0, 1.0)))})
    assert rig.outputs.results[-1] == RequestResult(rig.number, True)
    assert closed == ["old"]


def test_the_newest_results_are_kept_for_late_readers():
    rig = Rig()
    rig.tick(*["disarm"] * 40)
    assert [result.number for result in rig.outputs.results] == list(range(9, 41))
    assert rig.outputs.results[0] == RequestResult(9, True)


def test_an_acknowledgement_resets_the_devices_with_any_other_request():
    rig = Rig()
    assert rig.tick("disarm", "acknowledge", "arm").reset_devices
    assert not rig.tick("disarm").reset_devices


def spoil(rig, **fields):
    """Return the next inputs with changed fields of a reading."""
    rig.now -= PERIOD_NS
    fresh = rig.inputs()
    rig.now -= PERIOD_NS
    reading = fields.pop("of")
    return {reading: dataclasses.replace(getattr(fresh, reading), **fields)}


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
    assert rig.outputs.goal.state == "failed"
    rig.tick("acknowledge")
    assert rig.outputs.reset_devices
    rig.tick("acknowledge")
    assert rig.outputs.mode is Mode.DISARMED


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


def test_the_loss_of_the_rails_process_is_a_soft_stop_that_names_it():
    rig = Rig().swinging()
    lost = RailReading(rig.now, 0.0, 0.0, False, linked=False)
    rig.tick(rail=lost, problems=Problems(rail="the rail's process ended: by itself"))
    assert [event.name for event in rig.outputs.events] == ["rail_link_lost"]
    assert "the rail's process ended: by itself" in rig.outputs.last_stop
    assert rig.outputs.mode is Mode.STOPPING
    assert rig.tick(rail=lost).arming_refusals


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


def test_mocap_stamped_in_the_future_is_not_used():
    rig = Rig().swinging()
    frames = rig.inputs().mocap
    rig.now -= PERIOD_NS
    rig.tick(
        mocap=tuple(dataclasses.replace(f, t_capture_ns=f.t_receive_ns + 50_000_000 + i) for i, f in enumerate(frames))
    )
    assert rig.outputs.mode is Mode.STOPPING
    assert "0.050 s ahead of CLOCK_MONOTONIC" in rig.outputs.last_stop


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


@pytest.mark.parametrize("spoilt", [{"of": "rail", "remote": False}, {"of": "pressure", "armed": False}])
def test_the_policy_is_not_asked_in_the_tick_in_which_something_stops(spoilt):
    rig = Rig().swinging()
    steps = len(rig.policy.seen)
    rig.tick(**spoil(rig, **spoilt))
    assert (len(rig.policy.seen), rig.outputs.action) == (steps, None)


def test_the_policy_is_not_asked_in_the_tick_of_a_requested_stop():
    rig = Rig().swinging()
    steps = len(rig.policy.seen)
    rig.tick("stop")
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


def test_reading_the_active_events_changes_nothing():
    rig = Rig().swinging()
    for _ in range(3):
        rig.tick(rail=RailReading(rig.now, 0.05, 0.0, True))
    inputs = rig.inputs()
    assert tuple(rig.controller._events(inputs)) == tuple(rig.controller._events(inputs))


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


def test_a_recorder_that_loses_messages_warns():
    rig = Rig().armed()
    rig.tick(recorder_dropped=3)
    assert rig.outputs.mode is Mode.ARMED
    assert "3 so far" in rig.outputs.events[0].text


NO_LOG = {"recorder_problem": "the log ends here: the disk is full"}


def test_without_a_log_arming_is_refused_with_the_next_step():
    rig = Rig()
    for _ in range(30):
        rig.tick(**NO_LOG)
    rig.tick("arm", **NO_LOG)
    assert rig.outputs.mode is Mode.DISARMED
    assert rig.outputs.arming_refusals == (
        "no log is being written (the log ends here: the disk is full): "
        "remove the cause (recording resumes by itself), or set recorder.arm_without_log: true",
    )
    rig.tick("arm")
    assert rig.outputs.mode is Mode.ARMING


def test_a_log_that_ends_in_flight_only_warns():
    rig = Rig().swinging()
    rig.tick(**NO_LOG)
    assert rig.outputs.mode is Mode.ARMED
    assert rig.outputs.action is not None
    assert [event.response for event in rig.outputs.events] == ["warn"]


def test_arming_without_a_log_can_be_configured():
    rig = Rig(config=Config(recorder={"arm_without_log": True}))
    for _ in range(30):
        rig.tick(**NO_LOG)
    rig.tick("arm", **NO_LOG)
    assert rig.outputs.mode is Mode.ARMING


def test_the_arm_is_armed_once_drive_and_regulator_accept_the_command():
    for pressure, rail in ((True, False), (False, True), (None, True), (True, None)):
        rig = Rig()
        for _ in range(30):
            rig.tick()
        rig.tick("arm")
        fresh = rig.inputs()
        changes = {
            "pressure": None if pressure is None else dataclasses.replace(fresh.pressure, armed=pressure),
            "rail": None if rail is None else dataclasses.replace(fresh.rail, enabled=rail),
        }
        rig.now -= PERIOD_NS
        assert rig.tick(**changes).mode in (Mode.ARMING, Mode.STOPPING)
        assert rig.outputs.sent == Command(True, 0.0, 0.0)


def test_a_replay_resumes_after_a_gap():
    """From the tick before a gap on, equal inputs give equal outputs."""
    slewed = Config.model_validate({"limits": {"pressure": {"slew_max_kpa_s": 15.0}}})
    flown = Rig(config=slewed).swinging()
    for _ in range(5):
        flown.tick(missed=1, late_ns=PERIOD_NS)
    assert 2.0 < flown.outputs.sent.pressure_kpa < 4.0  # on its way
    replayed = Rig(config=slewed)
    replayed.sequence, replayed.now = flown.sequence - 4, flown.now - PERIOD_NS
    replayed.tick()
    replayed.controller.resume(flown.outputs)
    replayed.on = True
    assert flown.outputs.missed_total == 5
    for _ in range(3):
        one, other = flown.tick(), replayed.tick()
        same = ("tick", "missed_total", "mode", "estop", "sent", "action", "last_stop", "arming_refusals", "events")
        assert [getattr(one, name) for name in same] == [getattr(other, name) for name in same]
        assert (one.goal.goal, one.goal.state, one.goal.number) == (
            other.goal.goal,
            other.goal.state,
            other.goal.number,
        )
    flown.tick("stop")
    replayed.controller.resume(flown.outputs)
    assert replayed.tick().arming_refusals == flown.tick().arming_refusals
    assert (replayed.outputs.mode, replayed.outputs.estop) == (Mode.STOPPED, EStop.LATCHED)
    assert replayed.outputs.last_stop == flown.outputs.last_stop


@pytest.mark.parametrize(
    ("seen", "then_none", "settled"), [(30, 0, True), (3, 0, False), (0, 3, False), (30, 9, False)]
)
def test_a_resumed_replay_counts_the_recorded_frames(seen, then_none, settled):
    flown, replayed = Rig(), Rig()
    for _ in range(seen):
        flown.tick()
    for _ in range(then_none):
        flown.tick(mocap=())
    replayed.tick()
    replayed.controller.resume(flown.outputs)
    assert (replayed.tick().arming_refusals == ()) is settled


def test_the_tick_depends_on_its_inputs_only(monkeypatch):
    """Equal inputs give equal outputs; only the policy's time is measured."""

    def run():
        rig, outputs = Rig().swinging(), []
        for _ in range(20):
            outputs.append(dataclasses.replace(rig.tick(), policy_ns=0))
        return outputs

    first = run()
    monkeypatch.setattr(time, "time", lambda: pytest.fail("looked at the clock"))
    assert run() == first


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


class Tracking(Steady):
    spec = PolicySpec("tracking", "asks whether it sees", wants_tracking=True)


def test_only_a_policy_that_asks_gets_the_tracking_state():
    for policy in (Steady(), Tracking()):
        rig = Rig(policy).swinging()
        for _ in range(3):
            rig.tick(mocap=())
        assert [len(observation) for observation, _ in policy.seen] == [10 if isinstance(policy, Tracking) else 8] * 4
    tracking = [observation[8:].tolist() for observation, _ in policy.seen]
    assert tracking[0] == [0.0, 0.0]
    bridged_s, deviations_m = zip(*tracking[1:], strict=True)
    assert bridged_s == pytest.approx((0.0333, 0.0667, 0.1), abs=1e-3)
    assert 0 < deviations_m[0] < deviations_m[1] < deviations_m[2] < 0.03
    observed = rig.outputs.observed
    assert (observed.bridged_ns * 1e-9, observed.tip_deviation_m) == pytest.approx((bridged_s[-1], deviations_m[-1]))


def test_arming_waits_until_the_last_stop_is_over():
    rig = Rig().armed()
    for request in ("disarm", "arm"):
        rig.tick(request, rail=RailReading(rig.now + PERIOD_NS, 0.0, 0.3, True))  # the cart still rolls
    assert "still stopping" in rig.reasons()
    rig.tick()
    rig.tick("arm")
    assert rig.outputs.mode is Mode.ARMING


def test_a_policy_request_without_a_loaded_policy_and_a_goal_request_without_a_goal_are_refused():
    rig = Rig().armed()
    rig.tick("policy")
    assert rig.reasons() == "the policy was not loaded"
    rig.tick("goal")
    assert rig.reasons() == "the goal request has no goal"


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
