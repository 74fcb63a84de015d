"""Benchmark of the diagnosis on simulated rigs with known causes: make, answer and score cases.

    python -m softarm.diagnosis.blind.rigs make FOLDER --cases 60 --seed 1 --kind tracking --kind pendulum
    python -m softarm.diagnosis.blind.rigs run FOLDER
    python -m softarm.diagnosis.blind.rigs score FOLDER
    python -m softarm.diagnosis.blind.rigs one FOLDER servo dead_time --strength 0.5

FOLDER/data contains the inputs of the diagnosis, FOLDER/truths the causes and FOLDER/answers the verdicts. Rigs, laws
and faults are those of `softarm.reality.rigs`; `score.py` defines the outcomes.
"""

import argparse
import json
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, get_args

from softarm.common.processes import as_they_come, bar
from softarm.diagnosis.blind import pages, seal
from softarm.diagnosis.blind.score import rig_counts, score_rig
from softarm.diagnosis.data.trials import TrialError
from softarm.reality.rigs.case import CATEGORIES, RigCase, case_of, draw
from softarm.reality.rigs.presets import Kind
from softarm.reality.rigs.record import write

OnCase = Callable[[str, int, int], None]


def make(cases: Sequence[RigCase], folder: Path, processes: int = 2, on_case: OnCase = lambda *of: None) -> None:
    """Record the cases that are not complete yet; the truth of a case is written last."""
    todo = [case for case in cases if not (folder / "truths" / f"{case.name}.json").is_file()]
    work = partial(write, data=folder / "data", truths=folder / "truths")
    for done, (case, _) in enumerate(as_they_come(work, todo, processes), 1):
        on_case(case.name, done, len(todo))


def run(folder: Path, processes: int = 2, on_case: OnCase = lambda *of: None, only: Sequence[str] = ()) -> None:
    """Answer every case, or those in `only`, and write the answers to FOLDER/answers.

    Answers of the same tool to the same data are kept. Raises TrialError if the folder contains no such case.
    """
    cases = sorted(path.parent for path in (folder / "data").glob("*/stage.yaml"))
    cases = [case for case in cases if not only or case.name in only]
    if not cases:
        raise TrialError(f"{folder}: contains no such case; make some first (python -m {__spec__.name} make)")
    answers, tool = folder / "answers", seal.tool_version()
    answers.mkdir(exist_ok=True)
    todo = [case for case in cases if not _kept(answers / f"{case.name}.json", tool, case)]
    for done, (case, result) in enumerate(as_they_come(answer, todo, processes), 1):
        text = json.dumps({"tool": tool, "data": seal.case_sha256(case), **result}, indent=1)
        (answers / f"{case.name}.json").write_text(text + "\n", encoding="utf-8")
        on_case(case.name, done, len(todo))


def answer(case: Path) -> dict[str, Any]:
    """Return the verdict on a case and its processor time, s; an exception is recorded as a failure."""
    from softarm.diagnosis.from_files import diagnose_files

    began, verdict, failure = _processor_s(), None, ""
    margins: dict[str, float] = {}
    try:
        found = diagnose_files([case / "stage.yaml"])
        verdict, margins = found.verdict.model_dump(mode="json"), dict(found.margins)
    except Exception as error:  # a failure is scored, and the other cases continue
        failure = f"{type(error).__name__}: {error}"
    return {"verdict": verdict, "margins": margins, "failure": failure, "seconds": _processor_s() - began}


def _processor_s() -> float:
    """Return the processor time of this process and of its finished workers, s."""
    return sum(os.times()[:4])


def answered(folder: Path) -> Iterator[tuple[Any, Any]]:
    """Yield the truth and the answer of each case of a folder; the answer is None if there is none yet."""
    for file in sorted((folder / "truths").glob("*.json")):
        reply = folder / "answers" / file.name
        yield _json(file), _json(reply) if reply.is_file() else None


def _kept(file: Path, tool: str, case: Path) -> bool:
    if not file.is_file():
        return False
    before = _json(file)
    return bool(before["tool"] == tool and before["data"] == seal.case_sha256(case))


def _json(file: Path) -> Any:
    return json.loads(file.read_text(encoding="utf-8"))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line (`python -m softarm.diagnosis.blind.rigs --help`)."""
    given = _parser().parse_args(arguments)
    folder: Path = given.folder
    try:
        match given.verb:
            case "make":
                cases = draw(given.cases, given.seed, given.kind or get_args(Kind), given.category or CATEGORIES)
                with bar("recording", total=None) as shown:
                    make(cases, folder, given.processes, shown.count)
                print(f"{len(cases)} cases in {folder / 'data'}, their causes in {folder / 'truths'}")
            case "one":
                case = case_of(given.rig, given.fault, given.strength, given.seed, given.excitation or ())
                write(case, folder / "data", folder / "truths")
                print(folder / "data" / case.name / "stage.yaml")
            case "run":
                with bar("diagnosing", total=None) as shown:
                    run(folder, given.processes, shown.count, given.case or ())
            case _:
                _print(folder)
    except (ValueError, KeyError, TrialError) as error:
        raise SystemExit(f"error: {error}") from None


def _print(folder: Path) -> None:
    cases = list(answered(folder))
    scored = [score_rig(truth, reply) for truth, reply in cases if reply is not None]
    if not scored:
        raise TrialError(f"{folder}: contains no answers; use `run` first")
    found = rig_counts(scored)
    text = json.dumps({"shares": found, "cases": [asdict(each) for each in scored]}, indent=1)
    (folder / "score.json").write_text(text + "\n", encoding="utf-8")
    print(pages.rig_table(found), pages.rig_answers(scored), sep="\n\n")
    if unanswered := [truth["case"] for truth, reply in cases if reply is None]:
        print(f"\nnot answered: {', '.join(unanswered)}")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m softarm.diagnosis.blind.rigs", description=__doc__.split("\n")[0])
    verbs = parser.add_subparsers(dest="verb", required=True)
    made = verbs.add_parser("make", help="draw cases and record them")
    made.add_argument("folder", type=Path)
    made.add_argument("--cases", type=int, default=60)
    made.add_argument("--kind", action="append", choices=get_args(Kind), help="may be repeated; all by default")
    made.add_argument("--category", action="append", choices=CATEGORIES, help="may be repeated; all by default")
    one = verbs.add_parser("one", help="record a rig with chosen faults (reality/rigs/faults.py)")
    one.add_argument("folder", type=Path)
    one.add_argument("rig")
    one.add_argument("fault", nargs="*")
    one.add_argument("--strength", type=float, default=1.0)
    one.add_argument("--excitation", action="append", help="excitation of a trial; may be repeated")
    ran = verbs.add_parser("run", help="diagnose every case; continues an interrupted run")
    ran.add_argument("folder", type=Path)
    ran.add_argument("--case", action="append", help="only this case; may be repeated")
    for verb in (made, one):
        verb.add_argument("--seed", type=int, default=0)
    for verb in (made, ran):
        verb.add_argument("--processes", type=int, default=2)
    verbs.add_parser("score", help="table, wrong answers, score.json").add_argument("folder", type=Path)
    return parser


if __name__ == "__main__":
    main()
