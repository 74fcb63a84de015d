"""The comparison of policies in tests: flown in parallel, summed up in one table.

The ceiling, an open-loop search that knows the simulator, is one of the rows.
"""

import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from statistics import mean, stdev
from typing import NamedTuple, TypedDict
from urllib.parse import quote

import numpy as np

from softarm.common.batch import Kept, Work, Workers, run
from softarm.common.files import sha256_of
from softarm.common.revision import code_version
from softarm.common.shares import Share, share
from softarm.evaluation.entries import CEILING, Entry, files_of
from softarm.evaluation.runner import Robot, fly, load
from softarm.evaluation.tests import COLUMNS, TESTS, flies_the_targets, robot, scenarios, title
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
PART = 27  # flights of one job
OUTSIDE = "none of these targets lies in the range that the policy was made for"
DEFAULT_LIMITS = "searched with the default limits, not with those of --config"


class Job(NamedTuple):
    """Some scenarios of one test, flown by one process."""

    entry: Entry
    test: str
    part: range


class Score(NamedTuple):
    """The result of a flight or of a search."""

    reached: bool
    refusal: str | None = None  # the policy's message if it had no answer; such a trial is not reached
    closest_m: float | None = None  # the tip's closest distance to the target; None if the tip was not seen


class Cell(NamedTuple):
    """The results of one policy and seed in one column of the table."""

    scores: list[Score]
    inside: bool  # at least one target lies in the range that the policy was made for


class Figure(TypedDict):
    """Share of trials reached; the spread is the standard deviation over seeds, None for a single seed."""

    mean: float
    spread: float | None
    values: list[float]
    counted: Share  # of the trials of all seeds
    refused: float  # share of trials for which the policy had no answer; they count as not reached


class Comparison(TypedDict):
    """The comparison as `softarm evaluate --json` writes it: policy -> column -> figure, and the paper's shares."""

    columns: dict[str, str]
    seeds: dict[str, list[int]]
    policies: dict[str, dict[str, Figure]]
    notes: dict[str, dict[str, list[str]]]  # policy -> column -> remarks on the figure
    hardware: dict[str, dict[str, float]]
    mapped: str  # title of the test of the next two: the first one that flies the 54 targets; empty if none does
    reached: dict[str, list[float]]  # policy -> share of starts and seeds for each of the 54 targets
    closest_m: dict[str, list[list[float | None]]]  # policy -> target -> closest distance of each start and seed


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
    flights = fly(policy, on, chosen, config)
    return [Score(flight.reached, flight.refusal, flight.status.closest_m) for flight in flights]


def compare(
    found: Sequence[Entry],
    workers: Workers | None = None,
    tests: Sequence[str] = tuple(TESTS),
    config: Config | None = None,
    keep: Path | None = None,
) -> Comparison:
    """Fly every row in every test; the place of the jobs does not change the figures.

    Args:
        found: Rows of the table.
        workers: Place that the jobs run at.
        tests: Columns of the table.
        config: Configuration; by default its default values.
        keep: Folder of finished jobs, from which a restart continues.

    Raises:
        JobsFailed: A policy could not be flown.
    """
    todo = {_key(job): job for job in jobs(found, tests)}
    work = Work(partial(_scores, config=config), reads=partial(_files, config=config))
    kept = None
    if keep is not None:
        kept = Kept(lambda key: keep / f"{quote(key, safe=' @')}.json", lambda key: _origin(todo[key], config))
    done = run("flying", work, todo, workers, kept=kept, cost=lambda job: len(job.part)).complete()
    result = summary({todo[key]: [Score(*score) for score in flown["scores"]] for key, flown in done.items()})
    if config is not None and config.limits != Config().limits and CEILING in result["policies"]:
        for column in result["policies"][CEILING]:
            result["notes"].setdefault(CEILING, {}).setdefault(column, []).append(DEFAULT_LIMITS)
    return result


def _scores(job: Job, config: Config | None) -> dict[str, list[Score]]:
    return {"scores": measure(job, config)}


