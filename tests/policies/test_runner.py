"""Whatever a policy does, the loop gets an outcome: two finite numbers or a sentence, in time."""

import sys
import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from softarm.policies.base import PolicySpec
from softarm.policies.runner import InlineRunner, PolicyRunner, ThreadRunner
from tests.processes import until

OBSERVATION = np.arange(8, dtype=np.float32)
GOAL = np.array([-0.2, 0.6], dtype=np.float32)
AMPLE_S = 20.0  # no step takes so long, even on a loaded machine


class Scripted:
    """Does what the test says."""

    spec = PolicySpec(name="scripted", description="")

    def __init__(self, step=lambda observation, goal: observation[:2], reset=lambda: None):
        self.step, self.reset = step, reset


@pytest.fixture(params=[InlineRunner, ThreadRunner])
def run(request):
    """Make a runner of either kind; it is closed afterwards."""
    runners = []

    def make(*args, **kwargs):
        runners.append(request.param(Scripted(*args, **kwargs), AMPLE_S))
        return runners[-1]

    yield make
    for runner in runners:
        runner.close()


def test_a_good_action_comes_through_as_float32(run):
    runner: PolicyRunner = run(lambda observation, goal: np.array([0.25, 3]))  # float64, as people write it
    outcome = runner.step(OBSERVATION, GOAL)
    assert outcome.fault is None
    assert outcome.action.dtype == np.float32
    np.testing.assert_array_equal(outcome.action, [0.25, 3])
    assert outcome.duration_ns > 0
    assert runner.policy.spec.name == "scripted"


def boom(observation, goal):
    raise ValueError("no idea\nsecond line")


@pytest.mark.parametrize(
    ("step", "sentence"),
    [
        (boom, "step raised ValueError: no idea"),
        (lambda o, g: sys.exit(3), "step raised SystemExit: 3"),
        (lambda o, g: np.log(-np.abs(o))[:2], "step raised RuntimeWarning"),
        (lambda o, g: None, "step returned NoneType instead of a numpy array"),
        (lambda o, g: o, "step returned an array of shape [8] instead of [2]"),
        (lambda o, g: np.float32(1), "step returned float32 instead of a numpy array"),
        (lambda o, g: np.array([True, False]), "step returned an array of bool instead of float32"),
        (lambda o, g: np.array([np.nan, 0]), "step returned [nan, 0.0], which is not finite"),
        (lambda o, g: np.array([0, -np.inf]), "step returned [0.0, -inf], which is not finite"),
        (lambda o, g: np.array([-np.inf, 0]), "step returned [-inf, 0.0], which is not finite"),
        (lambda o, g: np.array([0, 1e300]), "step returned [0.0, inf], which is not finite"),
    ],
)
def test_an_invalid_action_is_a_fault_and_the_next_step_works(run, step, sentence):
    steps = iter([step, lambda o, g: o[:2]])
    runner = run(lambda o, g: next(steps)(o, g))
    outcome = runner.step(OBSERVATION, GOAL)
    assert outcome.action is None
    assert outcome.fault.startswith(f"policy 'scripted': {sentence}")
    assert "\n" not in outcome.fault
    assert runner.step(OBSERVATION, GOAL).fault is None


@given(
    hnp.arrays(
        st.sampled_from([np.float16, np.float32, np.float64, np.int64, np.uint8, np.bool_, np.complex64]),
        hnp.array_shapes(min_dims=0, max_dims=2, max_side=3),
    )
)
def test_an_outcome_is_an_action_or_a_fault(array):
    outcome = InlineRunner(Scripted(lambda o, g: array)).step(OBSERVATION, GOAL)
    if outcome.fault is None:
        assert outcome.action.shape == (2,)
        assert outcome.action.dtype == np.float32
        assert np.isfinite(outcome.action).all()
    else:
        assert outcome.action is None


def test_policy_and_caller_get_copies(run):
    mine = np.zeros(2, dtype=np.float32)

    def scribble(observation, goal):
        observation[:], goal[:] = 99, 99
        return mine

    runner, observation, goal = run(scribble), OBSERVATION.copy(), GOAL.copy()
    action = runner.step(observation, goal).action
    mine[:] = 7
    np.testing.assert_array_equal(observation, OBSERVATION)
    np.testing.assert_array_equal(goal, GOAL)
    np.testing.assert_array_equal(action, [0, 0])


@pytest.mark.parametrize("early", [False, True])
def test_reset_runs_before_the_first_step_and_once_per_request(run, early):
    calls = []
    runner = run(lambda o, g: calls.append("step") or o[:2], lambda: calls.append("reset"))
    if early:
        runner.reset()
    runner.step(OBSERVATION, GOAL)
    runner.step(OBSERVATION, GOAL)
    runner.reset()
    runner.step(OBSERVATION, GOAL)
    assert calls == ["reset", "step", "step", "reset", "step"]


def interrupted(observation, goal):
    raise KeyboardInterrupt


def test_ctrl_c_ends_a_lockstep_run_and_not_a_policys_thread():
    with pytest.raises(KeyboardInterrupt):
        InlineRunner(Scripted(interrupted)).step(OBSERVATION, GOAL)
    steps = iter([interrupted, lambda o, g: o[:2]])
    runner = ThreadRunner(Scripted(lambda o, g: next(steps)(o, g)), AMPLE_S)
    assert runner.step(OBSERVATION, GOAL).fault == "policy 'scripted': step raised KeyboardInterrupt"
    assert runner.step(OBSERVATION, GOAL).fault is None
    runner.close()


