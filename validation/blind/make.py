"""Simulation of the benchmark's cases: data in one folder, labels and fresh trials elsewhere."""

import secrets
import shutil
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from softarm.common import batch
from softarm.common.batch import Work, Workers
from softarm.reality.record import record
from softarm.schemas.excitation import EXCITATIONS
from softarm.simulator import model_file
from validation.blind import seal
from validation.blind.cases import Case, draw


def write_case(case: Case, data: Path, fresh: Path | None = None) -> str:
    """Write a case to `data/NAME` and `fresh/NAME`, replacing older files, and return its name.

    Each folder gets a model.yaml and the trials; `fresh` is optional.
    """
    for root, planned in ((data, case.planned), (fresh, case.fresh)):
        if root is None:
            continue
        folder = root / case.name
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        for trial in planned:
            flown, place = EXCITATIONS[trial.excitation], folder / trial.folder
            record(flown.at, place, flown.duration_s, case.robot, trial.seed, kind=flown.name, held=trial.held)
        model_file.save(case.model, folder / "model.yaml")  # last: it marks the case as complete
    return case.name


def is_written(case: Case, data: Path, fresh: Path | None) -> bool:
    """Return whether a case was written completely."""
    return all((root / case.name / "model.yaml").is_file() for root in (data, fresh) if root is not None)


def prepare(data: Path, labels_file: Path, fresh: Path | None, count: int, seed: int | None = None) -> list[Case]:
    """Draw the cases and seal their labels before any simulation; existing labels are used again.

    The default seed is random. Raises SealError if labels or fresh trials are inside `data`, which the tool may read,
    or the labels belong to other cases.
    """
    for place in (labels_file, fresh):
        if place is not None:
            seal.keep_apart(place, data)
    if labels_file.exists():
        labels = seal.read_labels(labels_file)
        cases = draw(len(labels.cases), labels.seed)
        if {case.name: case.label for case in cases} != dict(labels.cases):
            raise seal.SealError(f"{labels_file}: was made by another version; name a new file and a new folder")
        if len(cases) != count or seed not in (None, labels.seed):
            raise seal.SealError(
                f"{labels_file}: belongs to {len(cases)} other cases; name a new file and a new folder"
            )
        seal.check_labels(labels, data)
        return cases
    if data.exists() and any(data.iterdir()):
        raise seal.SealError(f"{data}: is not empty and belongs to other labels; name a new folder")
    seed = secrets.randbits(63) if seed is None else seed
    cases = draw(count, seed)
    seal.write_labels(
        seal.Labels(secrets.token_hex(32), seed, {case.name: case.label for case in cases}), labels_file, data
    )
    return cases


def write_cases(cases: Sequence[Case], data: Path, fresh: Path | None, workers: Workers | None = None) -> None:
    """Simulate and write the cases that are not complete yet. Raises JobsFailed."""
    todo = {case.name: case for case in cases if not is_written(case, data, fresh)}
    places = [root for root in (data, fresh) if root is not None]
    work = Work(partial(write_case, data=data, fresh=fresh), writes=lambda case: [root / case.name for root in places])
    batch.run("flying", work, todo, workers).complete("the same command continues")
