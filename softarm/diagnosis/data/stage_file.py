"""Reading of a stage.yaml and of the trials that it lists, one for each file that a pattern matches."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from softarm.common import files, yaml_lines
from softarm.common.words import did_you_mean, nearest
from softarm.common.yaml_lines import FileError
from softarm.common.yaml_schema import fit
from softarm.diagnosis.data import stage_rules
from softarm.diagnosis.data.trials import TrialError
from softarm.schemas.stage_model import CHANNELS
from softarm.schemas.trial import Effects, Mechanism, SeveralFile, StageFile, TableForm, TableTrial

EXAMPLE = "one of diagnosis/rigs/stages/*.yaml"
_STAR = re.compile(r"\*+|\?|\[!?[^!\]][^\]]*\]")


@dataclass(frozen=True, slots=True)
class Recording:
    """One trial of one mechanism, with its file for each channel."""

    name: str
    kind: str
    files: Mapping[str, Path]
    about: TableTrial
    only: float | None = None  # number of this trial in the column by which its file is split


@dataclass(frozen=True, slots=True)
class Stage:
    """One mechanism of a stage.yaml, with its trials as they are written there."""

    name: str
    about: Mechanism
    form: TableForm
    trials: tuple[TableTrial, ...]
    effects: Effects  # of all mechanisms of the file
    several: bool  # whether the file describes several mechanisms; names of trials then contain the mechanism
    folder: Path  # of the stage.yaml

    def file(self, name: str, data: Path) -> Path:
        """Return the path of a file that the stage.yaml names, in its own folder or else in the data folder."""
        own = self.folder / name
        return (own if files.exists(own) else data / name).resolve()


def is_stage(path: Path) -> bool:
    """Return whether a YAML file describes tables of a rig, valid or not; a robot configuration has no such keys."""
    try:
        data = yaml_lines.read(path, "").data
    except FileError:
        return False
    return isinstance(data, dict) and bool({"channels", "mechanisms", "trials"} & data.keys())


def load(path: Path) -> tuple[Stage, ...]:
    """Read a stage.yaml; raise TrialError with every mistake on a line of its own."""
    try:
        document = yaml_lines.read(path, f"write one, e.g. {EXAMPLE}")
        several = _is_of_several(document.data)
        for _, about in stage_rules.mechanisms(document.data):
            if about.get("model", ...) is None:  # all keys are commented out
                about["model"] = {}
        more = stage_rules.findings(document.data)
        if several:
            whole = fit(document, SeveralFile, more)
            lacking = [name for name, each in whole.mechanisms.items() if not each.trials and not whole.trials]
            if lacking:
                raise TrialError(
                    f"{path}: trials: {', '.join(lacking)} has none; add `trials`, there or for all mechanisms"
                )
            stages = tuple(
                Stage(name, each, whole.table, each.trials or whole.trials, whole.effects, True, path.parent)
                for name, each in whole.mechanisms.items()
            )
        else:
            one = fit(document, StageFile, more)
            stages = (Stage(one.name or called(path), one, one.table, one.trials, one.effects, False, path.parent),)
    except FileError as error:
        raise TrialError(str(error)) from None
    return stages


def called(path: Path) -> str:
    """Return the name of a mechanism without one: that of its file, or of the folder of a `stage.yaml`."""
    own = path.resolve()
    text = own.parent.name if own.stem == "stage" else own.stem
    return re.sub(r"\W+", "_", text).strip("_") or "stage"


def _is_of_several(data: Any) -> bool:
    return isinstance(data, dict) and "channels" not in data and nearest("mechanisms", map(str, data)) is not None


def recordings(path: Path, base: Path, stage: Stage) -> Iterator[Recording | TrialError]:
    """Yield every trial of a stage with its patterns expanded, or a TrialError instead of an invalid trial."""
    taken: dict[str, Path] = {}
    for trial in stage.trials:
        try:
            found = list(_recordings(path, base, stage.about, trial))
        except TrialError as error:
            yield error
            continue
        for each in found:
            if each.name in taken:
                own = next(iter(each.files.values()))
                other = f"{each.name}-2" if own.parent == taken[each.name].parent else f"{own.parent.name}-{each.name}"
                yield TrialError(
                    f"{path}: two trials are called {each.name}; give one of them another `name`, e.g. `name: {other}` "
                    f"for {own}"
                )
            taken[each.name] = next(iter(each.files.values()))
            yield each


def _recordings(path: Path, base: Path, about: Mechanism, trial: TableTrial) -> Iterator[Recording]:
    wanted = CHANNELS[about.kind]
    files = trial.files if isinstance(trial.files, dict) else dict.fromkeys(about.channels, trial.files)
    called = trial.name or (trial.files if isinstance(trial.files, str) else "")
    of = f"{path}: trial {called}" if called else f"{path}: trials"
    for name in files:
        if name not in about.channels:
            near = did_you_mean(name, about.channels)
            raise TrialError(
                f"{of}: files: no channel {name}; {near}the file describes {', '.join(about.channels)}; correct it"
            )
    for name in about.channels:
        if name not in files and not wanted[name].optional:
            raise TrialError(f"{of}: names no file for the {name} channel; add it under `files`")
    if trial.segment is not None and not _has_segment(about):
        raise TrialError(f"{of}: has a segment, but no `source` holds {{segment}}; put it there, or leave it out")
    stars = {name: pattern for name, pattern in files.items() if _STAR.search(pattern)}
    if not stars:
        first = Path(next(iter(files.values())))
        name = trial.name or (first.stem if trial.segment is None else f"{first.stem}-{trial.segment}")
        yield Recording(name, trial.kind or kind_of(name), {c: base / f for c, f in files.items()}, trial)
        return
    fitting = {name: _fitting(base, pattern) for name, pattern in stars.items()}
    for name, found in fitting.items():
        if not found:
            raise TrialError(
                f"{of}: files: no file matches {base / stars[name]}; correct the pattern or the data folder"
            )
    every = sorted(set().union(*fitting.values()))
    for starred in every:
        if lacking := [name for name, found in fitting.items() if starred not in found]:
            raise TrialError(
                f"{of}: files: there is no {base / _filled(stars[lacking[0]], starred)} for the other channels of "
                f"{'-'.join(starred)}; add it, or remove those"
            )
        own = "-".join(starred)
        name = f"{trial.name}-{own}" if trial.name else own
        place = {c: fitting[c][starred] if c in fitting else base / f for c, f in files.items()}
        yield Recording(name, trial.kind or kind_of(trial.name or own), place, trial)


def kind_of(name: str) -> str:
    """Return the kind of excitation that a trial's name suggests: the name without its number."""
    return re.sub(r"[\s_.\-]*\d+$", "", name) or name


