"""The comparison of policies in tests: flown in parallel, summed up in one table.

The ceiling, an open-loop search that knows the simulator, is one of the rows.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from statistics import mean, stdev
from typing import NamedTuple, TypedDict

import numpy as np

from softarm.common.processes import as_they_come
from softarm.common.words import did_you_mean
from softarm.evaluation.runner import Robot, fly, load
from softarm.evaluation.tests import COLUMNS, TESTS, label, robot, scenarios
from softarm.policies import registry
from softarm.policies.base import PolicyError
from softarm.policies.onnx_policy import OnnxPolicy
from softarm.schemas.config import Config
from softarm.schemas.flights import CART_STARTS_M, TEST_TARGETS, Scenario, heights, in_range
from softarm.schemas.goals import Goal
from softarm.schemas.model import Model
from softarm.schemas.policy import TrainingRange

# Shares that the paper measured on its hardware (section 4, Table 1, SM-H, SM-I).
HARDWARE: dict[str, dict[str, float]] = {
    "the paper's learned policy": {"in_range": 0.94, "above": 0.50, "all": 0.80, "shelf": 0.92},
    "the paper's trajectory optimisation": {"in_range": 0.94, "above": 0.83, "all": 0.91},
    "the paper's PID": {"all": 0.17},
}
CEILING = "ceiling"
PART = 27  # flights of one job
OUTSIDE = "none of these targets lies in the range that the policy was made for"
DEFAULT_LIMITS = "searched with the default limits, not with those of --config"


class Entry(NamedTuple):
    """A policy file, a plug-in or the ceiling; one entry per training seed."""

    name: str
    seed: int | None = None  # None: not trained
    file: Path | None = None  # of an ONNX policy; None: the registry knows the name
    trained: TrainingRange | None = None


class Job(NamedTuple):
    """Some scenarios of one test, flown by one process."""

    entry: Entry
    test: str
    part: range


class Score(NamedTuple):
    """The result of a flight or of a search."""

    reached: bool
    refusal: str | None = None  # the policy's message if it had no answer; such a trial is not reached


class Cell(NamedTuple):
    """The results of one policy and seed in one column of the table."""

    scores: list[Score]
    inside: bool  # at least one target lies in the range that the policy was made for


class Figure(TypedDict):
    """Share of trials reached; the spread is the standard deviation over seeds, None for a single seed."""

    mean: float
    spread: float | None
    values: list[float]
    refused: float  # share of trials for which the policy had no answer; they count as not reached


class Comparison(TypedDict):
    """The comparison as `softarm evaluate --json` writes it: policy -> column -> figure, and the paper's shares."""

    columns: dict[str, str]
    seeds: dict[str, list[int]]
    policies: dict[str, dict[str, Figure]]
    notes: dict[str, dict[str, list[str]]]  # policy -> column -> remarks on the figure
    hardware: dict[str, dict[str, float]]
    reached: dict[str, list[float]]  # policy -> share of starts and seeds for each of the 54 targets


def entries(
    runs: Path | None = None,
    names: Sequence[str] = (),
    only_runs: bool = False,
    files: Sequence[Path] = (),
    config: Config | None = None,
) -> list[Entry]:
    """Return the rows of a comparison: usable policies that take targets, and the ceiling.

    Args:
        runs: Folder of a sweep. Its policies (NAME/seed-K) replace shipped ones of the same name, one entry per seed.
        names: Names of the wanted rows; without a name, every row is wanted.
        only_runs: Leave out everything but the sweep's policies.
        files: Further ONNX policies; the path is the row's name.

    Raises:
        PolicyError: A name is unknown, a file is invalid, or `runs` holds no policy.
    """
    trained = _of_sweep(runs) if runs else {}
    for file in files:
        metadata = OnnxPolicy(str(file)).metadata
        trained[str(file)] = [Entry(str(file), metadata.seed, file, OnnxPolicy.describe(str(file)).trained)]
    known = registry.available((config or Config()).policies)
    rows = trained if only_runs else _registered(known) | {CEILING: [Entry(CEILING)]} | trained
    if unknown := sorted(set(names) - rows.keys()):
        if unknown[0] in known and (error := known[unknown[0]].error):
            raise PolicyError(f"policy {unknown[0]}: {error}")
        hint = did_you_mean(unknown[0], rows)
        raise PolicyError(f"no policy {', '.join(unknown)}; {hint}there is {', '.join(rows)}")
    return [entry for name, group in rows.items() if not names or name in names for entry in group]


def _of_sweep(runs: Path) -> dict[str, list[Entry]]:
    trained: dict[str, list[Entry]] = {}
    for file in sorted(runs.glob("*/seed-*/*.onnx")):
        name, number = file.parts[-3], int(file.parts[-2].removeprefix("seed-"))
        trained.setdefault(name, []).append(Entry(name, number, file, OnnxPolicy.describe(str(file)).trained))
    if not trained:
        raise PolicyError(f"{runs}: no NAME/seed-K/*.onnx in it; `softarm train --sweep` writes them")
    return trained


def _registered(policies: Mapping[str, registry.PolicyEntry]) -> dict[str, list[Entry]]:
    rows = {}
    for name, known in policies.items():
        if known.spec is None or not known.spec.needs_target or name == "hold":
            continue
        seed = OnnxPolicy(str(known.options["model"])).metadata.seed if known.plugin == "onnx" else None
        rows[name] = [Entry(name, seed, trained=known.spec.trained)]
    return rows


