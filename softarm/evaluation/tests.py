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


class Test(NamedTuple):
    """Scenarios, the robot that flies them, and the title of the table's column."""

    title: str
    scenarios: Callable[[], list[Scenario]]
    robot: RobotParameters | None = None  # None: the simulator


TESTS = {
    "grid": Test("all 54", flights.grid),
    "swinging": Test("54 from mid-swing", flights.swinging),
    "shelf": Test("shelf, 12", flights.shelf),
    "shelf_random": Test("shelf, 500 random", flights.random_shelf),
    "held_back": Test("independent robot", flights.grid, ROBOTS["nominal"]),
    "held_back_payload": Test("independent, 50 g at the tip", flights.grid, ROBOTS["payload"]),
    "held_back_slow": Test("independent, slow regulator", flights.grid, ROBOTS["slow"]),
    "held_back_late": Test("independent, late rail", flights.grid, ROBOTS["late"]),
    "held_back_changed": Test("independent, all three", flights.grid, ROBOTS["changed"]),
    "held_back_later": Test("independent, rail 90 ms late", flights.grid, ROBOTS["later"]),
    "held_back_weak": Test("independent, drive at half its acceleration", flights.grid, ROBOTS["weak"]),
    "held_back_shelf": Test("independent, shelf", flights.shelf, ROBOTS["nominal"]),
}
# The grid on the seed's simulator has three columns, each other test has one.
COLUMNS = {"in_range": "z <= 0.70 m", "above": "z > 0.70 m", "all": TESTS["grid"].title} | {
    name: test.title for name, test in TESTS.items() if name != "grid"
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
    return test if test in TESTS and is_independent(test) else f"{test}@{model}"


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
    if model and is_independent(test):
        raise ValueError(f"{test}: the independent robot takes no model; omit @{model}")
    if is_independent(test) and importlib.util.find_spec("mujoco") is None:
        raise ValueError(f"{test} needs the package 'mujoco': pip install 'softarm[mujoco]', or choose tests by --test")
    robot(test)


def is_independent(test: str) -> bool:
    """Return whether a test flies the independent robot, which takes no model."""
    return TESTS[test.partition("@")[0]].robot is not None


def flies_the_targets(test: str) -> bool:
    """Return whether a test flies each of the 54 targets from three starts, target by target."""
    return [each.goal for each in scenarios(test)] == [each.goal for each in flights.grid()]


def title(test: str) -> str:
    """Return the column title of a test."""
    name, _, model = test.partition("@")
    return f"{TESTS[name].title}, on {model}" if model else TESTS[name].title
