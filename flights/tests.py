"""Which tests there are. `TEST@MODEL` is one on another simulator, a shipped model or a file."""

import importlib.util
from collections.abc import Callable
from typing import NamedTuple

from softarm.common.words import did_you_mean
from softarm.flights.robots import ROBOTS
from softarm.flights.runner import Robot
from softarm.reality.parameters import RobotParameters
from softarm.schemas import flights
from softarm.schemas.flights import Scenario
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
    """Scenarios, and the robot that they are flown on."""

    scenarios: Callable[[], list[Scenario]]
    robot: RobotParameters | None = None  # None: the simulator


TESTS = {
    "grid": Test(flights.grid),
    "swinging": Test(flights.swinging),
    "shelf": Test(flights.shelf),
    "shelf_random": Test(flights.random_shelf),
    "held_back": Test(flights.grid, ROBOTS["nominal"]),
    "held_back_payload": Test(flights.grid, ROBOTS["payload"]),
    "held_back_slow": Test(flights.grid, ROBOTS["slow"]),
    "held_back_late": Test(flights.grid, ROBOTS["late"]),
    "held_back_changed": Test(flights.grid, ROBOTS["changed"]),
    "held_back_later": Test(flights.grid, ROBOTS["later"]),
    "held_back_weak": Test(flights.grid, ROBOTS["weak"]),
    "held_back_shelf": Test(flights.shelf, ROBOTS["nominal"]),
}
# Training model x evaluation model, as the paper's Table 1: its shelf on every shipped simulator and beyond.
MATRIX = (
    "shelf",
    "shelf_random",
    *(f"shelf_random@{name}" for name in model_file.shipped() if name != "seed"),
    "held_back_shelf",
    "held_back",
)


def scenarios(test: str) -> list[Scenario]:
    """What is flown in a test."""
    return TESTS[test.partition("@")[0]].scenarios()


def robot(test: str) -> Robot:
    """What it is flown on. Raises ModelFileError."""
    name, _, model = test.partition("@")
    return TESTS[name].robot or (model_file.load(model) if model else Model())


def check(test: str) -> None:
    """Raises ValueError for a test that there is not or that cannot be flown here, ModelFileError for its model."""
    name, _, model = test.partition("@")
    if name not in TESTS:
        hint = did_you_mean(name, TESTS)
        raise ValueError(
            f"no test '{name}'; {hint}there is {', '.join(TESTS)}, each also as TEST@MODEL but the held-back ones"
        )
    held_back = TESTS[name].robot is not None
    if model and held_back:
        raise ValueError(f"{test}: the held-back robot takes no model; leave @{model} out")
    if held_back and importlib.util.find_spec("mujoco") is None:
        raise ValueError(f"{test} needs the package 'mujoco': pip install 'softarm[mujoco]', or choose tests by --test")
    robot(test)


def label(test: str) -> str:
    """A column's title."""
    name, _, model = test.partition("@")
    return f"{COLUMNS.get(name, COLUMNS['all'])}, on {model}"
