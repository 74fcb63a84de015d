"""Success of a network: a validation set to choose checkpoints, and the seed's test trials for reports."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from softarm.schemas import flights
from softarm.schemas.flights import TRAINED_Z_MAX_M, Scenario, Shares
from softarm.schemas.model import Model
from softarm.schemas.policy import Observation
from softarm.schemas.robot import PHYSICS_RATE_HZ, TRAINING_PHYSICS_RATE_HZ
from softarm.training.learn.inference import Act, actor
from softarm.training.learn.network import PolicyNetwork
from softarm.training.task import calls
from softarm.training.task.environment import Environment, Randomisation, ShelfEnvironment, Step
from softarm.training.task.reach import Array, ReachTask, ShelfTask, Starts
from softarm.training.task.registry import plugin_of
from softarm.training.task.tensor_environment import TensorEnvironment, array_of, environment_on

VALIDATION_SEED = 20230
VALIDATION_SET = (
    "two thirds random targets of the training range, one third random targets at z 0.70-0.80 m; random cart starts "
    "of the training range, arm straight at rest; seed 20230; not the 54 test targets"
)
SHELF_VALIDATION_SET = (
    "random targets, depths and cart starts of the training range, arm straight at rest; seed 20230; "
    "none of the test trials"
)
OWN_VALIDATION_SET = "random targets and cart starts of the task's own ranges, arm straight at rest; seed 20230"
RANDOM_SHELF_SEED, RANDOM_SHELF_TRIALS = 54, 500


class Scenarios(NamedTuple):
    """Starts and targets of a set of episodes."""

    starts: Starts
    target_m: Array  # [R, 2]
    depth_m: Array | None = None  # [R], of the targets in their shelves

    def begin(self, environment: Environment | TensorEnvironment) -> Any:
        """Place an environment's robots at the starts and return the observation."""
        if self.depth_m is None:
            return environment.reset(self.starts, self.target_m)
        assert isinstance(environment, ShelfEnvironment), "depths are the shelf's"
        return environment.reset(self.starts, self.target_m, self.depth_m)


class Flown(NamedTuple):
    """Results of R scenarios."""

    reached: NDArray[np.bool_]  # [R]
    time_s: Array  # [R], until the success or the episode's end
    closest_m: Array  # [R]
    tip_m: Array  # [steps + 1, R, 2], the tips' paths y, z from the start on; NaN after an episode's end


class ShelfReport(NamedTuple):
    """Success in the seed's twelve shelf trials and in random ones, as shares."""

    trials: float
    random: float


class Tested(NamedTuple):
    """Test scenarios of a task with their results and reported shares."""

    report: Shares | ShelfReport
    scenarios: Scenarios  # the grid's, or the seed's at the shelf
    flown: Flown

    @property
    def sentence(self) -> str:
        """Shares as a sentence for people."""
        rate = f"at {PHYSICS_RATE_HZ:g} Hz"
        if isinstance(self.report, ShelfReport):
            trials, random = self.report
            return f"the seed's 12 shelf trials, {rate}: {trials:.1%}; 500 random ones: {random:.1%}"
        return f"54 test targets from three starts, {rate}: {self.report.sentence}"


def at_rest(cart_position_m: Array, links: int) -> Starts:
    """Return starts with straight, vented arms at rest."""
    count = len(cart_position_m)
    still = np.zeros((count, links), dtype=np.float32)
    return Starts(cart_position_m.astype(np.float32), still, np.zeros(count, dtype=np.float32))


