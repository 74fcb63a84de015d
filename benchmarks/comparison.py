"""All policies at all tests: what `softarm evaluate --all` measures.

Every flight is the daemon's own tick in lockstep. A test is a function from a policy and a model to one truth a trial;
trials are the same for every policy. `TEST@MODEL` is a test on another simulator, a shipped model or a file.
"""

import multiprocessing
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from statistics import mean, stdev
from typing import NamedTuple, TypedDict

import numpy as np

from benchmarks import trials
from benchmarks.held_back import CHANGED
from daemon.evaluation import CART_STARTS_M
from policies import registry
from policies.base import Policy, PolicyError
from reality.parameters import Parameters
from schemas.config import Policy as ConfiguredPolicy
from schemas.goals import TEST_TARGETS, TRAINED_Z_MAX_M
from schemas.model import Model
from simulator import model_file

# The paper's own figures, on its hardware (section 4, Table 1, SM-H, SM-I); shares.
HARDWARE: dict[str, dict[str, float]] = {
    "the paper's learned policy": {"in_range": 0.94, "above": 0.50, "all": 0.80, "shelf": 0.92},
    "the paper's trajectory optimisation": {"in_range": 0.94, "above": 0.83, "all": 0.91},
    "the paper's PID": {"all": 0.17},
}
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
    "held_back_shelf": "held-back, shelf",
}


class Entry(NamedTuple):
    """One policy file or plugin; learned ones come once a seed."""

    name: str
    seed: int | None
    model: str | None  # of an ONNX file; None: the registry knows the name


class Figure(TypedDict):
    """A share over seeds; the spread is the standard deviation, None of a single value."""

    mean: float
    spread: float | None
    values: list[float]


class Comparison(TypedDict):
    """What `softarm evaluate --all --json` writes: policy -> column -> figure, beside the paper's shares."""

    columns: dict[str, str]
    seeds: dict[str, list[int]]
    policies: dict[str, dict[str, Figure]]
    hardware: dict[str, dict[str, float]]
    reached: dict[str, list[float]]  # of each of the 54 targets, the share over starts and seeds


