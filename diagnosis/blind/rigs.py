"""The diagnosis on other people's rigs of known cause: cases made, answered, scored.

    python -m softarm.diagnosis.blind.rigs make FOLDER --cases 60 --seed 1 --kind tracking --kind pendulum
    python -m softarm.diagnosis.blind.rigs run FOLDER
    python -m softarm.diagnosis.blind.rigs score FOLDER
    python -m softarm.diagnosis.blind.rigs one FOLDER servo dead_time --strength 0.5

FOLDER/data holds what a tool may see, FOLDER/truths what it may not, FOLDER/answers what was said. Rigs, laws and
faults are `softarm.reality.rigs`'; what counts as right is in `rigs_score.py`.
"""

import argparse
import json
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, get_args

from softarm.common.processes import as_they_come, bar
from softarm.diagnosis.blind import rigs_score
from softarm.diagnosis.blind.run import digest, tool_version
from softarm.diagnosis.data.trials import TrialError
from softarm.reality.rigs.case import CATEGORIES, RigCase, case_of, draw
from softarm.reality.rigs.presets import Kind
from softarm.reality.rigs.record import write

OnCase = Callable[[str, int, int], None]


def make(cases: Sequence[RigCase], folder: Path, processes: int = 2, on_case: OnCase = lambda *of: None) -> None:
    """Record the cases that are not there yet; a truth is written last, and marks its case as whole."""
    todo = [case for case in cases if not (folder / "truths" / f"{case.name}.json").is_file()]
    work = partial(write, data=folder / "data", truths=folder / "truths")
    for done, (case, _) in enumerate(as_they_come(work, todo, processes), 1):
        on_case(case.name, done, len(todo))


def run(folder: Path, processes: int = 2, on_case: OnCase = lambda *of: None, only: Sequence[str] = ()) -> None:
    """Answer every case, or those named, into FOLDER/answers; what this tool has said of these data is kept.

    Raises TrialError for a folder without cases.
    """
    cases = sorted(path.parent for path in (folder / "data").glob("*/stage.yaml"))
    cases = [case for case in cases if not only or case.name in only]
    if not cases:
        raise TrialError(f"{folder}: holds no such case; make some first (python -m {__spec__.name} make)")
    answers, tool = folder / "answers", tool_version()
    answers.mkdir(exist_ok=True)
    todo = [case for case in cases if not _kept(answers / f"{case.name}.json", tool, case)]
    for done, (case, said) in enumerate(as_they_come(answer, todo, processes), 1):
        text = json.dumps({"tool": tool, "data": digest(case), **said}, indent=1)
        (answers / f"{case.name}.json").write_text(text + "\n", encoding="utf-8")
        on_case(case.name, done, len(todo))


def answer(case: Path) -> dict[str, Any]:
    """What the diagnosis says of a case's folder, and the processor's seconds. What it raises is its answer: none."""
    from softarm.diagnosis.from_files import diagnose_files

    began, verdict, failure = time.process_time(), None, ""
    margins: dict[str, float] = {}
    try:
        found = diagnose_files([case / "stage.yaml"])
        verdict, margins = found.verdict.model_dump(mode="json"), dict(found.margins)
    except Exception as error:  # a tool that falls over is scored, not excused, and the other cases go on
        failure = f"{type(error).__name__}: {error}"
    return {"verdict": verdict, "margins": margins, "failure": failure, "seconds": time.process_time() - began}


def score(folder: Path) -> tuple[list[rigs_score.Scored], list[str]]:
    """Every answered case of a folder, and the names of those that nobody answered."""
    scored, silent = [], []
    for file in sorted((folder / "truths").glob("*.json")):
        said = folder / "answers" / file.name
        if said.is_file():
            scored.append(rigs_score.score(_json(file), _json(said)))
        else:
            silent.append(file.stem)
    return scored, silent


def _kept(file: Path, tool: str, case: Path) -> bool:
    if not file.is_file():
        return False
    said = _json(file)
    return bool(said["tool"] == tool and said["data"] == digest(case))


def _json(file: Path) -> Any:
    return json.loads(file.read_text(encoding="utf-8"))


def main(arguments: Sequence[str] | None = None) -> None:
    """`python -m softarm.diagnosis.blind.rigs --help`."""
    given = _parser().parse_args(arguments)
    folder: Path = given.folder
    try:
        match given.verb:
            case "make":
                cases = draw(given.cases, given.seed, given.kind or get_args(Kind), given.category or CATEGORIES)
                with bar("recording", total=None) as shown:
                    make(cases, folder, given.processes, shown.count)
                print(f"{len(cases)} cases in {folder / 'data'}, what is wrong with them in {folder / 'truths'}")
            case "one":
                case = case_of(given.rig, given.fault, given.strength, given.seed, given.told or ())
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
    scored, silent = score(folder)
    if not scored:
        raise TrialError(f"{folder}: nothing was answered there; run it first")
    found = rigs_score.shares(scored)
    each = [{name: getattr(s, name) for name in rigs_score.Scored.__slots__} for s in scored]
    text = json.dumps({"shares": found, "cases": each}, indent=1)
    (folder / "score.json").write_text(text + "\n", encoding="utf-8")
    print(rigs_score.table(found), rigs_score.listed(scored), sep="\n\n")
    if silent:
        print(f"\nnot answered: {', '.join(silent)}")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m softarm.diagnosis.blind.rigs", description=__doc__.split("\n")[0])
    verbs = parser.add_subparsers(dest="verb", required=True)
    made = verbs.add_parser("make", help="draw cases and record them")
    made.add_argument("folder", type=Path)
    made.add_argument("--cases", type=int, default=60)
    made.add_argument("--kind", action="append", choices=get_args(Kind), help="several times; all by default")
    made.add_argument("--category", action="append", choices=CATEGORIES, help="several times; all by default")
    one = verbs.add_parser("one", help="record a rig with faults that you name (reality/rigs/faults.py)")
    one.add_argument("folder", type=Path)
    one.add_argument("rig")
    one.add_argument("fault", nargs="*")
    one.add_argument("--strength", type=float, default=1.0)
    one.add_argument("--told", action="append", help="the excitation of a trial; several times")
    ran = verbs.add_parser("run", help="diagnose every case; goes on where it stopped")
    ran.add_argument("folder", type=Path)
    ran.add_argument("--case", action="append", help="only this one; several times")
    for verb in (made, one):
        verb.add_argument("--seed", type=int, default=0)
    for verb in (made, ran):
        verb.add_argument("--processes", type=int, default=2)
    verbs.add_parser("score", help="table, wrong answers, score.json").add_argument("folder", type=Path)
    return parser


if __name__ == "__main__":
    main()
