"""Benchmark of the diagnosis on simulated rigs with known causes: make, answer and score cases.

    python -m validation.rigs.benchmark make FOLDER --cases 60 --seed 1 --kind tracking --kind pendulum
    python -m validation.rigs.benchmark run FOLDER
    python -m validation.rigs.benchmark score FOLDER
    python -m validation.rigs.benchmark one FOLDER servo dead_time --strength 0.5

FOLDER/data contains the inputs of the diagnosis, FOLDER/truths the causes and FOLDER/answers the verdicts. Rigs, laws
and faults are those of this package; `score.py` defines the outcomes.
"""

import argparse
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, get_args

from softarm.common import batch
from softarm.common.batch import JobsFailed, Kept, Work, Workers
from softarm.common.cluster import ClusterError
from softarm.common.files import sha256_of
from softarm.common.processes import cores
from softarm.diagnosis.data.trials import TrialError
from validation.blind import seal
from validation.rigs.case import CATEGORIES, RigCase, case_of, draw
from validation.rigs.presets import Kind
from validation.rigs.record import write
from validation.rigs.score import counts, score, table, wrong_lines


def make(cases: Sequence[RigCase], folder: Path, workers: Workers | None = None) -> None:
    """Record the cases that are not complete yet; the truth of a case is written last.

    Raises TrialError if the folder contains other cases of the same names.
    """
    data, truths = folder / "data", folder / "truths"
    done = recorded(truths, {case.name: case.truth for case in cases})
    todo = {case.name: case for case in cases if case.name not in done}
    work = Work(
        partial(write, data=data, truths=truths), writes=lambda case: [data / case.name, truths / f"{case.name}.json"]
    )
    batch.run("recording", work, todo, workers).complete()


def recorded(truths: Path, cases: Mapping[str, Mapping[str, Any]]) -> set[str]:
    """Return the names of the cases that a folder has the truth of.

    Raises:
        TrialError: The truth of a case of that name differs.
    """
    found = set()
    for name, truth in cases.items():
        file = truths / f"{name}.json"
        if not file.is_file():
            continue
        if any(value != _json(file).get(key) for key, value in truth.items()):
            raise TrialError(f"{file}: belongs to other cases (--cases, --kind, --category); name a new folder")
        found.add(name)
    return found


def run(folder: Path, workers: Workers | None = None) -> None:
    """Answer every case and write the answers to FOLDER/answers.

    Answers of the same tool to the same data are kept. Raises TrialError if the folder contains no case.
    """
    cases = {path.parent.name: path.parent for path in sorted((folder / "data").glob("*/stage.yaml"))}
    if not cases:
        raise TrialError(f"{folder}: contains no case; make some first (python -m {__spec__.name} make)")
    kept = Kept(
        lambda name: folder / "answers" / f"{name}.json",
        lambda name: {"tool": seal.tool_version(), "data": sha256_of(cases[name])},
    )
    batch.run("diagnosing", Work(answer, reads=lambda case: [case]), cases, workers, kept=kept).complete()


def answer(case: Path) -> dict[str, Any]:
    """Return the verdict on a case and its processor time, s; an exception is recorded as a failure."""
    from softarm.diagnosis.from_files import diagnose_files

    began, verdict, failure = time.process_time(), None, ""
    margins: dict[str, float] = {}
    try:
        found = diagnose_files([case / "stage.yaml"], processes=1)
        verdict, margins = found.verdict.model_dump(mode="json"), dict(found.margins)
    except Exception as error:  # a failure is scored, and the other cases continue
        failure = f"{type(error).__name__}: {error}"
    return {"verdict": verdict, "margins": margins, "failure": failure, "seconds": time.process_time() - began}


def answered(folder: Path) -> Iterator[tuple[Any, Any]]:
    """Yield the truth and the answer of each case of a folder; the answer is None if there is none yet."""
    for file in sorted((folder / "truths").glob("*.json")):
        reply = folder / "answers" / file.name
        yield _json(file), _json(reply) if reply.is_file() else None


def _json(file: Path) -> Any:
    return json.loads(file.read_text(encoding="utf-8"))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line (`python -m validation.rigs.benchmark --help`)."""
    given = _parser().parse_args(arguments)
    folder: Path = given.folder
    try:
        match given.verb:
            case "make":
                cases = draw(given.cases, given.seed, given.kind or get_args(Kind), given.category or CATEGORIES)
                make(cases, folder, Workers(given.workers, given.ray))
                print(f"{len(cases)} cases in {folder / 'data'}, their causes in {folder / 'truths'}")
            case "one":
                case = case_of(given.rig, given.fault, given.strength, given.seed, given.excitation or ())
                write(case, folder / "data", folder / "truths")
                print(folder / "data" / case.name / "stage.yaml")
            case "run":
                run(folder, Workers(given.workers, given.ray))
            case _:
                _print(folder)
    except (ValueError, KeyError, TrialError, JobsFailed, ClusterError) as error:
        raise SystemExit(f"error: {error}") from None


def _print(folder: Path) -> None:
    cases = list(answered(folder))
    scored = [score(truth, reply) for truth, reply in cases if reply is not None]
    if not scored:
        raise TrialError(f"{folder}: contains no answers; use `run` first")
    found = counts(scored)
    text = json.dumps({"shares": found, "cases": [asdict(each) for each in scored]}, indent=1)
    (folder / "score.json").write_text(text + "\n", encoding="utf-8")
    print(table(found), wrong_lines(scored), sep="\n\n")
    if unanswered := [truth["case"] for truth, reply in cases if reply is None]:
        print(f"\nnot answered: {', '.join(unanswered)}")


def add_workers(parser: argparse.ArgumentParser) -> None:
    """Add the options of the place that jobs run at."""
    parser.add_argument("--workers", type=int, default=cores(), help="parallel jobs here; one per core by default")
    parser.add_argument("--ray", help="address of a Ray cluster with this checkout; 'local' starts one here")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog=f"python -m {__spec__.name}", description=__doc__.split("\n")[0])
    verbs = parser.add_subparsers(dest="verb", required=True)
    made = verbs.add_parser("make", help="draw cases and record them")
    made.add_argument("folder", type=Path)
    made.add_argument("--cases", type=int, default=60)
    made.add_argument("--kind", action="append", choices=get_args(Kind), help="may be repeated; all by default")
    made.add_argument("--category", action="append", choices=CATEGORIES, help="may be repeated; all by default")
    one = verbs.add_parser("one", help="record a rig with chosen faults (validation/rigs/faults.py)")
    one.add_argument("folder", type=Path)
    one.add_argument("rig")
    one.add_argument("fault", nargs="*")
    one.add_argument("--strength", type=float, default=1.0)
    one.add_argument("--excitation", action="append", help="excitation of a trial; may be repeated")
    ran = verbs.add_parser("run", help="diagnose every case; continues an interrupted run")
    ran.add_argument("folder", type=Path)
    for verb in (made, one):
        verb.add_argument("--seed", type=int, default=0)
    for verb in (made, ran):
        add_workers(verb)
    verbs.add_parser("score", help="table, wrong answers, score.json").add_argument("folder", type=Path)
    return parser


if __name__ == "__main__":
    main()
