"""Diagnosis of files: read the recordings, find the nominal model, compare both."""

from collections.abc import Callable, Sequence
from pathlib import Path

from softarm.common.processes import cores
from softarm.diagnosis.data.folder import is_trial
from softarm.diagnosis.data.read import read_all, stage_of_folder
from softarm.diagnosis.data.trials import TrialError
from softarm.diagnosis.diagnose import BUDGET_S, diagnose
from softarm.diagnosis.engine.result import Diagnosis
from softarm.diagnosis.engine.work import Progress
from softarm.schemas.model import Model
from softarm.simulator import model_file

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