def test_a_failed_reset_is_a_fault_and_is_repeated_before_any_step(run):
    resets = iter([RuntimeError("not yet"), None])

    def reset():
        if error := next(resets):
            raise error

    runner = run(reset=reset)
    assert runner.step(OBSERVATION, GOAL).fault == "policy 'scripted': reset raised RuntimeError: not yet"
    assert runner.step(OBSERVATION, GOAL).fault is None


class Slow:
    """A policy that answers when the test lets it."""

    spec = PolicySpec(name="slow", description="")

    def __init__(self):
        self.let_go, self.started, self.resets, self.steps = threading.Semaphore(0), threading.Event(), 0, 0

    def reset(self):
        self.resets += 1

    def step(self, observation, goal):
        self.started.set()
        self.let_go.acquire()
        self.steps += 1
        return np.array([observation[0], self.steps], dtype=np.float32)


def test_a_late_policy_is_abandoned_and_its_stale_action_discarded():
    policy = Slow()
    runner = ThreadRunner(policy, budget_s=0.2)
    outcome = runner.step(OBSERVATION, GOAL)
    assert outcome.action is None
    assert outcome.fault.startswith("late: policy 'slow' has not answered for ")
    assert outcome.duration_ns >= 200e6
    again = [runner.step(OBSERVATION, GOAL) for _ in range(50)]  # the old step still runs
    assert all(each.fault.startswith("late: ") for each in again)
    assert sum(each.duration_ns for each in again) < 50 * 200e6  # a step that waited would take its budget
    policy.let_go.release(100)
    outcomes = []
    until(lambda: outcomes.append(runner.step(OBSERVATION + 5, GOAL)) or outcomes[-1].fault is None)
    assert outcomes[-1].action[0] == 5  # of the new observation: the late answer, for 0, is gone
    for _ in range(3):
        assert runner.step(OBSERVATION, GOAL).fault is None  # and the policy is not held to be late any more
    runner.close()


def test_a_reset_requested_during_a_late_step_is_not_lost():
    policy = Slow()
    runner = ThreadRunner(policy, budget_s=0.02)
    assert runner.step(OBSERVATION, GOAL).fault
    until(lambda: policy.resets == 1)  # on a busy machine the thread may begin after the budget
    runner.reset()
    policy.let_go.release(100)
    until(lambda: runner.step(OBSERVATION, GOAL).fault is None)
    assert policy.resets == 2
    runner.close()


def test_a_policy_that_hangs_does_not_delay_the_caller():
    policy = Slow()
    runner = ThreadRunner(policy, budget_s=0.01)
    for _ in range(20):
        assert runner.step(OBSERVATION, GOAL).fault.startswith("late")
    runner.close()
    stuck = [thread for thread in threading.enumerate() if thread.name == "policy slow"]
    assert all(thread.daemon for thread in stuck)  # the process ends without them
    assert runner.step(OBSERVATION, GOAL) == (None, "policy 'slow': its runner is closed", 0)
    policy.let_go.release()
    for thread in stuck:
        thread.join()  # once unstuck it ends by itself


def test_close_ends_the_thread_and_may_be_repeated():
    runner = ThreadRunner(Scripted(), AMPLE_S)
    assert runner.step(OBSERVATION, GOAL).fault is None
    runner.close()
    runner.close()
    assert not [thread for thread in threading.enumerate() if thread.name == "policy scripted"]


def test_all_steps_run_on_one_separate_thread():
    seen = set()
    runner = ThreadRunner(Scripted(lambda o, g: seen.add(threading.get_ident()) or o[:2]), AMPLE_S)
    for _ in range(50):
        assert runner.step(OBSERVATION, GOAL).fault is None
    runner.close()
    assert len(seen) == 1
    assert threading.get_ident() not in seen


def test_an_inline_step_beyond_its_budget_is_late_afterwards(monkeypatch):
    now_ns = iter((0, 20_000_000, 0, 20_000_001))
    monkeypatch.setattr("softarm.policies.runner.monotonic_ns", lambda: next(now_ns))
    runner = InlineRunner(Scripted(), budget_s=0.02)
    assert runner.step(OBSERVATION, GOAL).fault is None
    fault = "late: policy 'scripted' answered after 20 ms; its budget is 20 ms"
    assert runner.step(OBSERVATION, GOAL) == (None, fault, 20_000_001)


def test_the_duration_of_a_step_is_measured(run, monkeypatch):
    now_ns = iter(range(100, 1000, 7))
    monkeypatch.setattr("softarm.policies.runner.monotonic_ns", lambda: next(now_ns))
    assert run().step(OBSERVATION, GOAL).duration_ns == 7


def test_the_fault_of_a_late_step_states_its_duration(monkeypatch):
    policy, now_ns = Slow(), [5_000_000_000]
    monkeypatch.setattr("softarm.policies.runner.monotonic_ns", lambda: now_ns[0])
    runner = ThreadRunner(policy, budget_s=0.02)

    def late_at(ns):
        now_ns[0] = ns
        return runner.step(OBSERVATION, GOAL).fault

    assert late_at(5_000_000_000) == "late: policy 'slow' has not answered for 0 ms; its budget is 20 ms"
    assert late_at(5_066_000_000) == "late: policy 'slow' has not answered for 66 ms; its budget is 20 ms"
    policy.let_go.release(100)
    runner.close()
