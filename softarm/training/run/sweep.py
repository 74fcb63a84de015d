"""Sweeps: many runs from one file, seeds x configurations, as a batch of jobs.

A run's folder is OUT/NAME/seed-K. Started again, a sweep skips finished runs (result.json) and resumes killed ones from
their checkpoints.
"""

import json
import re
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from statistics import mean, stdev
from typing import Annotated, Any, NamedTuple

import numba
from pydantic import Field, ValidationError

from softarm.common import batch, files, yaml_lines
from softarm.common.batch import Kept, Work, Workers
from softarm.common.processes import cores
from softarm.common.yaml_lines import FileError
from softarm.common.yaml_schema import fit
from softarm.schemas.base import Strict
from softarm.simulator import model_file
from softarm.training.learn.inference import workers
from softarm.training.record.checkpoint import SEED_MAX
from softarm.training.run import recipe as recipes
from softarm.training.run import report
from softarm.training.run.recipe import RECIPES, Recipe

RESULT = "result.json"
# Options of `softarm train` that a sweep uses.
ALLOWED = ("--sweep", "--out", "--workers", "--ray")
# Options for a single run, with the equivalent in a sweep's file.
SINGLE = {
    "TASK": "task: reach",
    "--seed": "seeds: [1]",
    "--frames": "frames: 3000000",
    "--minutes": "frames: 3000000",
    "--robots": "settings: {run.robots: 1024}",
    "--device": "settings: {run.device: cuda}",
    "--model": "model: no-delay",
    "--resume": "not needed: a sweep resumes by itself",
}
NAME = re.compile(r"[A-Za-z0-9][\w.+-]*")  # of a run and its folder
EXAMPLE = "{seeds: [1, 2], base: {task: reach, frames: 3000000}, runs: {full: {}, no-delay: {model: no-delay}}}"


class SweepError(Exception):
    """Invalid or failed sweep; the text names the problem and the remedy."""


class Sweep(Strict):
    """File of a sweep: `base` holds the common settings, and each run changes or extends them.

    A run with `like: NAME` starts from the recipe of that shipped policy.
    """

    seeds: tuple[Annotated[int, Field(ge=0, le=SEED_MAX)], ...] = Field(min_length=1)
    base: dict[str, Any] = Field(default_factory=dict)
    runs: dict[str, dict[str, Any] | None] = Field(min_length=1)

    def recipe(self, name: str) -> Recipe:
        """Return the recipe of a run; its settings and randomise extend those of the base. Raises ValueError."""
        if not NAME.fullmatch(name):
            raise ValueError(f"the name is {name!r}; allowed are letters, digits and _.+-, a letter or digit first")
        lines = _merged(self.base, self.runs[name] or {})
        if (like := lines.pop("like", None)) is not None:
            if like not in tuple(RECIPES):  # `like` may be unhashable
                raise ValueError(f"like is {like!r}; give one of {', '.join(RECIPES)}")
            lines = _merged(RECIPES[like].model_dump(exclude_defaults=True), lines)
        return Recipe.model_validate(lines)


def refuse_beside(options: Iterable[str]) -> None:
    """Check that no option of a single run is given with a sweep's file. Raises SweepError."""
    wrong = [f"{each} ({SINGLE[each]})" if each in SINGLE else each for each in options if each not in ALLOWED]
    if wrong:
        raise SweepError(
            f"{', '.join(wrong)}: not allowed with --sweep; leave it out, and write to the sweep's file what stands in "
            "brackets"
        )


class Run(NamedTuple):
    """One run of a sweep."""

    seed: int
    name: str
    recipe: Recipe
    folder: Path

    @property
    def content(self) -> dict[str, Any]:
        """The recipe as plain values."""
        return self.recipe.model_dump(mode="json")


class Result(NamedTuple):
    """Result of a run; `test` holds shares of the task's test trials on the run's model."""

    name: str
    seed: int
    recipe: dict[str, Any]
    frames: int
    seconds: float
    validation: float
    test: dict[str, float]
    policy: str  # file name in the run's folder


def load(path: Path) -> Sweep:
    """Read a sweep's file and check every run in it. Raises SweepError with all that is wrong."""
    try:
        sweep = fit(yaml_lines.read(path, f"write one, e.g. {EXAMPLE}"), Sweep)
    except FileError as error:
        raise SweepError(f"{error}\nwrite e.g. {EXAMPLE}") from None
    wrong: dict[str, list[str]] = {}  # problem -> its runs
    for name in sweep.runs:
        try:
            recipe = sweep.recipe(name)
            recipes.prepare(recipe, sweep.seeds[0])
            model_file.load(recipe.model)
        except ValidationError as error:
            text = "; ".join(f"{'.'.join(map(str, e['loc']))}: {e['msg']}" for e in error.errors())
            wrong.setdefault(text, []).append(name)
        except (ValueError, model_file.ModelFileError) as error:
            wrong.setdefault(str(error), []).append(name)
    if wrong:
        problems = "\n".join(f"runs.{', '.join(names)}: {text}" for text, names in wrong.items())
        raise SweepError(f"{path}: {problems}\nwrite e.g. {EXAMPLE}")
    return sweep


