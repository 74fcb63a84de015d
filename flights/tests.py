"""Which tests there are. `TEST@MODEL` is one on another simulator, a shipped model or a file."""

import importlib.util
from collections.abc import Callable, Sequence
from typing import NamedTuple

from softarm.flights import runner as trials
from softarm.flights.robots import ROBOTS
from softarm.flights.runner import Outcome, Trial
from softarm.policies.base import Policy
from softarm.schemas.model import Model
from softarm.simulator import model_file

COLUMNS = {
    "in_range": "z <= 0.70 m",
    "above": "z > 0.70 m",
    "all": "all 54",
    "swinging": "54 from mid-swing",
    "shelf": "shelf, 12",
    "shelf_random": "shelf, 500 random",
    "held_back": "held-back robot",
    "held_back_payload": "held-back, 50 g at the tip",
    "held_back_slow": "held-back, slow regulator",
    "held_back_late": "held-back, late rail",
    "held_back_changed": "held-back, all three",
    "held_back_later": "held-back, rail 90 ms late",
    "held_back_weak": "held-back, drive at half its acceleration",
    "held_back_shelf": "held-back, shelf",
}


class Test(NamedTuple):
    """Trials, and the robot that they are flown on."""

    make: Callable[[], list[Trial]]
    fly: Callable[[Policy, Model | None, Sequence[Trial]], list[Outcome]]


def _held_back(robot: str) -> Callable[[Policy, Model | None, Sequence[Trial]], list[Outcome]]:
    """The independent robot is what it is: it takes no model of ours."""
    return lambda policy, _, flown: trials.fly_held_back(policy, ROBOTS[robot], flown)


TESTS = {
    "grid": Test(trials.grid_trials, trials.fly),
    "swinging": Test(trials.swinging_trials, trials.fly_swinging),
    "shelf": Test(trials.shelf_trials, trials.fly),
    "shelf_random": Test(trials.random_shelf_trials, trials.fly),
    "held_back": Test(trials.grid_trials, _held_back("nominal")),
    "held_back_payload": Test(trials.grid_trials, _held_back("payload")),
    "held_back_slow": Test(trials.grid_trials, _held_back("slow")),
    "held_back_late": Test(trials.grid_trials, _held_back("late")),
    "held_back_changed": Test(trials.grid_trials, _held_back("changed")),
    "held_back_later": Test(trials.grid_trials, _held_back("later")),
    "held_back_weak": Test(trials.grid_trials, _held_back("weak")),
    "held_back_shelf": Test(trials.shelf_trials, _held_back("nominal")),
}
# Training model x evaluation model, as the paper's Table 1: its shelf on every shipped simulator and beyond.
MATRIX = (
    "shelf",
    "shelf_random",
    *(f"shelf_random@{name}" for name in model_file.shipped() if name != "seed"),
    "held_back_shelf",
    "held_back",
)


def check(test: str) -> None:
    """Raises ValueError for a test that there is not or that cannot be flown here, ModelFileError for its model."""
    name, _, model = test.partition("@")
    held_back = name.startswith("held_back")
    if name not in TESTS:
        raise ValueError(
            f"no test '{name}'; there is {', '.join(TESTS)}, each also as TEST@MODEL but the held-back ones"
        )
    if model and held_back:
        raise ValueError(f"{test}: the held-back robot takes no model; leave @{model} out")
    if held_back and importlib.util.find_spec("mujoco") is None:
        raise ValueError(f"{test} needs the package 'mujoco': pip install 'softarm[mujoco]', or choose tests by --test")
    if model:
        model_file.load(model)


def label(test: str) -> str:
    """A column's title."""
    name, _, model = test.partition("@")
    return f"{COLUMNS.get(name, COLUMNS['all'])}, on {model}"
