"""Fly the cases of a benchmark and write them: data in one folder, labels and fresh trials elsewhere."""

import shutil
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from softarm.common.processes import as_they_come
from softarm.diagnosis.blind import seal
from softarm.diagnosis.blind.cases import Case, PlannedTrial, draw
from softarm.reality.parameters import RobotParameters
from softarm.reality.record import record
from softarm.schemas.excitation import EXCITATIONS
from softarm.simulator import model_file

OnCase = Callable[[str], None]


def write_case(case: Case, data: Path, fresh: Path | None = None) -> str:
    """Write `data/NAME` (model.yaml and the trials) and, with `fresh`, `fresh/NAME`; what was there is written anew.

    Returns the case's name.
    """
    for root, planned in ((data, case.planned), (fresh, case.fresh)):
        if root is None:
            continue
        folder = root / case.name
        shutil.rmtree(folder, ignore_errors=True)  # a half-written case of a run that was stopped
        folder.mkdir(parents=True)
        for trial in planned:
            _fly(case.robot, trial, folder / trial.folder)
        model_file.save(case.model, folder / "model.yaml")  # last: it marks the case as whole
    return case.name


def is_written(case: Case, data: Path, fresh: Path | None = None) -> bool:
    """Whether a case is there in full."""
    return all((root / case.name / "model.yaml").is_file() for root in (data, fresh) if root is not None)


def prepare(data: Path, labels_file: Path, fresh: Path | None, count: int, seed: int | None = None) -> list[Case]:
    """Draw the cases and seal their labels before anything is flown; labels that are there already are gone on with.

    Without `seed`, one that nobody knows. Raises SealError for labels or fresh trials inside `data`, or for labels
    of other cases.
    """
    for place in (labels_file, fresh):
        if place is not None:
            seal.keep_apart(place, data)
    if labels_file.exists():
        labels = seal.read_labels(labels_file)
        cases = draw(len(labels.cases), labels.seed)
        if {case.name: case.label for case in cases} != dict(labels.cases):
            raise seal.SealError(f"{labels_file}: was made by another version; name a new file, and a new folder")
        if len(cases) != count or seed not in (None, labels.seed):
            raise seal.SealError(f"{labels_file}: is of {len(cases)} other cases; name a new file, and a new folder")
        seal.check_labels(labels, data)
        return cases
    if data.exists() and any(data.iterdir()):
        raise seal.SealError(f"{data}: holds something already, of other labels; name a new folder")
    salt, secret = seal.new_secret()
    seed = secret if seed is None else seed
    cases = draw(count, seed)
    seal.write_labels(seal.Labels(salt, seed, {case.name: case.label for case in cases}), labels_file, data)
    return cases


def write_cases(
    cases: Sequence[Case], data: Path, fresh: Path | None, processes: int = 2, on_case: OnCase | None = None
) -> None:
    """Fly those that are not there yet; a case that is there counts at once."""
    finished = on_case or (lambda name: None)
    todo = []
    for case in cases:
        if is_written(case, data, fresh):
            finished(case.name)
        else:
            todo.append(case)
    for _, name in as_they_come(partial(write_case, data=data, fresh=fresh), todo, processes):
        finished(name)


def _fly(robot: RobotParameters, trial: PlannedTrial, folder: Path) -> None:
    excitation = EXCITATIONS[trial.excitation]
    record(excitation.at, folder, excitation.duration_s, robot, trial.seed, kind=trial.excitation, held=trial.held)
