"""Running of a method on every case: in parallel, restartable, frozen at the end, without access to the labels.

The methods are the diagnosis and simpler baselines, all with the same inputs.
"""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from softarm.common import batch
from softarm.common.batch import Kept, Work, Workers
from softarm.common.files import sha256_of
from softarm.common.words import did_you_mean
from softarm.diagnosis.data import read
from softarm.diagnosis.data.trials import Trial
from softarm.diagnosis.diagnose import diagnose
from softarm.diagnosis.engine.result import Diagnosis
from softarm.schemas.model import Model
from softarm.simulator import model_file
from validation.blind import baselines, seal

Method = Callable[[Sequence[Trial], Model], Diagnosis]

METHODS: dict[str, Method] = {
    "diagnose": diagnose,
    "largest-gain": baselines.largest_gain,  # the effect that explains most
    "all-at-once": baselines.all_at_once,  # all effects fitted, ranked by value over interval
}


def run(data: Path, file: Path, method: str = "diagnose", workers: Workers | None = None) -> str:
    """Answer every case, freeze the file of answers and return its SHA-256.

    Answers of the same code to the same data are kept in the folder `file` + `.kept`, also after an
    interrupted run. Processor times are written to `file` + `.timing.json`, which is not frozen.

    Raises SealError if the folder contains no cases, or the method is unknown.
    """
    if method not in METHODS:
        hint = did_you_mean(method, METHODS)
        raise seal.SealError(f"unknown method {method!r}; {hint}allowed are {', '.join(METHODS)}")
    cases = {case.name: case for case in folders(data)}
    seal.keep_apart(file, data)
    file.parent.mkdir(parents=True, exist_ok=True)
    tool = seal.tool_version()
    if method != "diagnose":
        tool += f"+{sha256_of(Path(baselines.__file__))[:12]}"
    about = {"method": method, "tool": tool}
    folder = seal.beside(file, ".kept")
    kept = Kept(lambda name: folder / f"{name}.json", lambda name: {**about, "data": sha256_of(cases[name])})
    work = Work(partial(answer_case, method=method), reads=lambda case: [case])
    done = batch.run(method, work, cases, workers, kept=kept).complete("the same command continues")
    _write(file, about, {name: {k: v for k, v in answer.items() if k not in about} for name, answer in done.items()})
    return seal.freeze(file)


def folders(data: Path) -> list[Path]:
    """Return the folders of all cases, sorted; raise SealError if there are none."""
    cases = sorted(path.parent for path in data.glob("*/model.yaml"))
    if not cases:
        raise seal.SealError(
            f"{data}: contains no case (no folder with a model.yaml); name the folder that "
            "`python -m validation.blind make` wrote"
        )
    return cases


def answer_case(folder: Path, method: str) -> dict[str, Any]:
    """Return a method's answer to one case; an exception of the method is recorded as a failure.

    The method sees the trials and the model, but neither the case's name nor its path.
    """
    begin = time.process_time()
    model = model_file.load(folder / "model.yaml")
    trials = [_anonymous(trial, folder) for trial in read.read_all([folder])]
    answer: dict[str, Any] = {"verdict": None, "patched_model": None, "margins": {}}
    failure = ""
    try:
        found = METHODS[method](trials, model)
        answer = {
            "verdict": found.verdict.model_dump(mode="json"),
            "patched_model": (found.patched or model).model_dump(),
            "margins": dict(found.margins),
        }
    except Exception as error:  # a failure is scored, and the other cases continue
        failure = f"{type(error).__name__}: {error}"
    return {
        "case": folder.name,
        "data": sha256_of(folder),
        **answer,
        "failure": failure,
        "seconds": time.process_time() - begin,
    }


def read_answers(file: Path) -> dict[str, Any]:
    """Return a frozen file's method, tool and answers; raise SealError if it was not frozen or has changed."""
    seal.check_frozen(file)
    answers: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return answers


def read_seconds(file: Path) -> dict[str, float]:
    """Return the processor time of each case, s; empty if it was not recorded."""
    timing = seal.beside(file, ".timing.json")
    return dict(json.loads(timing.read_text(encoding="utf-8"))) if timing.is_file() else {}


def _anonymous(trial: Trial, folder: Path) -> Trial:
    warnings = tuple(text.replace(str(folder), "case") for text in trial.warnings)
    missing = {channel: text.replace(str(folder), "case") for channel, text in trial.missing.items()}
    return replace(trial, source=Path("case") / trial.source.name, warnings=warnings, missing=missing)


def _write(file: Path, about: dict[str, str], done: dict[str, dict[str, Any]]) -> None:
    """Write answers sorted by case without their times, so that equal answers are equal bytes; times separately."""
    answers = [{key: value for key, value in done[name].items() if key != "seconds"} for name in sorted(done)]
    file.write_text(json.dumps({**about, "answers": answers}, indent=1) + "\n", encoding="utf-8")
    times = {name: done[name]["seconds"] for name in sorted(done)}
    seal.beside(file, ".timing.json").write_text(json.dumps(times, indent=1) + "\n", encoding="utf-8")
