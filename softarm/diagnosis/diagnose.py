"""Diagnosis of the robot or of a rig: from files, or from trials that are read already."""

import gc
from collections.abc import Callable, Sequence
from pathlib import Path

from threadpoolctl import threadpool_limits

from softarm.common.processes import cores
from softarm.diagnosis.data.folder import is_trial
from softarm.diagnosis.data.read import read_all, stage_of_folder
from softarm.diagnosis.data.trials import Trial, TrialError
from softarm.diagnosis.engine.result import Diagnosis
from softarm.diagnosis.engine.work import Progress
from softarm.diagnosis.robot.diagnose import diagnose_robot
from softarm.schemas.model import Model
from softarm.simulator import model_file

BUDGET_S = 120.0
_READING = 0.05  # share of the whole work


def diagnose_files(
    inputs: Sequence[Path],
    model: Path | None = None,
    data: Path | None = None,
    progress: Progress = lambda what, share: None,
    warn: Callable[[str], None] = lambda text: None,
    budget_s: float = BUDGET_S,
    processes: int | None = None,
) -> Diagnosis:
    """Diagnose logs, trial folders, campaigns, or the stage.yaml of a rig or its folder.

    Args:
        inputs: files and folders to read.
        model: nominal model; by default the campaign's model.yaml, else the seed's with a call of `warn`.
        data: folder of the files of a stage.yaml, by default its own.
        progress: called with the current step and the finished share, 0 to 1.
        warn: called with a text for the user.
        budget_s: processor time for a rig, s; of longer recordings only the most informative stretches are used.
        processes: number of a rig's stages that are diagnosed at the same time, by default one per core.

    Raises:
        TrialError: the inputs cannot be compared, or their campaigns have different models.
        ModelFileError: the model file is invalid.
    """

    def reading(source: Path) -> None:
        progress(f"reading {source.name}", 0.0)

    inputs = [stage_of_folder(path) for path in inputs]
    trials = read_all(inputs, reading, data)
    nominal = None
    if any(trial.stage is None for trial in trials):  # tables of a rig bring their own
        nominal = model_file.load(model) if model is not None else _of_the_campaign(inputs)
        if nominal is None:
            warn("no --model and no model.yaml with the trials: the seed's simulator is the nominal model")
            nominal = Model()

    def later(what: str, share: float) -> None:
        progress(what, _READING + share * (1 - _READING))

    return diagnose(trials, nominal, later, processes or cores(), budget_s)


def _of_the_campaign(inputs: Sequence[Path]) -> Model | None:
    """Return the model.yaml of the inputs' campaigns, or None; raise TrialError if several differ."""
    campaigns = {path if path.is_dir() and not is_trial(path) else path.parent for path in inputs}
    found = sorted(folder / "model.yaml" for folder in campaigns)
    models = {path: model_file.load(path) for path in found if path.is_file()}
    if not models:
        return None
    (one, model), *others = models.items()
    for other, another in others:
        if another != model:
            raise TrialError(f"{one} and {other} differ; choose one with --model")
    return model


def diagnose(
    trials: Sequence[Trial],
    model: Model | None = None,
    progress: Progress = lambda what, share: None,
    processes: int = 1,
    budget_s: float = BUDGET_S,
) -> Diagnosis:
    """Find where robot and simulator differ, by which effects, and how far the gap shrinks with them.

    The result is deterministic.

    Args:
        trials: trials of the robot or of a rig.
        model: nominal model of the robot, by default the seed's; a rig's tables bring their own.
        progress: called with the current step and the finished share, 0 to 1.
        processes: number of a rig's stages that are diagnosed at the same time.
        budget_s: processor time for a rig, s; of longer recordings only the most informative stretches are used.

    Raises:
        TrialError: there are no trials, or trials of the robot and of rigs, or nothing can be compared.
    """
    if not trials:
        raise TrialError("no trial to diagnose; name a campaign, a trial folder or a log")
    tables = [trial for trial in trials if trial.stage is not None]
    if tables and len(tables) < len(trials):
        raise TrialError(f"{tables[0].source}: tables of a rig and recordings of the robot; diagnose them separately")
    ordered = sorted(trials, key=lambda trial: (trial.name, str(trial.source)))
    import sklearn  # noqa: F401  # the limit only holds for loaded libraries

    # With small matrices, BLAS and the boosted trees take twenty times the work on several threads.
    try:
        with threadpool_limits(1):
            if tables:
                # The laws of rigs are compiled on import.
                from softarm.diagnosis.rigs.diagnose import diagnose_table
                from softarm.diagnosis.rigs.owner_units import in_owners_units

                return in_owners_units(diagnose_table(ordered, progress, processes, budget_s), ordered)
            return diagnose_robot(ordered, model or Model(), progress)
    finally:
        # A search refers to itself, and the collector does not count its arrays: a hundred robots kept 5 GB.
        gc.collect()
