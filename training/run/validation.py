"""How often a policy reaches: a validation set to choose by; to report, the seed's 54 targets and its shelf."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from softarm.schemas.goals import SHELF_TARGETS
from softarm.schemas.model import Model
from softarm.schemas.policy import Observation
from softarm.schemas.robot import PHYSICS_RATE_HZ, TRAINING_PHYSICS_RATE_HZ
from softarm.training.learn.inference import Workers, infer
from softarm.training.learn.network import PolicyNetwork
from softarm.training.task.environment import Environment
from softarm.training.task.randomisation import Randomisation
from softarm.training.task.reach import Array, ReachTask, Starts
from softarm.training.task.shelf import ShelfEnvironment, ShelfTask, environment_of

VALIDATION_SEED = 20230
VALIDATION_SET = (
    "two thirds random targets of the training range, one third random targets at z 0.70-0.80 m; random cart starts "
    "of the training range, arm straight at rest; seed 20230; not the 54 test targets"
)
SHELF_VALIDATION_SET = (
    "random targets, depths and cart starts of the training range, arm straight at rest; seed 20230; "
    "none of the test trials"
)
ABOVE_M = 0.70  # targets above it lie outside the seed's training range
GRID_STARTS_M = (0.0, 0.1, 0.2)
RANDOM_SHELF_SEED = 54


class Trials(NamedTuple):
    """Starts and targets of a set of episodes."""

    starts: Starts
    target_m: Array  # [R, 2]
    depth_m: Array | None = None  # [R], of the targets in their shelves

    def begin(self, environment: Environment) -> Array:
        """Put an environment's robots where the trials begin; returns the observation."""
        if self.depth_m is None:
            return environment.reset(self.starts, self.target_m)
        assert isinstance(environment, ShelfEnvironment), "depths are the shelf's"
        return environment.reset(self.starts, self.target_m, self.depth_m)


class Outcome(NamedTuple):
    """What became of each trial."""

    reached: NDArray[np.bool_]  # [R]
    time_s: Array  # [R], until the success or the episode's end
    closest_m: Array  # [R]
    tip_m: Array  # [steps + 1, R, 2], the tips' paths y, z from the start on; NaN after a trial's end


class GridReport(NamedTuple):
    """Shares of the 54 targets from three starts that were reached."""

    in_range: float
    above: float
    all: float

    @property
    def sentence(self) -> str:
        """For people."""
        shares = f"{self.in_range:.1%} in range, {self.above:.1%} above, {self.all:.1%} in all"
        return f"54 test targets from three starts, at {PHYSICS_RATE_HZ:g} Hz: {shares}"


class ShelfReport(NamedTuple):
    """Shares reached of the seed's twelve shelf trials, and of random ones of its training range."""

    trials: float
    random: float

    @property
    def sentence(self) -> str:
        """For people."""
        random = f"500 random ones: {self.random:.1%}"
        return f"the seed's 12 shelf trials, at {PHYSICS_RATE_HZ:g} Hz: {self.trials:.1%}; {random}"


class Tested(NamedTuple):
    """A task's test trials, how each went, and the shares that are told."""

    report: GridReport | ShelfReport
    trials: Trials  # the grid's, or the seed's at the shelf
    outcome: Outcome


def at_rest(cart_position_m: Array, links: int) -> Starts:
    """Straight arms, vented."""
    count = len(cart_position_m)
    still = np.zeros((count, links), dtype=np.float32)
    return Starts(cart_position_m.astype(np.float32), still, np.zeros(count, dtype=np.float32))


def validation_trials(task: ReachTask, links: int, count: int = 1536) -> Trials:
    """What checkpoints are chosen by: two thirds random targets of the task's training range, one third of the band
    above the seed's (z 0.70 to 0.80 m, where many are out of reach), from random cart positions of the training
    range, arm straight at rest. Random points: the seed's 54 test targets are a grid, and none of them. For the shelf
    all are of the training range.
    """
    rng = np.random.default_rng(VALIDATION_SEED)
    if isinstance(task, ShelfTask):
        return _random_shelf_trials(task, links, count, rng)
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


def shelf_trials(task: ShelfTask, links: int) -> Trials:
    """The seed's twelve: four targets ([P] section 4.2), each from the three cart starts of the 54 targets.

    The paper does not say where its shelf stood: here the targets lie in the middle of the range of depths.
    """
    targets = np.repeat(np.array(SHELF_TARGETS, dtype=np.float32), len(GRID_STARTS_M), axis=0)
    cart = np.tile(np.array(GRID_STARTS_M), len(SHELF_TARGETS))
    depths = np.full(len(targets), np.mean(task.target_depth_m), dtype=np.float32)
    return Trials(at_rest(cart, links), targets, depths)


def random_shelf_trials(task: ShelfTask, links: int, count: int = 500) -> Trials:
    """Random targets, depths and cart starts of the task's training range; the same ones every time."""
    return _random_shelf_trials(task, links, count, np.random.default_rng(RANDOM_SHELF_SEED))


