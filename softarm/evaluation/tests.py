"""The tests of `softarm evaluate`; `TEST@MODEL` flies one on another simulator, a shipped model or a file."""

import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from softarm.common.words import did_you_mean
from softarm.evaluation.robots import ROBOTS
from softarm.evaluation.runner import Robot
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
    "held_back": "independent robot",
    "held_back_payload": "independent, 50 g at the tip",
    "held_back_slow": "independent, slow regulator",
    "held_back_late": "independent, late rail",
    "held_back_changed": "independent, all three",
    "held_back_later": "independent, rail 90 ms late",
    "held_back_weak": "independent, drive at half its acceleration",
    "held_back_shelf": "independent, shelf",
}


class Test(NamedTuple):
    """Scenarios and the robot that flies them."""

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
# Training model x evaluation model, as in the paper's Table 1: its shelf on every shipped simulator and beyond.
MATRIX = (
    "shelf",
    "shelf_random",
    *(f"shelf_random@{name}" for name in model_file.shipped() if name != "seed"),
    "held_back_shelf",
    "held_back",
)


def default(every_test: bool, matrix: bool) -> tuple[str, ...]:
    """Return the tests that are flown where none is named."""
    if matrix:
        return MATRIX
    return tuple(TESTS) if every_test else ("grid",)


def on_model(test: str, model: Path) -> str:
    """Return the test on another model of the simulator; tests on the independent robot have none and stay."""
    known = TESTS.get(test)
    return test if known is not None and known.robot is not None else f"{test}@{model}"


def scenarios(test: str) -> list[Scenario]:
    """Return the scenarios of a test."""
    return TESTS[test.partition("@")[0]].scenarios()


def robot(test: str) -> Robot:
    """Return the robot of a test. Raises ModelFileError for an invalid model."""
    name, _, model = test.partition("@")
    return TESTS[name].robot or (model_file.load(model) if model else Model())


def check(test: str) -> None:
    """Check that a test exists and can be flown here.

    Raises:
        ValueError: The name is unknown, or a package is missing.
        ModelFileError: The test's model is missing or invalid.
    """
    name, _, model = test.partition("@")
    if name not in TESTS:
        hint = did_you_mean(name, TESTS)
        raise ValueError(
            f"no test '{name}'; {hint}there is {', '.join(TESTS)}; those on the simulator also as TEST@MODEL"
        )
    is_independent = TESTS[name].robot is not None
    if model and is_independent:
        raise ValueError(f"{test}: the independent robot takes no model; omit @{model}")
    if is_independent and importlib.util.find_spec("mujoco") is None:
        raise ValueError(f"{test} needs the package 'mujoco': pip install 'softarm[mujoco]', or choose tests by --test")
    robot(test)


def label(test: str) -> str:
    """Return the column title of a test on another model."""
    name, _, model = test.partition("@")
    return f"{COLUMNS.get(name, COLUMNS['all'])}, on {model}"