def plan(sweep: Sweep, out: Path) -> dict[str, Run]:
    """Return all runs by their names in messages, seed by seed."""
    made = {name: sweep.recipe(name) for name in sweep.runs}.items()
    runs = [Run(seed, name, recipe, out / name / f"seed-{seed}") for seed in sweep.seeds for name, recipe in made]
    return {f"{run.name}, seed {run.seed}": run for run in runs}


def kept(runs: Mapping[str, Run]) -> Kept:
    """Return the store of the results. Raises SweepError where a folder holds a finished run of another recipe."""
    store = Kept(lambda key: runs[key].folder / RESULT, lambda key: {"recipe": runs[key].content})
    for key in runs:
        if store.file(key).exists() and store.read(key) is None:
            raise SweepError(
                f"{store.file(key)}: is damaged, or of a run with another recipe; remove the folder or give another "
                "--out"
            )
    return store


def run_all(
    runs: Mapping[str, Run], workers: Workers, on_result: Callable[[Result], None] = lambda result: None
) -> list[Result]:
    """Train the runs that have not finished and return all results. Raises JobsFailed when a run fails."""
    threads = max(1, cores() // workers.processes)
    work = Work(
        partial(train, threads=threads),
        reads=lambda run: [Path(run.recipe.model), run.folder],
        writes=lambda run: [run.folder],
        threads=threads,
        cards=lambda run: int(run.recipe.settings.get("run.device") == "cuda"),
    )
    done = batch.run(
        "training", work, runs, workers, kept=kept(runs), on_result=lambda key, result: on_result(Result(**result))
    )
    complete = done.complete("repair them and start the sweep again: finished runs stay")
    return [Result(**result) for result in complete.values()]


def train(run: Run, threads: int) -> dict[str, Any]:
    """Train one run to its end, from its checkpoint if there is one, and return its `Result` as plain values."""
    numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))
    with workers(threads) as pool:
        session = recipes.begin(run.recipe, run.seed, run.folder, pool, (run.folder / "latest.pt").exists())
        policy = session.run(run.recipe.frames, None)
        tested = report.fly_test_trials(session)
        report.write(session, tested)
    assert session.best is not None, "a run ends with a validation"
    test = tested.report._asdict()
    result = Result(run.name, run.seed, run.content, session.frames, session.seconds, session.best, test, policy.name)
    return result._asdict()


def markdown(results: Iterable[Result]) -> str:
    """Return a row per configuration: shares in percent, mean +- standard deviation over seeds (0 for one seed)."""
    groups: dict[str, list[Result]] = {}
    for result in results:
        groups.setdefault(result.name, []).append(result)
    names = list(dict.fromkeys(("validation", *(name for group in groups.values() for name in group[0].test))))
    rows = [["configuration", "seeds", "seconds", *names], ["---"] * (3 + len(names))]
    for configuration, group in groups.items():
        figures = [{"validation": each.validation} | each.test for each in group]
        cells = [_spread([row[name] for row in figures]) if name in figures[0] else "" for name in names]
        rows.append([configuration, str(len(group)), f"{mean(each.seconds for each in group):.0f}", *cells])
    return "\n".join(f"| {' | '.join(row)} |" for row in rows) + "\n"


def _spread(shares: list[float]) -> str:
    deviation = stdev(shares) if len(shares) > 1 else 0.0
    return f"{100 * mean(shares):.1f} +- {100 * deviation:.1f} %"


def save(sweep: Sweep, results: Iterable[Result], out: Path) -> str:
    """Write all results in the order of the sweep's file to OUT/results.json and results.md; return the latter."""
    names = list(sweep.runs)
    ordered = sorted(results, key=lambda each: (names.index(each.name), each.seed))
    text = markdown(ordered)
    files.write_text(out / "results.json", json.dumps([each._asdict() for each in ordered], indent=1) + "\n")
    files.write_text(out / "results.md", text)
    return text


def _merged(common: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    tables: dict[str, Any] = {"settings": {}, "randomise": {}}
    for key, table in tables.items():
        for lines in (common, own):
            if not isinstance(given := lines.get(key, {}), dict):
                raise ValueError(f"{key} is {given!r}; give a group of keys")
            table |= given
    return common | own | tables