def _has_segment(about: Mechanism) -> bool:
    columns = (each for channel in about.channels.values() for each in (channel.time, *channel.columns.values()))
    return any("{segment}" in str(column.source) for column in columns)


def _fitting(base: Path, pattern: str) -> dict[tuple[str, ...], Path]:
    """Files that match a pattern, by the text that its wildcards stand for."""
    plain, parts = Path(), list(Path(pattern).parts)
    if wrong := [part for part in parts if "**" in part and part != "**"]:
        raise TrialError(
            f"{base / pattern}: files: {wrong[0]} has ** within a name; allowed as a whole folder (**/*.csv), "
            "or * within a name; correct the pattern"
        )
    while not _STAR.search(parts[0]):  # folders before the first wildcard may lead anywhere
        plain /= parts.pop(0)
    base, pattern = base / plain, "/".join(parts)
    exact = re.compile(_as_expression(pattern))
    found = {}
    for file in sorted(base.glob(pattern)):
        if file.is_file() and (fits := exact.fullmatch(file.relative_to(base).as_posix())):
            found[tuple(part.replace("/", "-") for part in fits.groups() if part)] = file
    return found


def _as_expression(pattern: str) -> str:
    found, at = [], 0
    for star in _STAR.finditer(pattern):
        found.append(re.escape(pattern[at : star.start()]))
        at = star.end()
        if star[0].startswith("**"):  # no folder, or any number of them
            found.append("(.*?)/?" if pattern[at : at + 1] == "/" else "(.*)")
            at += pattern[at : at + 1] == "/"
        else:
            letters = star[0].replace("[!", "[^", 1)
            found.append({"*": "([^/]*)", "?": "([^/])"}.get(star[0], f"({letters})"))
    return "".join(found) + re.escape(pattern[at:])


def _filled(pattern: str, starred: tuple[str, ...]) -> str:
    each = iter(starred)
    return _STAR.sub(lambda star: next(each, star[0]), pattern)
