"""The task as the robot's numbers define it."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softarm.simulator.simulator import Simulator
from softarm.training.learn.validation import at_rest
from softarm.training.task.environment import Environment, to_physical
from softarm.training.task.reach import TASKS, Starts

REACH = TASKS["reach"]
EXACT = replace(REACH, rail_guard=False, action_noise=0.0)
FAR = np.array([[-0.2, 0.9]], dtype=np.float32)


def begin(cart=0.0, target=FAR) -> Environment:
    environment = Environment(EXACT, 1, 0)
    environment.reset(at_rest(np.full(1, cart), environment.simulator.links), target)
    return environment


def test_actions_span_the_commands():
    low, middle, high = to_physical(np.array([[-1, -1], [0, 0], [9, 9]], dtype=np.float32))
    assert low == pytest.approx([-1.0, -0.7])
    assert middle == pytest.approx([0.0, 9.65])
    assert high == pytest.approx([1.0, 20.0])


def test_observations_are_measured_and_differenced_in_the_declared_order():
    environment = begin()
    simulator = Simulator()
    before = environment._observe()[0]
    assert before == pytest.approx([0, 0, 0, 0.5225, 0, 0, 0, 0, -0.2, 0.9], abs=1e-6)
    action = np.array([[0.5, 1.0]], dtype=np.float32)
    for _ in range(3):
        last = np.array([simulator.cart_position_m[0], *simulator.tip_m()[0]])
        simulator.step(0.5, 20.0)
        step = environment.step(action)
    pose = np.array([simulator.cart_position_m[0], *simulator.tip_m()[0]])
    rates = (pose - last) * 30.0
    expected = [pose[0], rates[0], pose[1], pose[2], rates[1], rates[2], 0.5, simulator.pressure_kpa[0], -0.2, 0.9]
    assert step.observation[0] == pytest.approx(expected, abs=1e-5)
    assert step.reward[0] == pytest.approx(0.01 * 0.1 * np.hypot(rates[1], rates[2]), rel=1e-4)


def test_reaching_ends_an_episode_with_the_reward():
    step = begin(target=np.array([[0.0, 0.53]], dtype=np.float32)).step(np.zeros((1, 2), dtype=np.float32))
    assert step.success[0]
    assert step.terminated[0]
    assert not step.truncated[0]
    assert step.reward[0] == pytest.approx(10.0, abs=0.01)


def test_leaving_the_rail_ends_an_episode_with_the_penalty():
    environment = begin(cart=0.24)
    for _ in range(20):
        step = environment.step(np.array([[1.0, -0.93]], dtype=np.float32))
        if step.terminated[0]:
            break
    assert step.terminated[0]
    assert not step.success[0]
    assert step.reward[0] == pytest.approx(-1.0, abs=0.01)
    assert step.final_observation[0, 0] > 0.25
    assert step.observation[0, 0] <= 0.25  # the next episode's start


def test_the_seed_determines_the_run():
    def run(seed: int) -> np.ndarray:
        environment = Environment(REACH, 8, seed)
        environment.reset()
        return environment.step(np.full((8, 2), 0.3, dtype=np.float32)).observation

    assert np.array_equal(run(1), run(1))
    assert not np.array_equal(run(1), run(2))


@settings(max_examples=30, deadline=None)
@given(st.sampled_from(list(TASKS.values())), st.integers(0, 2**32 - 1))
def test_starts_and_targets_stay_in_their_ranges(task, seed):
    rng = np.random.default_rng(seed)
    starts, targets = task.sample_starts(rng, 64, 5), task.sample_targets(rng, 64)
    assert isinstance(starts, Starts)
    for values, (low, high) in (
        (starts.cart_position_m, task.cart_start_m),
        (np.rad2deg(starts.joint_angles_rad), (-task.joint_start_deg, task.joint_start_deg)),
        (starts.pressure_kpa, task.pressure_start_kpa),
        (targets[:, 0], task.target_y_m),
        (targets[:, 1], task.target_z_m),
    ):
        assert low - 1e-5 <= values.min()
        assert values.max() <= high + 1e-5
