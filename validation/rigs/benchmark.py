"""Benchmark of the diagnosis on simulated rigs with known causes: make, answer and score cases.

    python -m validation.rigs.benchmark make FOLDER --cases 60 --seed 1 --kind tracking --kind pendulum
    python -m validation.rigs.benchmark run FOLDER
    python -m validation.rigs.benchmark score FOLDER
    python -m validation.rigs.benchmark one FOLDER servo dead_time --strength 0.5

FOLDER/data contains the inputs of the diagnosis, FOLDER/truths the causes and FOLDER/answers the verdicts. Rigs, laws
and faults are those of this package; `score.py` defines the outcomes.
"""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, get_args

import click

from softarm.cli.shared.errors import failing
from softarm.common import batch
from softarm.common.batch import JobsFailed, Kept, Work, Workers, workers_options
from softarm.common.cluster import ClusterError
from softarm.common.files import sha256_of
from softarm.diagnosis.data.trials import TrialError
from validation.blind import seal
from validation.rigs.case import CATEGORIES, SWINGS, Category, case_of, draw
from validation.rigs.excitation import SHAPES
from validation.rigs.faults import FAULTS
from validation.rigs.presets import RIGS, Kind
from validation.rigs.record import write
from validation.rigs.score import counts, score, table, wrong_lines


def make(cases: Sequence[Any], folder: Path, write: Callable[..., Any], workers: Workers | None = None) -> None:
    """Record the cases that are not complete yet.

    Args:
        cases: Cases with a `name`, and with the drawn part of their `truth` as JSON types.
        folder: Receives data/ and truths/.
        write: Function of a case, the folder `data` and the folder `truths`; it writes the truth last.
        workers: Place that the jobs run at.

    Raises TrialError if the folder contains other cases of the same names.
    """
    data, truths = folder / "data", folder / "truths"
    todo = {case.name: case for case in cases if not _is_recorded(case.truth, truths / f"{case.name}.json")}
    work: Work[Any, Any] = Work(
        partial(write, data=data, truths=truths), writes=lambda case: [data / case.name, truths / f"{case.name}.json"]
    )
    batch.run("recording", work, todo, workers).complete()


def _is_recorded(truth: Mapping[str, Any], file: Path) -> bool:
    if not file.is_file():
        return False
    if any(value != _json(file).get(key) for key, value in truth.items()):
        raise TrialError(f"{file}: belongs to other cases (--cases, --kind, --category); name a new folder")
    return True


def run(folder: Path, workers: Workers | None = None) -> None:
    """Answer every case and write the answers to FOLDER/answers.

    Answers of the same tool to the same data are kept. Raises TrialError if the folder contains no case.
    """
    cases = {path.parent.name: path.parent for path in sorted((folder / "data").glob("*/stage.yaml"))}
    if not cases:
        raise TrialError(f"{folder}: contains no case; use `make` first")
    kept = Kept(
        lambda name: folder / "answers" / f"{name}.json",
        lambda name: {"tool": seal.tool_version(), "data": sha256_of(cases[name])},
    )
    batch.run("diagnosing", Work(answer, reads=lambda case: [case]), cases, workers, kept=kept).complete()


def answer(case: Path) -> dict[str, Any]:
    """Return the verdict on a case and its processor time, s; an exception is recorded as a failure."""
    from softarm.diagnosis.diagnose import diagnose_files

    began, verdict, failure = time.process_time(), None, ""
    margins: dict[str, float] = {}
    try:
        found = diagnose_files([case / "stage.yaml"], processes=1)
        verdict, margins = found.verdict.model_dump(mode="json"), dict(found.margins)
    except Exception as error:  # a failure is scored, and the other cases continue
        failure = f"{type(error).__name__}: {error}"
    return {"verdict": verdict, "margins": margins, "failure": failure, "seconds": time.process_time() - began}


def answered(folder: Path) -> list[tuple[Any, Any]]:
    """Return the truth and the answer of each case of a folder. Raises TrialError unless all are answered."""
    files = [(file, folder / "answers" / file.name) for file in sorted((folder / "truths").glob("*.json"))]
    if not files or not all(reply.is_file() for _, reply in files):
        raise TrialError(f"{folder}: contains no case, or one without an answer; use `run` first")
    return [(_json(file), _json(reply)) for file, reply in files]


def _json(file: Path) -> Any:
    return json.loads(file.read_text(encoding="utf-8"))


FOLDER = click.argument("folder", type=click.Path(path_type=Path, file_okay=False))
CASES = click.option("--cases", "count", default=60, show_default=True, type=click.IntRange(1), help="Number to draw.")
SEED = click.option("--seed", default=0, show_default=True, type=click.IntRange(0), help="Seed of the draw.")
REFUSALS = TrialError, JobsFailed, ClusterError


@click.group()
def main() -> None:
    """Measure the diagnosis on simulated rigs with known causes."""


@main.command("make")
@FOLDER
@CASES
@SEED
@click.option("--kind", "kinds", multiple=True, type=click.Choice(get_args(Kind)), help="May be repeated.")
@click.option("--category", "categories", multiple=True, type=click.Choice(CATEGORIES), help="May be repeated.")
@workers_options()
@failing(*REFUSALS)
def make_command(
    folder: Path,
    count: int,
    seed: int,
    kinds: Sequence[Kind],
    categories: Sequence[Category],
    workers: Workers,
) -> None:
    """Draw cases of all or some kinds and categories, and record them."""
    make(draw(count, seed, kinds or get_args(Kind), categories or CATEGORIES), folder, write, workers)
    click.echo(f"{count} cases in {folder / 'data'}, their causes in {folder / 'truths'}")


@main.command()
@FOLDER
@click.argument("rig", type=click.Choice(tuple(RIGS)))
@click.argument("faults", metavar="[FAULT]...", nargs=-1)
@click.option("--strength", default=1.0, show_default=True, help="Share of the usual sizes.")
@SEED
@click.option("--excitation", "excitations", multiple=True, help="Excitation of a trial; may be repeated.")
def one(
    folder: Path, rig: str, faults: tuple[str, ...], strength: float, seed: int, excitations: tuple[str, ...]
) -> None:
    """Record a rig with chosen faults (validation/rigs/faults.py)."""
    plant = RIGS[rig].plant
    allowed = {*FAULTS[plant], *(SWINGS if plant == "pendulum" else SHAPES)}
    if unknown := {*faults, *excitations} - allowed:
        raise click.BadParameter(f"{rig} has no {', '.join(unknown)}; allowed are {', '.join(sorted(allowed))}")
    case = case_of(rig, faults, strength, seed, excitations)
    write(case, folder / "data", folder / "truths")
    click.echo(folder / "data" / case.name / "stage.yaml")


@main.command("run")
@FOLDER
@workers_options()
@failing(*REFUSALS)
def run_command(folder: Path, workers: Workers) -> None:
    """Diagnose every case; continues an interrupted run."""
    run(folder, workers)


@main.command("score")
@FOLDER
@failing(TrialError)
def score_command(folder: Path) -> None:
    """Print outcomes and wrong answers, and write FOLDER/score.json."""
    scored = [score(truth, reply) for truth, reply in answered(folder)]
    found = counts(scored)
    text = json.dumps({"shares": found, "cases": [asdict(each) for each in scored]}, indent=1)
    (folder / "score.json").write_text(text + "\n", encoding="utf-8")
    click.echo(f"{table(found)}\n\n{wrong_lines(scored)}")


if __name__ == "__main__":
    main()
