"""A diagnosis from files to the answer: recordings read, the simulator in question found, both compared."""

from collections.abc import Callable, Sequence
from pathlib import Path

from softarm.common.processes import cores
from softarm.diagnosis.data import tables
from softarm.diagnosis.data.folder import is_trial
from softarm.diagnosis.data.read import read_all
from softarm.diagnosis.data.trials import Trial, TrialError, unique_names
from softarm.diagnosis.diagnose import diagnose
from softarm.diagnosis.engine.result import Diagnosis
from softarm.diagnosis.engine.search import Progress
from softarm.schemas.model import Model
from softarm.simulator import model_file

TABLES = (".yaml", ".yml")  # how the name of a stage.yaml ends
_READING = 0.05  # of the whole work


def diagnose_files(
    inputs: Sequence[Path],
    model: Path | None = None,
    data: Path | None = None,
    tell: Progress = lambda what, share: None,
    warn: Callable[[str], None] = lambda text: None,
) -> Diagnosis:
    """Diagnose what the inputs hold: logs, trial folders, campaigns, another rig's stage.yaml.

    model: of the simulator in question; by default the model.yaml of the inputs' campaign, else the seed's, which is
    said to `warn`. data: where the files of a stage.yaml lie, by default beside it. tell(what, share done).
    Raises TrialError, also for campaigns with different models, and ModelFileError.
    """

    def reading(source: Path) -> None:
        tell(f"reading {source.name}", 0.0)

    trials = _read(inputs, data, reading)
    nominal = None
    if any(trial.stage is None for trial in trials):  # another rig's tables bring their own
        nominal = model_file.load(model) if model is not None else _of_the_campaign(inputs)
        if nominal is None:
            warn("no --model and no model.yaml beside the trials: the seed's simulator is taken as nominal")
            nominal = Model()
    return diagnose(trials, nominal, lambda what, share: tell(what, _READING + share * (1 - _READING)), cores())


def _read(inputs: Sequence[Path], data: Path | None, on_trial: Callable[[Path], None]) -> tuple[Trial, ...]:
    if data is None:
        return read_all(inputs, on_trial)
    rest = read_all([path for path in inputs if path.suffix not in TABLES], on_trial)
    own = (trial for path in inputs if path.suffix in TABLES for trial in tables.read(path, data))
    return unique_names((*rest, *own))


def _of_the_campaign(inputs: Sequence[Path]) -> Model | None:
    """The model.yaml that lies in a campaign; None where there is none. Raises TrialError when several differ."""
    campaigns = {path if path.is_dir() and not is_trial(path) else path.parent for path in inputs}
    beside = sorted(folder / "model.yaml" for folder in campaigns)
    models = {path: model_file.load(path) for path in beside if path.is_file()}
    if not models:
        return None
    (one, model), *others = models.items()
    for other, another in others:
        if another != model:
            raise TrialError(f"{one} and {other} differ; say by --model which of the simulators is meant")
    return model