def _key(job: Job) -> str:
    file = "" if job.entry.file in (None, Path(job.entry.name)) else f" ({job.entry.file})"
    return f"{job.entry.name}{file}, {job.test}, flights {job.part.start} to {job.part[-1]}"


def _files(job: Job, config: Config | None) -> list[Path]:
    """Return the files that a job reads: of its policy, of its model and of the configuration."""
    model = Path(job.test.partition("@")[2])
    return [*files_of(job.entry, config), *([model] if model.is_file() else [])]


def _origin(job: Job, config: Config | None) -> dict[str, object]:
    """Return whatever decides the result of a job."""
    named = repr(job._replace(entry=job.entry._replace(file=None)))
    files, settings = [sha256_of(path) for path in _files(job, config)], config and config.model_dump(mode="json")
    return {"code": code_version(), "job": named, "files": files, "config": settings}


def summary(flown: dict[Job, list[Score]]) -> Comparison:
    """Return the shares by policy and column, with the spread over seeds."""
    whole: dict[tuple[Entry, str], dict[int, Score]] = {}
    for job, part in flown.items():
        whole.setdefault((job.entry, job.test), {}).update(zip(job.part, part, strict=True))
    cells: dict[str, dict[str, list[Cell]]] = {}  # policy -> column -> seed
    mapped = next((test for _, test in whole if flies_the_targets(test)), None)
    per_target: dict[str, list[list[Score]]] = {}  # policy -> target -> start and seed
    seeds: dict[str, list[int]] = {}
    for (entry, test), numbered in whole.items():
        scores = [numbered[number] for number in range(len(numbered))]
        row = cells.setdefault(entry.name, {})
        for column, cell in _split(entry, test, scores).items():
            row.setdefault(column, []).append(cell)
        if test == mapped:
            starts, targets = len(CART_STARTS_M), per_target.setdefault(entry.name, [[] for _ in TEST_TARGETS])
            for number, target in enumerate(targets):
                target += scores[number * starts : (number + 1) * starts]
        known = seeds.setdefault(entry.name, [])
        known += [entry.seed] if entry.seed is not None and entry.seed not in known else []
    others = {test: title(test) for _, test in whole if test not in COLUMNS and test != "grid"}
    return Comparison(
        columns=COLUMNS | others,
        seeds=seeds,
        policies={name: {column: _figure(group) for column, group in row.items()} for name, row in cells.items()},
        notes={name: {c: notes for c, group in row.items() if (notes := _notes(group))} for name, row in cells.items()},
        hardware=HARDWARE,
        mapped=title(mapped) if mapped else "",
        reached={name: [mean(each.reached for each in of) for of in rows] for name, rows in per_target.items()},
        closest_m={name: [[each.closest_m for each in of] for of in rows] for name, rows in per_target.items()},
    )


def _search(wanted: Sequence[Scenario], on: Robot) -> list[Score]:
    """Search open-loop commands for scenarios with the same start."""
    from softarm.training.trajectory.ceiling import search

    assert isinstance(on, Model), "the grid is flown on the simulator"
    targets_m = np.array([(each.goal.y_m, each.goal.z_m) for each in wanted], dtype=np.float32)
    found = search(targets_m, wanted[0].cart_start_m, on)
    results = zip(found.reached_s.tolist(), found.closest_m.tolist(), strict=True)
    return [Score(math.isfinite(reached_s), closest_m=closest_m) for reached_s, closest_m in results]


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
    counted = share(score.reached for seed in seeds for score in seed.scores)
    spread = stdev(values) if len(values) > 1 else None
    return Figure(mean=mean(values), spread=spread, values=values, counted=counted, refused=refused)


def _notes(seeds: list[Cell]) -> list[str]:
    """State targets outside the policy's range and refused trials, with the first refusal."""
    scores = [score for seed in seeds for score in seed.scores]
    words = [score.refusal for score in scores if score.refusal is not None]
    notes = [] if len(words) == len(scores) or any(seed.inside for seed in seeds) else [OUTSIDE]
    if words:
        first, _, _ = words[0].partition(":")
        notes.append(f"refused {len(words)} of {len(scores)} trials, which count as not reached; the first: {first}")
    return notes
