"""Reading of all inputs of a diagnosis: logs, trial folders, campaigns and stage.yaml files."""

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from softarm.diagnosis.data import folder, mcap, tables
from softarm.diagnosis.data.trials import Trial, TrialError, unique_names
from softarm.recordings import rail_motion
from softarm.recordings.mcap_file import LogError
from softarm.recordings.rail_motion import RailMotion

TABLES = (".yaml", ".yml")  # suffixes of a stage.yaml


def read_all(
    paths: Iterable[Path], on_trial: Callable[[Path], None] = lambda source: None, data: Path | None = None
) -> tuple[Trial, ...]:
    """Read every trial of the inputs, sorted by name.

    An input is an MCAP log, a trial folder, a campaign (a folder of trial folders and logs) or a stage.yaml, whose
    files are in `data`, by default in its own folder. Raises TrialError if a path is none of these, or its data are
    invalid.
    """
    trials: list[Trial] = []
    for path in paths:
        for source in sources(path):
            if source.suffix in TABLES:
                trials += tables.read(source, data)
            else:
                trials.append(folder.read(source) if source.is_dir() else mcap.read(source))
            on_trial(source)
    return unique_names(trials)


def rail_motions(paths: Iterable[Path]) -> tuple[RailMotion, ...]:
    """Return the motion of the rail in each recording; tables of rigs contain none.

    Raises TrialError as `read_all` does.
    """
    found: list[RailMotion] = []
    for source in (source for path in paths for source in sources(path)):
        if source.suffix == ".mcap":
            try:
                found.append(rail_motion.read(source))
            except LogError as error:
                raise TrialError(str(error)) from None
        elif source.is_dir() and {"command", "rail"} <= (channels := folder.read(source).channels).keys():
            sent, seen = channels["command"], channels["rail"]
            obeyed = np.ones(len(sent), dtype=bool)  # every command counts as carried out
            columns = seen.t_s, seen["position"], seen["velocity"]
            found.append(RailMotion(source, sent.t_s, sent["cart_velocity"], obeyed, *columns))
    return tuple(found)


def stage_of_folder(path: Path) -> Path:
    """Return the stage.yaml of a rig's folder, and any other path unchanged."""
    return stage if (stage := path / "stage.yaml").is_file() else path


def sources(path: Path) -> tuple[Path, ...]:
    """Return the trials and stage.yaml files of a path; raise TrialError if it contains none."""
    if path.is_file() and path.suffix in (".mcap", *TABLES):
        return (path,)
    if not path.exists():
        raise TrialError(f"{path}: does not exist; name an MCAP log, a trial folder, a campaign or a stage.yaml")
    if path.is_file():
        raise TrialError(f"{path}: is neither an .mcap log nor a stage.yaml; describe a table in a stage.yaml")
    if folder.is_trial(path):
        return (path,)
    inside = tuple(sorted((*(p for p in path.iterdir() if p.is_dir() and folder.is_trial(p)), *path.glob("*.mcap"))))
    if not inside:
        raise TrialError(
            f"{path}: contains no trial: no trial.yaml (a trial), no folders with one (a campaign) and no .mcap logs"
        )
    return inside