def validation_scenarios(task: ReachTask, links: int, count: int = 1536) -> Scenarios:
    """Return the validation set, by which checkpoints are chosen.

    Two thirds are random targets of the task's training range, one third lies in the band above the seed's (z 0.70 to
    0.80 m, where many are out of reach). Arms start straight and at rest, at random cart positions of the training
    range. None of the seed's 54 test targets is in the set. For the shelf, and for a plug-in's task, all targets are of
    the training range.
    """
    rng = np.random.default_rng(VALIDATION_SEED)
    if isinstance(task, ShelfTask):
        return _random_shelf_scenarios(task, links, count, rng)
    if plugin_of(task) is not None:
        cart = rng.uniform(*task.cart_start_m, count).clip(-0.24, 0.24)
        return Scenarios(at_rest(cart, links), calls.targets(task, rng, count))
    inside = calls.targets(task, rng, count - count // 3)
    band = calls.targets(replace(task, target_z_m=(TRAINED_Z_MAX_M, 0.80)), rng, count // 3)
    cart = rng.uniform(*task.cart_start_m, count).clip(-0.24, 0.24)
    return Scenarios(at_rest(cart, links), np.concatenate((inside, band)))


def grid_scenarios(links: int) -> Scenarios:
    """Return the seed's 54 test targets from each of three starts: [3 x 54], start by start."""
    return combined(sorted(flights.grid(), key=lambda scenario: scenario.cart_start_m), links)


def combined(scenarios: Sequence[Scenario], links: int) -> Scenarios:
    """Combine scenarios that begin at rest, all with a shelf or all without."""
    targets_m = np.array([(each.goal.y_m, each.goal.z_m) for each in scenarios], dtype=np.float32)
    depths = [each.depth_m for each in scenarios if each.depth_m is not None]
    starts = at_rest(np.array([each.cart_start_m for each in scenarios]), links)
    return Scenarios(starts, targets_m, np.array(depths, dtype=np.float32) if depths else None)


def _random_shelf_scenarios(task: ShelfTask, links: int, count: int, rng: np.random.Generator) -> Scenarios:
    """Return random targets, depths and cart starts of the training range."""
    targets, depths = calls.targets(task, rng, count), calls.depths(task, rng, count)
    return Scenarios(at_rest(rng.uniform(*task.cart_start_m, count).clip(-0.24, 0.24), links), targets, depths)


def fly(
    network: PolicyNetwork,
    task: ReachTask,
    scenarios: Scenarios,
    pool: Executor,
    physics_rate_hz: float = TRAINING_PHYSICS_RATE_HZ,
    model: Model | None = None,
    dtype: torch.dtype = torch.float32,
    randomisation: Randomisation | None = None,
) -> Flown:
    """Fly every scenario once with the policy's mean action, without action noise."""
    act = actor(network, len(scenarios.target_m), pool, dtype)
    return fly_actions(act, task, scenarios, physics_rate_hz, model, randomisation, network.device)


def fly_actions(
    act: Act,
    task: ReachTask,
    scenarios: Scenarios,
    physics_rate_hz: float = TRAINING_PHYSICS_RATE_HZ,
    model: Model | None = None,
    randomisation: Randomisation | None = None,
    device: torch.device | str = "cpu",
) -> Flown:
    """Fly every scenario once with the actions of `act`, without action noise."""
    count = len(scenarios.target_m)
    noiseless = replace(task, action_noise=0.0)
    environment = environment_on(torch.device(device), noiseless, count, 0, model, physics_rate_hz, randomisation)
    first = len(Observation._fields)  # the goal follows the observation
    observation = array_of(scenarios.begin(environment))
    reached, alive = np.zeros(count, dtype=np.bool_), np.ones(count, dtype=np.bool_)
    time_s = np.full(count, task.episode_steps / task.rate_hz, dtype=np.float32)
    closest = np.full(count, np.inf, dtype=np.float32)
    path = np.full((task.episode_steps + 1, count, 2), np.nan, dtype=np.float32)
    path[0] = array_of(environment.simulator.tip_m())
    for k in range(task.episode_steps):
        step = Step(*map(array_of, environment.step(act(observation, alive))))
        tip, target = step.final_tip_m, step.final_observation[:, first : first + 2]
        closest[alive] = np.minimum(closest, np.linalg.norm(tip - target, axis=1))[alive]
        path[k + 1, alive] = tip[alive]
        over = alive & (step.terminated | step.truncated)
        time_s[over] = (k + 1) / task.rate_hz
        reached |= alive & step.success
        alive &= ~over
        observation = step.observation  # restarted robots no longer count
    return Flown(reached, time_s, closest, path)


def chosen_by(task: ReachTask) -> str:
    """Describe the validation set of a task for people."""
    if plugin_of(task) is not None:
        return OWN_VALIDATION_SET
    return SHELF_VALIDATION_SET if isinstance(task, ShelfTask) else VALIDATION_SET


def fly_trials(network: PolicyNetwork, task: ReachTask, pool: Executor, model: Model) -> Tested:
    """Fly a task's test trials on a model; they do not influence the training."""
    links = model.arm.links
    if not isinstance(task, ShelfTask):
        scenarios = grid_scenarios(links)
        flown = fly(network, task, scenarios, pool, PHYSICS_RATE_HZ, model)
        return Tested(flights.shares(flown.reached, scenarios.target_m[:, 1]), scenarios, flown)
    # The seed's twelve trials: four targets from three cart starts.
    scenarios = combined(flights.shelf(), links)
    rng = np.random.default_rng(RANDOM_SHELF_SEED)
    random = _random_shelf_scenarios(replace(ShelfTask(), muscle=task.muscle), links, RANDOM_SHELF_TRIALS, rng)
    seeds, others = (fly(network, task, each, pool, PHYSICS_RATE_HZ, model) for each in (scenarios, random))
    return Tested(ShelfReport(float(seeds.reached.mean()), float(others.reached.mean())), scenarios, seeds)
