"""Sweeps: many runs from one file, seeds x configurations, in local processes or on a Ray cluster.

A run's folder is OUT/NAME/seed-K. Started again, a sweep skips finished runs (result.json) and resumes killed ones from
their checkpoints.
"""

import json
import logging
import os
import threading
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from statistics import mean, stdev
from typing import Any, NamedTuple

import numba
from pydantic import Field, ValidationError

from softarm.common import files, yaml_lines
from softarm.common.processes import WorkerDied, as_they_come
from softarm.common.yaml_lines import FileError
from softarm.common.yaml_schema import fit
from softarm.schemas.base import Strict
from softarm.simulator import model_file
from softarm.training.learn.inference import workers
from softarm.training.run import recipe as recipes
from softarm.training.run import report
from softarm.training.run.recipe import RECIPES, Recipe

RESULT = "result.json"
LOCAL = "local"
# Options of `softarm train` for a single run, with the equivalent in a sweep's file.
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
EXAMPLE = "{seeds: [1, 2], base: {task: reach, frames: 3000000}, runs: {full: {}, no-delay: {model: no-delay}}}"


class SweepError(Exception):
    """Invalid or failed sweep; the text names the problem and the remedy."""


class Sweep(Strict):
    """File of a sweep: `base` holds the common settings, and each run changes or extends them.

    A run with `like: NAME` starts from the recipe of that shipped policy.
    """

    seeds: tuple[int, ...] = Field(min_length=1)
    base: dict[str, Any] = Field(default_factory=dict)
    runs: dict[str, dict[str, Any] | None] = Field(min_length=1)

    def recipes(self) -> dict[str, Recipe]:
        """Return the recipes by name; settings and randomise extend those of the base. Raises ValueError."""
        made = {}
        for name, own in self.runs.items():
            lines = _merged(self.base, own or {})
            if (like := lines.pop("like", None)) is not None:
                if like not in tuple(RECIPES):  # `like` may be unhashable
                    raise ValueError(f"runs.{name}.like is {like!r}; give one of {', '.join(RECIPES)}")
                lines = _merged(RECIPES[like].model_dump(exclude_defaults=True), lines)
            made[name] = Recipe.model_validate(lines)
        return made


def refuse_beside(options: Iterable[str]) -> None:
    """Check that no option of a single run is given with a sweep's file. Raises SweepError."""
    if wrong := [f"{option} ({SINGLE[option]})" for option in options if option in SINGLE]:
        raise SweepError(f"{', '.join(wrong)}: not allowed with --sweep; write it to the sweep's file as in brackets")


class Work(NamedTuple):
    """Description of one run for a worker."""

    name: str
    seed: int
    recipe: dict[str, Any]
    folder: str
    threads: int


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
        made = sweep.recipes()
    except FileError as error:
        raise SweepError(f"{error}\nwrite e.g. {EXAMPLE}") from None
    except ValidationError as error:
        problems = (f"{'.'.join(map(str, e['loc'])) or 'the file'}: {e['msg']}" for e in error.errors())
        raise SweepError(f"{path}: {'; '.join(problems)}; write e.g. {EXAMPLE}") from None
    except ValueError as error:
        raise SweepError(f"{path}: {error}") from None
    for name, each in made.items():
        try:
            recipes.prepare(each, sweep.seeds[0])
            model_file.load(each.model)
        except (ValueError, model_file.ModelFileError) as error:
            raise SweepError(f"{path}: runs.{name}: {error}") from None
    return sweep


def plan(sweep: Sweep, out: Path, threads: int) -> tuple[list[Work], list[Result]]:
    """Return the remaining runs, seed by seed, and the finished results.

    Raises SweepError where a folder holds a finished run of another recipe.
    """
    todo, finished = [], []
    for seed in sweep.seeds:
        for name, recipe in sweep.recipes().items():
            folder, content = out / name / f"seed-{seed}", recipe.model_dump(mode="json")
            done = _finished(folder)
            if done is None:
                todo.append(Work(name, seed, content, str(folder.absolute()), threads))
            elif done.recipe != content:
                raise SweepError(f"{folder}: was run with another recipe; remove it or give another --out")
            else:
                finished.append(done)
    return todo, finished


