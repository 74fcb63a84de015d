"""The environment in tensors equals the environment in arrays, on a graphics card where there is one."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from softarm.schemas.config import RailLimits
from softarm.schemas.model import Model
from softarm.training.task.environment import SEEN, Environment, Randomisation
from softarm.training.task.reach import TASKS, ReachTask, ShelfTask
from softarm.training.task.tensor_environment import TensorEnvironment, array_of
from softarm.training.task.tensor_guard import TensorGuard

ROBOTS = 24
card = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a graphics card")
DEVICES = ["cpu", pytest.param("cuda", marks=card)]
TIP_Y = SEEN[1]
NOISELESS = replace(TASKS["reach"], action_noise=0.0, episode_steps=50)


DIFFERENCED: dict[str, dict[str, float]] = {"observation.finite_difference": {}}
SENSORS = {
    "mocap.latency": {"delay": 0.05},
    "mocap.rotation": {"angle": 0.03},
    "mocap.scale": {"scale": 0.02},
    "mocap.offset": {"y": 0.01, "z": -0.02},
    "clock.drift": {"rate": 0.01},
    "pressure.sensor_bias": {"bias": 0.5},
}


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize(
    "effects",
    [
        pytest.param({}, id="velocities"),
        pytest.param(DIFFERENCED, id="differences", marks=pytest.mark.prove),
        pytest.param(SENSORS, id="sensors", marks=pytest.mark.prove),
        pytest.param(SENSORS | DIFFERENCED, id="sensors-differences"),
    ],
)
def test_steps_equal_those_in_arrays(device, effects):
    model = Model(effects=effects)
    one, other = (kind(NOISELESS, ROBOTS, 0, model) for kind in (Environment, lambda *a: _made(*a, device=device)))
    one.restarts = other.restarts = False
    rng = np.random.default_rng(0)
    starts, targets = NOISELESS.sample_starts(rng, ROBOTS, 5), NOISELESS.sample_targets(rng, ROBOTS)
    observation = one.reset(starts, targets), other.reset(starts, targets)
    np.testing.assert_allclose(*map(array_of, observation), atol=1e-5)
    for _ in range(NOISELESS.episode_steps + 1):
        action = rng.uniform(-1.3, 1.3, (ROBOTS, 2)).astype(np.float32)
        for ours, theirs in zip(other.step(action), one.step(action), strict=True):
            np.testing.assert_allclose(array_of(ours).astype(float), theirs.astype(float), atol=2e-3)


def _made(*arguments, device="cpu", **options):
    return TensorEnvironment(*arguments, **options, device=device)


@pytest.mark.parametrize("device", DEVICES)
def test_an_ended_episode_begins_again_within_the_ranges_of_the_task(device):
    task = replace(TASKS["reach"], episode_steps=3, vented_starts=0.0)
    environment = _made(task, ROBOTS, 1, device=device)
    environment.reset()
    action = np.zeros((ROBOTS, 2))
    assert not array_of(environment.step(action).truncated).any()
    environment.step(action)
    before, step = array_of(environment._target).copy(), environment.step(action)
    over = array_of(step.truncated | step.terminated)
    assert over.mean() > 0.5
    observation = array_of(step.observation)[over]
    assert (observation[:, -2:] != before[over]).all()
    for column, (low, high) in ((0, task.cart_start_m), (-2, task.target_y_m), (-1, task.target_z_m)):
        assert ((low <= observation[:, column]) & (observation[:, column] <= high)).all()
    assert (array_of(environment.simulator.pressure_kpa) != 0.0).any()
    assert (array_of(step.final_observation)[:, -2:] == before).all()


@pytest.mark.parametrize("device", DEVICES)
def test_noise_and_dropped_frames_have_the_strength_of_the_effect(device):
    robots, sigma, share = 2000, 0.01, 0.3
    effects = {"mocap.noise": {"sigma": sigma}, "mocap.dropout": {"share": share}}
    environment = _made(NOISELESS, robots, 0, Model(effects=effects), device=device)
    environment.restarts = False
    first = array_of(environment.reset(targets_m=np.full((robots, 2), 9.0)))
    assert np.std(first[:, TIP_Y] - array_of(environment.simulator.tip_m())[:, 0]) == pytest.approx(sigma, rel=0.1)
    action = np.random.default_rng(0).uniform(-1.0, 1.0, (robots, 2)).astype(np.float32)
    second = array_of(environment.step(action).observation)
    assert np.mean((first == second)[:, TIP_Y]) == pytest.approx(share, abs=0.05)


def test_each_episode_draws_from_the_ranges_of_arm_and_sensors():
    ranges = {"arm.payload.mass": (0.01, 0.05), "mocap.offset.y": (0.05, 0.1)}
    environment = _made(NOISELESS, ROBOTS, 0, randomisation=Randomisation(ranges, each_episode=True))
    simulator, drawn = environment.simulator, []
    for _ in range(2):
        offset = environment.reset()[:, 0] - simulator.cart_position_m
        drawn.append(torch.stack((simulator._row(simulator._at.payload), offset)))
    assert (drawn[0] != drawn[1]).all()
    for values, (low, high) in zip(torch.stack(drawn, dim=1), ranges.values(), strict=True):
        assert ((values > low - 1e-4) & (values < high + 1e-4)).all()


def test_a_snapshot_restores_the_episodes():
    model = Model(effects=SENSORS | {"mocap.noise": {"sigma": 0.01}})
    one, other = (_made(TASKS["reach"], ROBOTS, seed, model) for seed in (1, 2))
    one.reset()
    one.stagger()
    other.restore(one.snapshot())
    for _ in range(30):
        action = torch.zeros(ROBOTS, 2)
        assert torch.equal(one.step(action).observation, other.step(action).observation)


def test_what_a_card_does_not_run_is_refused():
    class Own(ReachTask):
        pass

    for task in (ShelfTask(), Own()):
        with pytest.raises(ValueError, match="choose device cpu"):
            _made(task, ROBOTS, 0)
    with pytest.raises(ValueError, match=r"clock\.jitter.*choose device cpu"):
        _made(NOISELESS, ROBOTS, 0, randomisation=Randomisation({"clock.jitter.sigma": (0.0, 0.001)}))


def test_the_traced_braking_law_has_the_bits_of_the_law():
    """The trace runs here in Python, robot by robot; numba compiles the same lines for a card."""
    guard, rng = TensorGuard(ROBOTS, 1 / 30, RailLimits(), torch.device("cpu")), np.random.default_rng(0)
    number = iter(())

    class Cuda:
        @staticmethod
        def grid(dimensions):
            return next(number)

    scope = {"float32": np.float32, "cuda": Cuda, "choose": lambda condition, yes, no: yes if condition else no}
    exec(guard.kernel_source(), scope)
    for _ in range(4):
        wanted, position, velocity = rng.uniform(-1, 1, (3, ROBOTS)).astype(np.float32) * [[1], [0.26], [1]]
        arrays = [each.astype(np.float32) for each in (wanted, position, velocity)]
        sent, result = guard.sent_m_s.numpy().copy(), np.zeros(ROBOTS, np.float32)
        number = iter(range(ROBOTS))
        for _ in range(ROBOTS):
            scope["bound"](*arrays, sent, result)
        np.testing.assert_array_equal(guard.apply(*map(torch.from_numpy, arrays)), result)
