"""Control tick: goals, requests, policies and the state that a replay resumes."""

import pytest

from softarm.daemon.control.records import EStop, Mode, Problems, RequestResult
from softarm.policies.base import PolicySpec
from softarm.policies.runner import InlineRunner
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal
from softarm.schemas.messages import SAFE, Command
from tests.daemon.rig import PERIOD_NS, Rig, Steady


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


def test_the_newest_good_frame_is_offered_to_the_api():
    rig = Rig()
    assert rig.controller.frame is None
    rig.tick()
    assert rig.controller.frame.sequence == rig.sequence


def test_the_rails_cycle_time_is_reported_in_milliseconds():
    rig = Rig()
    assert (rig.tick().rail_cycle_p50_ms, rig.outputs.rail_cycle_max_ms) == (None, None)
    rig.tick(rail={"cycle_p50_ns": 3_000_000, "cycle_max_ns": 7_500_000})
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
    rig = Rig().swinging().ticks(100)
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


# Without a target, ending after ten steps.
EPISODE = PolicySpec("episode", "for tests", needs_target=False, episode_steps=10)


def test_a_run_lasts_for_the_policys_episode():
    rig = Rig(Steady(spec=EPISODE)).armed()
    states = [rig.tick("goal", goal=Goal("run")).goal.state] + [rig.tick().goal.state for _ in range(10)]
    assert states == ["running"] * 10 + ["reached"]
    assert len(rig.policy.seen) == 10


def test_a_policy_accepts_only_its_kind_of_goal_and_hold():
    rig = Rig().armed()
    rig.tick("goal", goal=Goal("run"))
    assert rig.reasons() == (
        "the policy 'steady' needs a target: request a reach goal, or choose another policy "
        "(`softarm policy use NAME`, or Policies on the dashboard)"
    )
    assert rig.outputs.goal.state == "none"
    for policy in (Steady(), Steady(spec=EPISODE)):
        rig = Rig(policy).armed()
        rig.tick("goal", goal=Goal("hold"))
        assert rig.outputs.results[-1] == RequestResult(rig.number, True)
        assert (rig.outputs.goal.state, rig.policy.seen) == ("running", [])
    rig.tick("goal", goal=Goal("reach", -0.2, 0.6))
    assert "'episode' does not move to targets" in rig.reasons()


@pytest.mark.parametrize(("kind", "state"), [("goal", "running"), ("cancel_goal", "cancelled")])
def test_hold_and_cancel_keep_the_arm_armed_at_rest(kind, state):
    rig = Rig().swinging()
    rig.tick(kind, goal=Goal("hold"))
    assert rig.outputs.goal.state == state
    assert rig.outputs.sent == Command(True, 0.0, 0.0)
    assert rig.outputs.mode is Mode.ARMED


def test_a_goal_without_arming_is_refused():
    rig = Rig()
    rig.tick("goal", goal=Goal("reach", -0.2, 0.6))
    assert rig.reasons() == "the arm is disarmed: arm it first (`softarm arm`, or Arm on the dashboard)"
    assert rig.outputs.goal.state == "none"


def test_the_policy_is_changed_during_a_hold_but_not_under_a_running_goal():
    rig, other, closed = Rig().swinging(), InlineRunner(Steady((0.0, 1.0))), []
    rig.controller._policy.close = lambda: closed.append("old")
    rig.tick("policy", runners={rig.number + 1: other})
    assert "a goal is running" in rig.reasons()
    assert closed == []
    rig.tick("goal", goal=Goal("hold"))
    rig.tick("policy", runners={rig.number + 1: other})
    assert rig.outputs.results[-1] == RequestResult(rig.number, True)
    assert closed == ["old"]
    rig.tick("goal", goal=Goal("reach", -0.2, 0.6))
    assert rig.outputs.sent.pressure_kpa == 1.0


def test_the_newest_results_are_kept_for_late_readers():
    rig = Rig()
    rig.tick(*["disarm"] * 40)
    assert [result.number for result in rig.outputs.results] == list(range(9, 41))
    assert rig.outputs.results[0] == RequestResult(9, True)


def test_an_acknowledgement_resets_the_devices_with_any_other_request():
    rig = Rig()
    assert rig.tick("disarm", "acknowledge", "arm").reset_devices
    assert not rig.tick("disarm").reset_devices


def test_a_recorder_that_loses_messages_warns():
    rig = Rig().armed()
    rig.tick(recorder_dropped=3)
    assert rig.outputs.mode is Mode.ARMED
    assert "3 so far" in rig.outputs.events[0].text


@pytest.mark.parametrize(("configured", "mode"), [(False, Mode.DISARMED), (True, Mode.ARMING)])
def test_without_a_log_arming_is_refused_unless_configured(configured, mode):
    rig = Rig(config=Config(recorder={"arm_without_log": configured}))
    no_log = {"recorder_problem": "the log ends here: the disk is full"}
    rig.ticks(30, **no_log).tick("arm", **no_log)
    assert rig.outputs.mode is mode
    assert [event.name for event in rig.outputs.events] == ([] if configured else ["not_recorded"])
    assert configured or "(the log ends here: the disk is full)" in rig.reasons()


@pytest.mark.parametrize(
    "lack", [{"rail": {"enabled": False}}, {"pressure": {"armed": False}}, {"rail": None}, {"pressure": None}], ids=str
)
def test_the_arm_is_armed_once_drive_and_regulator_accept_the_command(lack):
    rig = Rig().ticks(30)
    rig.tick("arm")
    assert rig.tick(**lack).mode in (Mode.ARMING, Mode.STOPPING)
    assert rig.outputs.sent == Command(True, 0.0, 0.0)


def test_a_replay_resumes_after_a_gap():
    """From the tick before a gap on, equal inputs give equal outputs."""
    slewed = Config.model_validate({"limits": {"pressure": {"slew_max_kpa_s": 15.0}}})
    flown = Rig(config=slewed).swinging().ticks(5, missed=1, late_ns=PERIOD_NS)
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
        same = ("goal", "state", "number")
        assert [getattr(one.goal, name) for name in same] == [getattr(other.goal, name) for name in same]
    flown.tick("stop")
    replayed.controller.resume(flown.outputs)
    assert replayed.tick().arming_refusals == flown.tick().arming_refusals
    assert (replayed.outputs.mode, replayed.outputs.estop) == (Mode.STOPPED, EStop.LATCHED)
    assert replayed.outputs.last_stop == flown.outputs.last_stop


@pytest.mark.parametrize(
    ("seen", "then_none", "settled"), [(30, 0, True), (3, 0, False), (0, 3, False), (30, 9, False)]
)
def test_a_resumed_replay_counts_the_recorded_frames(seen, then_none, settled):
    flown, replayed = Rig().ticks(seen).ticks(then_none, mocap=()), Rig()
    replayed.tick()
    replayed.controller.resume(flown.outputs)
    assert (replayed.tick().arming_refusals == ()) is settled


@pytest.mark.parametrize(("wants_tracking", "values"), [(False, 8), (True, 10)])
def test_only_a_policy_that_asks_gets_the_tracking_state(wants_tracking, values):
    policy = Steady(spec=PolicySpec("tracking", "for tests", wants_tracking=wants_tracking))
    Rig(policy).swinging()
    assert [len(observation) for observation, _ in policy.seen] == [values]


def test_a_policy_request_without_a_loaded_policy_and_a_goal_request_without_a_goal_are_refused():
    rig = Rig().armed()
    rig.tick("policy")
    assert rig.reasons() == "the policy was not loaded"
    rig.tick("goal")
    assert rig.reasons() == "the goal request has no goal"