def train(work: Work) -> Result:
    """Train one run to its end, from its checkpoint if there is one."""
    recipe, folder = Recipe.model_validate(work.recipe), Path(work.folder)
    numba.set_num_threads(min(work.threads, numba.config.NUMBA_NUM_THREADS))
    with workers(work.threads) as pool:
        session = recipes.begin(recipe, work.seed, folder, pool, (folder / "latest.pt").exists())
        policy = session.run(recipe.frames, None)
        tested = report.fly_test_trials(session)
        report.write(session, tested)
    assert session.best is not None, "a run ends with a validation"
    test = tested.report._asdict()
    result = Result(work.name, work.seed, work.recipe, session.frames, session.seconds, session.best, test, policy.name)
    files.write_text(folder / RESULT, json.dumps(result._asdict(), indent=1) + "\n")
    return result


def locally(todo: list[Work], processes: int) -> Iterator[Result]:
    """Train runs in parallel processes (1: in this one) and yield results as they finish.

    Raises SweepError when one fails or is killed.
    """
    threads = max((work.threads for work in todo), default=1)
    try:
        for _, result in as_they_come(_trained, todo, processes, threads):
            yield result
    except WorkerDied:
        raise SweepError("a worker was killed; start the sweep again: it resumes") from None


def _trained(work: Work) -> Result:
    """Train a run; an error names the run."""
    try:
        return train(work)
    except Exception as error:
        raise _failed(work, error) from error


def _trained_on_ray(work: Work) -> Result:
    """Train a run in a Ray worker, which ends with the sweep's process."""
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    return train(work)


def _end_with(parent: int) -> None:
    """End the worker with its parent, so that no run writes to the files of the next sweep."""
    while os.getppid() == parent:
        time.sleep(0.2)
    os._exit(1)


def on_ray(todo: list[Work], address: str) -> Iterator[Result]:
    """Train runs on a Ray cluster with a shared file system (`local` starts one here) and yield results.

    Raises SweepError when a run fails. Needs the extra `ray`.
    """
    try:
        import ray
    except ModuleNotFoundError:
        raise SweepError("a cluster needs the package 'ray': pip install 'softarm[ray]'") from None
    own: dict[str, Any] = {"num_cpus": len(os.sched_getaffinity(0)), "include_dashboard": False}
    try:
        ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR, **(own if address == LOCAL else {}))
    except Exception as error:
        text = str(error).partition("\n")[0]
        raise SweepError(f"no Ray cluster at '{address}': {text}; give its address, or 'local' for one here") from error
    try:
        remote = ray.remote(max_retries=0)(_trained_on_ray)
        waiting = {}
        for work in todo:
            # Ray hides graphics cards that were not requested.
            cards = int(work.recipe["settings"].get("run.device") == "cuda")
            waiting[remote.options(num_cpus=work.threads, num_gpus=cards).remote(work)] = work
        while waiting:
            (ready, *_), _ = ray.wait(list(waiting), num_returns=1)
            work = waiting.pop(ready)
            try:
                yield ray.get(ready)
            except Exception as error:
                # `cause` is the run's exception; Ray's text holds the worker's whole traceback.
                raise _failed(work, getattr(error, "cause", None) or error) from error
    finally:
        ray.shutdown()


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


def _finished(folder: Path) -> Result | None:
    try:
        return Result(**json.loads((folder / RESULT).read_text()))
    except FileNotFoundError:
        return None
    except (TypeError, ValueError) as error:
        raise SweepError(f"{folder / RESULT}: cannot be read ({error}); remove it to train that run again") from None


def _failed(work: Work, error: Exception) -> SweepError:
    first, _, _ = str(error).strip().partition("\n")
    return SweepError(
        f"{work.name}, seed {work.seed}: {type(error).__name__}: {first}; "
        "repair it and start the sweep again: finished runs stay"
    )
