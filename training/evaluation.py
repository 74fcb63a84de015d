"""How often a policy reaches: a validation set to choose by, and the seed's 54 targets to report."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from schemas.model import Model
from training.environment import Environment
from training.inference import Workers, infer
from training.network import PolicyNetwork
from training.tasks import Array, ReachTask, Starts

VALIDATION_SEED = 20230
VALIDATION_SET = (
    "two thirds random targets of the training range, one third random targets at z 0.70-0.80 m; random cart starts "
    "of the training range, arm straight at rest; seed 20230; not the 54 test targets"
)
ABOVE_M = 0.70  # targets above it lie outside the seed's training range
GRID_STARTS_M = (0.0, 0.1, 0.2)


class Trials(NamedTuple):
    """Starts and targets of a set of episodes."""

    starts: Starts
    target_m: Array  # [R, 2]


class Outcome(NamedTuple):
    """What became of each trial."""

    reached: NDArray[np.bool_]  # [R]
    time_s: Array  # [R], until the success or the episode's end
    closest_m: Array  # [R]


class GridReport(NamedTuple):
    """Shares of the 54 targets from three starts that were reached."""

    in_range: float
    above: float
    all: float


def at_rest(cart_position_m: Array, links: int) -> Starts:
    """Straight arms, vented."""
    count = len(cart_position_m)
    still = np.zeros((count, links), dtype=np.float32)
    return Starts(cart_position_m.astype(np.float32), still, np.zeros(count, dtype=np.float32))


def validation_trials(task: ReachTask, links: int, count: int = 1536) -> Trials:
    """What checkpoints are chosen by: two thirds random targets of the task's training range, one third of the band
    above the seed's (z 0.70 to 0.80 m, where many are out of reach), from random cart positions of the training
    range, arm straight at rest. Random points: the seed's 54 test targets are a grid, and none of them.
    """
    rng = np.random.default_rng(VALIDATION_SEED)
    inside = task.sample_targets(rng, count - count // 3)
    band = replace(task, target_z_m=(ABOVE_M, 0.80)).sample_targets(rng, count // 3)
    cart = rng.uniform(*task.cart_start_m, count).clip(-0.24, 0.24)
    return Trials(at_rest(cart, links), np.concatenate((inside, band)))


def grid_trials(links: int) -> Trials:
    """The seed's 54 test targets from each of three starts: [3 x 54], start by start."""
    y, z = np.meshgrid(np.linspace(-0.4, 0.0, 9), np.linspace(0.55, 0.80, 6))
    targets = np.tile(np.column_stack((y.ravel(), z.ravel())), (len(GRID_STARTS_M), 1))
    cart = np.repeat(np.array(GRID_STARTS_M), 54)
    return Trials(at_rest(cart, links), targets.astype(np.float32))


def fly(
    network: PolicyNetwork,
    task: ReachTask,
    trials: Trials,
    pool: Workers,
    physics_rate_hz: float = 240.0,
    model: Model | None = None,
    dtype: torch.dtype = torch.float32,
) -> Outcome:
    """Fly every trial once with the policy's mean action and no noise."""
    count = len(trials.target_m)
    environment = Environment(replace(task, action_noise=0.0), count, 0, model, physics_rate_hz)
    observation = environment.reset(trials.starts, trials.target_m)
    reached, alive = np.zeros(count, dtype=np.bool_), np.ones(count, dtype=np.bool_)
    time_s = np.full(count, task.episode_steps / task.rate_hz, dtype=np.float32)
    closest = np.full(count, np.inf, dtype=np.float32)
    state, keep = network.initial_state(count), torch.ones(count)
    for k in range(task.episode_steps):
        mean, _, state = infer(network, torch.from_numpy(observation), keep, state, pool, dtype)
        step = environment.step(mean.numpy())
        tip, target = step.final_tip_m, step.final_observation[:, 8:10]
        closest[alive] = np.minimum(closest, np.linalg.norm(tip - target, axis=1))[alive]
        over = alive & (step.terminated | step.truncated)
        time_s[over] = (k + 1) / task.rate_hz
        reached |= alive & step.success
        alive &= ~over
        observation = step.observation  # robots that began again fly on unseen
    return Outcome(reached, time_s, closest)


def grid_report(
    network: PolicyNetwork,
    task: ReachTask,
    pool: Workers,
    physics_rate_hz: float = 1200.0,
    model: Model | None = None,
) -> GridReport:
    """Success on the 54 targets on a model (default: the seed's), for the record; nothing is chosen by it."""
    trials = grid_trials(links=(model or Model()).arm.links)
    reached = fly(network, task, trials, pool, physics_rate_hz, model).reached
    inside = trials.target_m[:, 1] < ABOVE_M + 1e-4
    return GridReport(*(float(reached[which].mean()) for which in (inside, ~inside, slice(None))))
