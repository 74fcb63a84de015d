"""Inputs as people name them: logs, trial folders, campaigns, stage.yaml files."""

from collections.abc import Callable, Iterable
from pathlib import Path

from softarm.diagnosis import folder, mcap, tables
from softarm.diagnosis.trials import Trial, TrialError, unique_names


def read_all(paths: Iterable[Path], on_trial: Callable[[Path], None] | None = None) -> tuple[Trial, ...]:
    """Read every trial of the inputs, sorted by name; the order of the inputs does not count.

    A path is an MCAP log, a trial folder, a campaign (a folder of trial folders and logs) or a stage.yaml.
    Raises TrialError when one of them is none of these.
    """
    trials: list[Trial] = []
    for path in paths:
        for source in sources(path):
            if source.suffix in (".yaml", ".yml"):
                trials += tables.read(source)
            else:
                trials.append(folder.read(source) if source.is_dir() else mcap.read(source))
            if on_trial is not None:
                on_trial(source)
    return unique_names(trials)


def sources(path: Path) -> tuple[Path, ...]:
    """What a path holds that is a trial each, or a stage.yaml. Raises TrialError when it holds none."""
    if path.is_file() and path.suffix in (".mcap", ".yaml", ".yml"):
        return (path,)
    if not path.exists():
        raise TrialError(f"{path}: is not there; name an MCAP log, a trial folder, a campaign or a stage.yaml")
    if path.is_file():
        raise TrialError(f"{path}: is no .mcap and no stage.yaml; a table needs a stage.yaml that says what it holds")
    if folder.is_trial(path):
        return (path,)
    inside = tuple(sorted((*(p for p in path.iterdir() if p.is_dir() and folder.is_trial(p)), *path.glob("*.mcap"))))
    if not inside:
        raise TrialError(
            f"{path}: holds no trial: neither a trial.yaml (a trial), nor folders with one (a campaign), nor .mcap logs"
        )
    return inside
