"""Trusted policies run on the control loop's thread; any other policy has its own."""

import numpy as np
import pytest

from softarm.policies import trusted
from softarm.policies.onnx_policy import OnnxPolicy
from softarm.policies.pid import Pid
from softarm.policies.runner import InlineRunner, ThreadRunner

BUDGET_S = 0.02
OBSERVATION, GOAL = np.array([0, 0, 0, 0.52, 0, 0, 0, 0], dtype=np.float32), np.array([-0.2, 0.6], dtype=np.float32)


class Derived(OnnxPolicy):
    """A plug-in that builds on the network, and may do anything in its step."""


@pytest.fixture
def network():
    policy = OnnxPolicy("reach")
    policy.step_s = 1e-4
    return policy


def test_a_fast_network_is_trusted(network):
    assert isinstance(trusted.runner(network, BUDGET_S), InlineRunner)


def test_a_slow_network_and_any_plug_in_have_a_thread():
    slow = OnnxPolicy("reach")
    slow.step_s = 0.0021
    derived = Derived("reach")
    derived.step_s = 1e-4
    for policy in (slow, derived, Pid()):
        runner = trusted.runner(policy, BUDGET_S)
        assert isinstance(runner, ThreadRunner)
        runner.close()


def test_the_time_of_a_step_is_measured_at_loading(monkeypatch):
    now_s = iter((0.0, 5.0, 10.0, 12.0, 20.0, 23.0))
    monkeypatch.setattr("softarm.policies.onnx_policy.monotonic", lambda: next(now_s))
    assert OnnxPolicy("reach").step_s == 2.0


def test_a_rehearsal_leaves_the_state_of_the_network_alone(network):
    alone, runner = OnnxPolicy("reach"), trusted.runner(network, BUDGET_S)
    rehearsal = trusted.rehearsal(runner)
    for number in range(5):
        goal = GOAL + np.float32(0.01 * number)
        rehearsal.step(OBSERVATION + 1, goal - 1)
        expected = alone.step(OBSERVATION, goal)
        rehearsal.step(OBSERVATION - 1, goal + 1)
        np.testing.assert_array_equal(runner.step(OBSERVATION, goal).action, expected)


def test_an_untrusted_policy_is_never_rehearsed():
    class Counting(Pid):
        steps = 0

        def step(self, observation, goal):
            self.steps += 1
            return super().step(observation, goal)

    runner = trusted.runner(Counting(), BUDGET_S)
    rehearsal = trusted.rehearsal(runner)
    assert rehearsal.policy.spec == runner.policy.spec
    assert rehearsal.step(OBSERVATION, GOAL).fault is None
    assert runner.policy.steps == 0
    runner.close()
