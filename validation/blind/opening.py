"""Scoring of frozen answers: check the seals, measure on fresh trials and score."""

import json
import statistics
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from softarm.common.files import sha256_of
from softarm.diagnosis.data import read
from softarm.schemas.model import Model
from softarm.schemas.verdict import Verdict
from softarm.simulator import model_file
from validation.blind import run, seal
from validation.blind.imperfections import Cause
from validation.blind.score import Scored, score
from validation.blind.shrink import measure_shrink

# case, done, of
OnCase = Callable[[str, int, int], None]


def open_labels(
    data: Path,
    labels_file: Path,
    answer_files: Sequence[Path],
    fresh: Path | None = None,
    on_case: OnCase = lambda case, done, of: None,
) -> dict[str, Any]:
    """Return the figures of each file of answers, by method.

    Without a folder of `fresh` trials the shrink is not measured. Raises SealError if answers changed after they were
    frozen, lack a case or belong to other data, or the labels differ from the commitment.
    """
    frozen = {file: (seal.check_frozen(file), run.read_answers(file)) for file in answer_files}
    labels = seal.read_labels(labels_file)
    seal.check_labels(labels, data)
    for file, (_, content) in frozen.items():
        _check_complete(file, content, labels, data)
    methods: dict[str, Any] = {}
    for file, (digest, content) in frozen.items():
        if content["method"] in methods:
            raise seal.SealError(
                f"{file}: there are already answers of {content['method']}; name one file for each method"
            )
        cases = _scored(labels, content, fresh, on_case)
        seconds = run.read_seconds(file)
        methods[content["method"]] = {
            "tool": content["tool"],
            "answers_sha256": digest,
            "seconds_median": statistics.median(seconds.values()) if seconds else None,
            "seconds_worst": max(seconds.values(), default=None),
            **score(cases),
        }
    return {"labels": seal.commitment(labels)["all"], "methods": methods}


def _check_complete(file: Path, content: Mapping[str, Any], labels: seal.Labels, data: Path) -> None:
    """Check that every case was answered once, with these data."""
    given = {answer["case"]: answer["data"] for answer in content["answers"]}
    if missing := sorted(set(labels.cases) ^ set(given)):
        raise seal.SealError(
            f"{file}: {', '.join(missing[:5])} {'is' if len(missing) == 1 else 'are'} in the labels or in the answers, "
            "but not in both; finish `python -m validation.blind run` on these data"
        )
    for case, digest in given.items():
        if sha256_of(data / case) != digest:
            raise seal.SealError(
                f"{data / case}: changed after it was answered; run `python -m validation.blind run` again"
            )


def _scored(labels: seal.Labels, content: Mapping[str, Any], fresh: Path | None, on_case: OnCase) -> list[Scored]:
    cases = []
    answers = content["answers"]
    for number, answer in enumerate(answers, 1):
        label = labels.cases[answer["case"]]
        verdict = Verdict.model_validate_json(json.dumps(answer["verdict"])) if answer["verdict"] else None
        shrink = None
        if fresh is not None and verdict is not None and verdict.effects:
            place = fresh / answer["case"]
            patched = Model.model_validate_json(json.dumps(answer["patched_model"]))
            shrink = measure_shrink(read.read_all([place]), model_file.load(place / "model.yaml"), patched)
        causes = tuple(Cause(cause["name"], cause["removed"], cause["settings"]) for cause in label["causes"])
        cases.append(Scored(answer["case"], label["kind"], causes, verdict, answer["failure"], shrink))
        on_case(answer["case"], number, len(answers))
    return cases
