"""Have a method answer every case: two at a time, restartable, and frozen at the end. Labels are no argument here."""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

from softarm import common, diagnosis, schemas, simulator
from softarm.common.processes import as_they_come
from softarm.common.words import did_you_mean
from softarm.diagnosis.blind import methods, seal
from softarm.diagnosis.data import read
from softarm.diagnosis.data.trials import Trial
from softarm.schemas.model import Model
from softarm.schemas.verdict import Verdict
from softarm.simulator import model_file

Clock = Callable[[], float]
# case, answered, of
OnAnswer = Callable[[str, int, int], None]
_CODE = (".py", ".yaml", ".json")


def run(
    data: Path,
    file: Path,
    method: str = methods.DEFAULT,
    processes: int = 2,
    on_answer: OnAnswer | None = None,
    trials: int | None = None,
) -> str:
    """Answer every case of `data` into `file` (JSON), freeze it and return its SHA-256.

    An answer that the same version of the tool has given to the same data is kept, also when the run was stopped.
    trials: only so many of each case are shown, the first by name. Each one's processor time is in `file` +
    `.timing.json`, which is not frozen. Raises SealError for a folder without cases or for an unknown method.
    """
    if method not in methods.METHODS:
        hint = did_you_mean(method, methods.METHODS)
        raise seal.SealError(f"method {method!r} is unknown; {hint}there are {', '.join(methods.METHODS)}")
    cases = folders(data)
    seal.keep_apart(file, data)
    file.parent.mkdir(parents=True, exist_ok=True)
    about = {"method": method if trials is None else f"{method}, {trials} trials", "tool": tool_version()}
    unfinished = _beside(file, ".partial")
    done = _kept(file, unfinished, about, cases)
    todo = [case for case in cases if case.name not in done]
    with unfinished.open("a", encoding="utf-8") as out:
        for _, answer in as_they_come(partial(answer_case, method=method, shown=trials), todo, processes):
            done[answer["case"]] = answer
            out.write(json.dumps({**about, **answer}) + "\n")
            out.flush()
            if on_answer is not None:
                on_answer(answer["case"], len(done), len(cases))
    _write(file, about, done)
    unfinished.unlink()
    return seal.freeze(file)


def folders(data: Path) -> list[Path]:
    """The cases of a benchmark, by name. Raises SealError when there is none."""
    cases = sorted(path.parent for path in data.glob("*/model.yaml"))
    if not cases:
        raise seal.SealError(
            f"{data}: holds no case (a folder with a model.yaml); name what `softarm blind make` wrote"
        )
    return cases


def answer_case(
    folder: Path, method: str, shown: int | None = None, clock: Clock = time.process_time
) -> dict[str, Any]:
    """One case's answer. The method sees trials and model, neither the case's name nor its place.

    What a method raises is its answer: none.
    """
    begin = clock()
    model = model_file.load(folder / "model.yaml")
    trials = [_anonymous(trial, folder) for trial in read.read_all([folder])][:shown]
    verdict: Verdict | None = None
    patched: Model | None = None
    failure = ""
    margins: dict[str, float] = {}
    try:
        found = methods.METHODS[method](trials, model)
        verdict, own = (found, None) if isinstance(found, Verdict) else (found.verdict, found.patched)
        margins = {} if isinstance(found, Verdict) else dict(found.margins)
        patched = own or methods.patched(model, verdict)
    except Exception as error:  # a tool that falls over is scored, not excused, and the other cases go on
        failure = f"{type(error).__name__}: {error}"
    return {
        "case": folder.name,
        "data": digest(folder),
        "verdict": None if verdict is None else verdict.model_dump(mode="json"),
        "patched_model": None if patched is None else patched.model_dump(),
        "margins": margins,
        "failure": failure,
        "seconds": clock() - begin,
    }


def digest(folder: Path) -> str:
    """SHA-256 of a case's files, whatever the case is called."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return seal.sha256("".join(f"{path.relative_to(folder)} {seal.sha256(path.read_bytes())}\n" for path in files))


def tool_version() -> str:
    """The package's version and a hash of the code that answers: another code, another version."""
    lines = []
    for package in (common, diagnosis, schemas, simulator):
        root = Path(str(package.__file__)).parent
        for path in sorted(
            p for p in root.rglob("*") if p.suffix in _CODE and "blind" not in p.relative_to(root).parts
        ):
            lines.append(f"{root.name}/{path.relative_to(root)} {seal.sha256(path.read_bytes())}")
    return f"{version('softarm')}+{seal.sha256(chr(10).join(lines))[:12]}"


def read_answers(file: Path) -> dict[str, Any]:
    """A frozen file: method, tool, answers by case. Raises SealError when it is not frozen or has changed."""
    seal.check_frozen(file)
    answers: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return answers


def read_seconds(file: Path) -> dict[str, float]:
    """Processor time of each case; empty where it is not known."""
    timing = _beside(file, ".timing.json")
    return dict(json.loads(timing.read_text(encoding="utf-8"))) if timing.is_file() else {}


def _anonymous(trial: Trial, folder: Path) -> Trial:
    warnings = tuple(text.replace(str(folder), "case") for text in trial.warnings)
    missing = {channel: text.replace(str(folder), "case") for channel, text in trial.missing.items()}
    return replace(trial, source=Path("case") / trial.source.name, warnings=warnings, missing=missing)


def _kept(file: Path, unfinished: Path, about: dict[str, str], cases: Sequence[Path]) -> dict[str, dict[str, Any]]:
    """Answers that still hold: same tool and method, same data."""
    lines: list[dict[str, Any]] = []
    if file.is_file():
        before, seconds = json.loads(file.read_text(encoding="utf-8")), read_seconds(file)
        lines += [
            {"method": before["method"], "tool": before["tool"], **answer, "seconds": seconds.get(answer["case"], 0.0)}
            for answer in before["answers"]
        ]
    if unfinished.is_file():
        for line in unfinished.read_text(encoding="utf-8").splitlines():
            try:
                lines.append(json.loads(line))
            except ValueError:
                continue  # the line on which the run was stopped
    now = {case.name: digest(case) for case in cases} if lines else {}
    return {
        line["case"]: {key: value for key, value in line.items() if key not in about}
        for line in lines
        if all(line[key] == value for key, value in about.items()) and now.get(line["case"]) == line["data"]
    }


def _write(file: Path, about: dict[str, str], done: dict[str, dict[str, Any]]) -> None:
    """Answers in the cases' order without their times, so that the same answers are the same bytes; times beside."""
    answers = [{key: value for key, value in done[name].items() if key != "seconds"} for name in sorted(done)]
    file.write_text(json.dumps({**about, "answers": answers}, indent=1) + "\n", encoding="utf-8")
    times = {name: done[name]["seconds"] for name in sorted(done)}
    _beside(file, ".timing.json").write_text(json.dumps(times, indent=1) + "\n", encoding="utf-8")


def _beside(file: Path, ending: str) -> Path:
    return file.with_name(file.name + ending)
