"""Inputs as people name them: logs, trial folders, campaigns, stage.yaml files."""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np

from softarm.diagnosis.data import folder, mcap, tables
from softarm.diagnosis.data.trials import Trial, TrialError, unique_names
from softarm.recordings import rail_motion
from softarm.recordings.mcap_file import LogError
from softarm.recordings.rail_motion import RailMotion


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


def rail_motions(paths: Iterable[Path]) -> tuple[RailMotion, ...]:
    """What the inputs hold of the rail, recording by recording; tables of other rigs hold nothing of it.

    Raises TrialError as `read_all` does.
    """
    found: list[RailMotion] = []
    for source in (source for path in paths for source in sources(path)):
        if source.suffix == ".mcap":
            try:
                found.append(rail_motion.read(source))
            except LogError as error:
                raise TrialError(str(error)) from None
        elif source.is_dir():
            found += _rail_of(folder.read(source))
    return tuple(found)


def _rail_of(trial: Trial) -> Iterator[RailMotion]:
    """A recording of another stack: all that it commanded counts as obeyed."""
    if {"command", "rail"} <= trial.channels.keys():
        sent, seen = trial.channel("command"), trial.channel("rail")
        obeyed = np.ones(len(sent), dtype=bool)
        columns = seen.t_s, seen["position"], seen["velocity"]
        yield RailMotion(trial.source, sent.t_s, sent["cart_velocity"], obeyed, *columns)


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