def _random_shelf_trials(task: ShelfTask, links: int, count: int, rng: np.random.Generator) -> Trials:
    targets, depths = task.sample_targets(rng, count), task.sample_depths(rng, count)
    return Trials(at_rest(rng.uniform(*task.cart_start_m, count).clip(-0.24, 0.24), links), targets, depths)


def fly(
    network: PolicyNetwork,
    task: ReachTask,
    trials: Trials,
    pool: Workers,
    physics_rate_hz: float = TRAINING_PHYSICS_RATE_HZ,
    model: Model | None = None,
    dtype: torch.dtype = torch.float32,
    randomisation: Randomisation | None = None,
) -> Outcome:
    """Fly every trial once with the policy's mean action and no noise of the action's."""
    count, first = len(trials.target_m), len(Observation._fields)  # the goal follows the observation
    environment = environment_of(replace(task, action_noise=0.0), count, 0, model, physics_rate_hz, randomisation)
    observation = trials.begin(environment)
    reached, alive = np.zeros(count, dtype=np.bool_), np.ones(count, dtype=np.bool_)
    time_s = np.full(count, task.episode_steps / task.rate_hz, dtype=np.float32)
    closest = np.full(count, np.inf, dtype=np.float32)
    path = np.full((task.episode_steps + 1, count, 2), np.nan, dtype=np.float32)
    path[0] = environment.simulator.tip_m()
    state, keep = network.initial_state(count), torch.ones(count, device=network.device)
    for k in range(task.episode_steps):
        mean, _, state = infer(network, torch.from_numpy(observation).to(network.device), keep, state, pool, dtype)
        step = environment.step(mean.cpu().numpy())
        tip, target = step.final_tip_m, step.final_observation[:, first : first + 2]
        closest[alive] = np.minimum(closest, np.linalg.norm(tip - target, axis=1))[alive]
        path[k + 1, alive] = tip[alive]
        over = alive & (step.terminated | step.truncated)
        time_s[over] = (k + 1) / task.rate_hz
        reached |= alive & step.success
        alive &= ~over
        observation = step.observation  # robots that began again fly on unseen
    return Outcome(reached, time_s, closest, path)


@dataclass(frozen=True)
class Validation:
    """What a run's checkpoints are chosen by: the same trials every time, on robots such as it learns on."""

    task: ReachTask
    trials: Trials
    pool: Workers
    physics_rate_hz: float
    model: Model
    dtype: torch.dtype  # of the network's matrix products
    randomisation: Randomisation

    def success(self, network: PolicyNetwork) -> float:
        """Share of the trials that a network reaches."""
        rate_hz, dtype, robots = self.physics_rate_hz, self.dtype, self.randomisation
        outcome = fly(network, self.task, self.trials, self.pool, rate_hz, self.model, dtype, robots)
        return float(outcome.reached.mean())


def chosen_by(task: ReachTask) -> str:
    """What a task's validation set is, for people."""
    return SHELF_VALIDATION_SET if isinstance(task, ShelfTask) else VALIDATION_SET


def test(network: PolicyNetwork, task: ReachTask, pool: Workers, model: Model) -> Tested:
    """Fly a task's test trials on a model, for the record; nothing is chosen by it."""
    if isinstance(task, ShelfTask):
        return shelf_test(network, task, pool, model=model)
    return grid_test(network, task, pool, model=model)


def shelf_test(
    network: PolicyNetwork,
    task: ShelfTask,
    pool: Workers,
    physics_rate_hz: float = PHYSICS_RATE_HZ,
    model: Model | None = None,
) -> Tested:
    """Success at the shelf on a model (default: the seed's), for the record; nothing is chosen by it."""
    links = (model or Model()).arm.links
    trials = shelf_trials(task, links)
    random = random_shelf_trials(replace(ShelfTask(), muscle=task.muscle), links)
    seeds, others = (fly(network, task, each, pool, physics_rate_hz, model) for each in (trials, random))
    return Tested(ShelfReport(float(seeds.reached.mean()), float(others.reached.mean())), trials, seeds)


def grid_test(
    network: PolicyNetwork,
    task: ReachTask,
    pool: Workers,
    physics_rate_hz: float = PHYSICS_RATE_HZ,
    model: Model | None = None,
) -> Tested:
    """Success on the 54 targets on a model (default: the seed's), for the record; nothing is chosen by it."""
    trials = grid_trials(links=(model or Model()).arm.links)
    outcome = fly(network, task, trials, pool, physics_rate_hz, model)
    inside = trials.target_m[:, 1] < ABOVE_M + 1e-4
    shares = (float(outcome.reached[which].mean()) for which in (inside, ~inside, slice(None)))
    return Tested(GridReport(*shares), trials, outcome)


def grid_report(
    network: PolicyNetwork,
    task: ReachTask,
    pool: Workers,
    physics_rate_hz: float = PHYSICS_RATE_HZ,
    model: Model | None = None,
) -> GridReport:
    """Only the shares of `grid_test`."""
    report = grid_test(network, task, pool, physics_rate_hz, model).report
    assert isinstance(report, GridReport)
    return report