TESTS: dict[str, Callable[[Policy, Model | None], list[bool]]] = {
    "grid": trials.fly_grid,
    "swinging": trials.fly_swinging,
    "shelf": lambda policy, model: trials.fly_shelf(policy, model, trials.shelf_trials()),
    "shelf_random": lambda policy, model: trials.fly_shelf(policy, model, trials.random_shelf_trials()),
    # The independent robot is what it is: it takes no model of ours.
    "held_back": lambda policy, _: trials.fly_held_back(policy, Parameters()),
    "held_back_payload": lambda policy, _: trials.fly_held_back(policy, CHANGED["payload"]),
    "held_back_slow": lambda policy, _: trials.fly_held_back(policy, CHANGED["slow"]),
    "held_back_late": lambda policy, _: trials.fly_held_back(policy, CHANGED["late"]),
    "held_back_changed": lambda policy, _: trials.fly_held_back(policy, CHANGED["changed"]),
    "held_back_shelf": lambda policy, _: trials.fly_held_back_shelf(policy),
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
    """Raises ValueError for a test that there is not, ModelFileError for its model."""
    name, _, model = test.partition("@")
    if name not in TESTS:
        raise ValueError(
            f"no test '{name}'; there is {', '.join(TESTS)}, each also as TEST@MODEL but the held-back ones"
        )
    if model and name.startswith("held_back"):
        raise ValueError(f"{test}: the held-back robot takes no model; leave @{model} out")
    if model:
        model_file.load(model)


def entries(runs: Path | None, names: tuple[str, ...] = (), only_runs: bool = False) -> list[Entry]:
    """Every usable policy that takes targets; of those with runs (FOLDER/NAME/seed-K) one entry a seed.

    names: only these. Raises PolicyError for a name or a folder without policies.
    """
    trained: dict[str, list[Entry]] = {}
    for file in sorted(runs.glob("*/seed-*/*.onnx")) if runs else ():
        name, seed = file.parts[-3], file.parts[-2].removeprefix("seed-")
        trained.setdefault(name, []).append(Entry(name, int(seed), str(file)))
    if runs and not trained:
        raise PolicyError(f"{runs}: no NAME/seed-K/*.onnx in it; `softarm train --sweep` writes them")
    known = registry.available()
    usable = [name for name, each in known.items() if each.spec is not None and each.spec.needs_target]
    shipped = {name: [Entry(name, None, None)] for name in usable if name not in ("hold", "onnx")}
    both = trained if only_runs else shipped | trained
    if unknown := set(names) - both.keys():
        raise PolicyError(f"no policy {', '.join(sorted(unknown))}; there is {', '.join(both)}")
    return [entry for name, group in both.items() if not names or name in names for entry in group]


def measure(entry: Entry, test: str) -> list[bool]:
    """Fly one test; in a worker."""
    configured = {} if entry.model is None else {entry.name: _onnx(entry.model)}
    name, _, model = test.partition("@")
    return TESTS[name](registry.load(entry.name, configured), model_file.load(model) if model else None)


def compare(
    found: list[Entry],
    processes: int,
    tests: tuple[str, ...] = tuple(TESTS),
    advance: Callable[[], None] = lambda: None,
) -> Comparison:
    """Fly all in so many processes (1: this one); `advance` is called after each policy's each test."""
    jobs = [(entry, test) for entry in found for test in tests]
    flown: dict[tuple[Entry, str], list[bool]] = {}
    if processes == 1:
        for job in jobs:
            flown[job] = measure(*job)
            advance()
        return summary(found, flown)
    with ProcessPoolExecutor(processes, multiprocessing.get_context("spawn")) as pool:
        futures = {pool.submit(measure, *job): job for job in jobs}
        for future in as_completed(futures):
            flown[futures[future]] = future.result()
            advance()
    return summary(found, flown)


def summary(found: list[Entry], flown: dict[tuple[Entry, str], list[bool]]) -> Comparison:
    """Shares by policy and column, with the spread over seeds."""
    tests = dict.fromkeys(test for _, test in flown)
    others = [test for test in tests if test not in COLUMNS and test != "grid"]
    low = [goal.z_m <= TRAINED_Z_MAX_M for goal in TEST_TARGETS for _ in CART_STARTS_M]
    values: dict[str, dict[str, list[float]]] = {}
    per_target: dict[str, list[list[float]]] = {}
    for (entry, test), reached in sorted(flown.items(), key=lambda item: (found.index(item[0][0]), item[0][1])):
        columns = values.setdefault(entry.name, {})
        if test != "grid":  # on another model it is one share
            columns.setdefault(test, []).append(mean(reached))
            continue
        parts = {
            "in_range": [hit for hit, inside in zip(reached, low, strict=True) if inside],
            "above": [hit for hit, inside in zip(reached, low, strict=True) if not inside],
            "all": reached,
        }
        for column, part in parts.items():
            columns.setdefault(column, []).append(mean(part))
        grid = np.array(reached, dtype=float).reshape(len(TEST_TARGETS), -1).mean(axis=1)
        per_target.setdefault(entry.name, []).append(grid.tolist())
    seeds: dict[str, list[int]] = {}
    for entry in found:
        seeds.setdefault(entry.name, []).extend([] if entry.seed is None else [entry.seed])
    return Comparison(
        columns=COLUMNS | {test: _label(test) for test in others},
        seeds=seeds,
        policies={name: {c: _figure(v) for c, v in columns.items()} for name, columns in values.items()},
        hardware=HARDWARE,
        reached={name: np.mean(rows, axis=0).tolist() for name, rows in per_target.items()},
    )


def _label(test: str) -> str:
    name, _, model = test.partition("@")
    return f"{COLUMNS.get(name, COLUMNS['all'])}, on {model}"


def _figure(values: list[float]) -> Figure:
    return Figure(mean=mean(values), spread=stdev(values) if len(values) > 1 else None, values=values)


def _onnx(model: str) -> ConfiguredPolicy:
    return ConfiguredPolicy(plugin="onnx", options={"model": model})