def jobs(found: Sequence[Entry], tests: Sequence[str]) -> list[Job]:
    """Split the comparison into jobs; the ceiling is searched only for the 54 targets, start by start."""
    made = []
    for entry in found:
        for test in tests:
            count, step = len(scenarios(test)), len(CART_STARTS_M)
            if entry.name != CEILING:
                made += [Job(entry, test, range(first, min(first + PART, count))) for first in range(0, count, PART)]
            elif test.partition("@")[0] == "grid":
                made += [Job(entry, test, range(start, count, step)) for start in range(step)]
    return made


def measure(job: Job, config: Config | None = None) -> list[Score]:
    """Fly a job's scenarios with a configuration (default: its default values)."""
    entry, every, on = job.entry, scenarios(job.test), robot(job.test)
    chosen = [every[number] for number in job.part]
    if entry.name == CEILING:
        return _search(chosen, on)
    policy = load(entry.file or entry.name, config)
    return [Score(flight.reached, flight.refusal) for flight in fly(policy, on, chosen, config)]


def compare(
    found: Sequence[Entry],
    processes: int,
    tests: Sequence[str] = tuple(TESTS),
    advance: Callable[[int], None] = lambda trials: None,
    config: Config | None = None,
) -> Comparison:
    """Fly every row in every test; the number of processes does not change the figures.

    `advance` receives the number of trials that have just been flown.
    """
    todo = jobs(found, tests)
    flown: dict[Job, list[Score]] = {}
    for job, scores in as_they_come(partial(measure, config=config), todo, processes):
        flown[job] = scores
        advance(len(job.part))
    result = summary({job: flown[job] for job in todo})
    if config is not None and config.limits != Config().limits and CEILING in result["policies"]:
        for column in result["policies"][CEILING]:
            result["notes"].setdefault(CEILING, {}).setdefault(column, []).append(DEFAULT_LIMITS)
    return result


def summary(flown: dict[Job, list[Score]]) -> Comparison:
    """Return the shares by policy and column, with the spread over seeds."""
    whole: dict[tuple[Entry, str], dict[int, Score]] = {}
    for job, part in flown.items():
        whole.setdefault((job.entry, job.test), {}).update(zip(job.part, part, strict=True))
    cells: dict[str, dict[str, list[Cell]]] = {}  # policy -> column -> seed
    per_target: dict[str, list[list[float]]] = {}
    seeds: dict[str, list[int]] = {}
    for (entry, test), numbered in whole.items():
        scores = [numbered[number] for number in range(len(numbered))]
        row = cells.setdefault(entry.name, {})
        for column, cell in _split(entry, test, scores).items():
            row.setdefault(column, []).append(cell)
        if test == "grid":
            hits = np.array([score.reached for score in scores], dtype=float).reshape(len(TEST_TARGETS), -1)
            per_target.setdefault(entry.name, []).append(hits.mean(axis=1).tolist())
        known = seeds.setdefault(entry.name, [])
        known += [entry.seed] if entry.seed is not None and entry.seed not in known else []
    others = {test: label(test) for _, test in whole if test not in COLUMNS and test != "grid"}
    return Comparison(
        columns=COLUMNS | others,
        seeds=seeds,
        policies={name: {column: _figure(group) for column, group in row.items()} for name, row in cells.items()},
        notes={name: {c: notes for c, group in row.items() if (notes := _notes(group))} for name, row in cells.items()},
        hardware=HARDWARE,
        reached={name: np.mean(rows, axis=0).tolist() for name, rows in per_target.items()},
    )


def _search(wanted: Sequence[Scenario], on: Robot) -> list[Score]:
    """Search open-loop commands for scenarios with the same start."""
    from softarm.training.trajectory.ceiling import search

    assert isinstance(on, Model), "the grid is flown on the simulator"
    targets_m = np.array([(each.goal.y_m, each.goal.z_m) for each in wanted], dtype=np.float32)
    found = search(targets_m, wanted[0].cart_start_m, on)
    return [Score(bool(np.isfinite(reached_s))) for reached_s in found.reached_s]


def _split(entry: Entry, test: str, scores: list[Score]) -> dict[str, Cell]:
    """Split a test's scores into columns; the grid on another model is one column."""
    flown = scenarios(test)
    columns: dict[str, Sequence[int]] = {test: range(len(flown))}
    if test == "grid":
        low = in_range(heights(flown))
        inside, above = np.flatnonzero(low).tolist(), np.flatnonzero(~low).tolist()
        columns = {"in_range": inside, "above": above, "all": range(len(flown))}
    return {
        column: Cell([scores[k] for k in part], any(_inside(flown[k].goal, entry.trained) for k in part))
        for column, part in columns.items()
    }


def _inside(goal: Goal, made_for: TrainingRange | None) -> bool:
    if made_for is None:
        return True
    (y_low, y_high), (z_low, z_high) = made_for.target_y_m, made_for.target_z_m
    return y_low - 1e-6 <= goal.y_m <= y_high + 1e-6 and z_low - 1e-6 <= goal.z_m <= z_high + 1e-6


def _figure(seeds: list[Cell]) -> Figure:
    values = [mean(score.reached for score in seed.scores) for seed in seeds]
    refused = mean(score.refusal is not None for seed in seeds for score in seed.scores)
    return Figure(mean=mean(values), spread=stdev(values) if len(values) > 1 else None, values=values, refused=refused)


def _notes(seeds: list[Cell]) -> list[str]:
    """State targets outside the policy's range and refused trials, with the first refusal."""
    scores = [score for seed in seeds for score in seed.scores]
    words = [score.refusal for score in scores if score.refusal is not None]
    notes = [] if len(words) == len(scores) or any(seed.inside for seed in seeds) else [OUTSIDE]
    if words:
        first, _, _ = words[0].partition(":")
        notes.append(f"refused {len(words)} of {len(scores)} trials, which count as not reached; the first: {first}")
    return notes
