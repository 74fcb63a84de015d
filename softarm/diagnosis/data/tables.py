"""Reading of a rig's tables as trials, as its stage.yaml describes them."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softarm.common.quantity import factor
from softarm.diagnosis.data import checks, mocap, stage_rules, still_checks, table_checks, table_files
from softarm.diagnosis.data.skeleton import Skeleton
from softarm.diagnosis.data.stage_file import Recording, Stage, load, recordings
from softarm.diagnosis.data.still_checks import Columns
from softarm.diagnosis.data.table_files import Table
from softarm.diagnosis.data.trials import Series, TableStage, TableUnit, Trial, TrialError, stage_of
from softarm.schemas.stage_model import ModelValue
from softarm.schemas.trial import Mechanism, TableChannel

# Number of mistakes that are listed; the others are counted.
MISTAKES_SHOWN = 20
# Tolerance of a window's edges.
EDGE_S = 1e-6
# Share of rows without a reading from which there is a warning.
_MANY = 0.5

TableOf = Callable[[Path], Table]


def read(path: Path, data: Path | None = None) -> tuple[Trial, ...]:
    """Read every trial of a stage.yaml.

    With `elements` or `mechanisms` there is one trial for each, called `TRIAL/ELEMENT`. The tables are in `data`, by
    default the folder of the stage.yaml. Raises TrialError with one line for each mistake, with file, column and row.
    """
    base = path.parent if data is None else data
    described = load(path)
    skeletons = [mocap.skeleton_of(stage, base) for stage in described]
    stages = [*map(mocap.with_joints, described, skeletons)]
    _refuse_names(path, stages)
    _refuse_unknown_effects(path, stages)
    table_of = cache(partial(table_files.load, form=stages[0].form))  # a file that serves many trials is read once
    checked: dict[str, list[tuple[Trial, Columns]]] = {}  # by stage
    wrong: dict[str, None] = {}
    for raw, stage, skeleton in zip(described, stages, skeletons, strict=True):
        for recording in _split(recordings(path, base, raw), table_of):
            if isinstance(recording, TrialError):
                wrong[str(recording)] = None
                continue
            found: dict[int | None, _Read] = {}
            for element in stage.about.parts or ("",):
                place = stage.about.elements.get(element)
                try:
                    if place not in found:  # all joints of a model share their rows
                        found[place] = _read(raw.about, recording, place, table_of, skeleton)
                    trial = _trial(stage, recording, element, base, found[place])
                except TrialError as error:
                    wrong[str(error)] = None
                    continue
                # Joints by motion capture are in the file of the tracked points.
                at = Columns(stage.about, {"measured": recording.files.get("mocap", trial.source), **recording.files})
                mistakes, odd = table_checks.judge(trial, at)
                wrong |= dict.fromkeys(mistakes)
                if not mistakes:
                    own = checked.setdefault(stage_of([trial]).name, [])
                    own.append((replace(trial, warnings=(*trial.warnings, *odd)), at))
    trials: list[Trial] = []
    for own in checked.values():
        kept, mistakes = still_checks.moving(own)
        trials += kept
        wrong |= dict.fromkeys(mistakes)
    if wrong:
        shown = [*wrong][:MISTAKES_SHOWN]
        if more := len(wrong) - len(shown):
            shown.append(f"{path}: and {more} more; correct these first")
        raise TrialError("\n".join(shown))
    return tuple(trials)


def _refuse_names(path: Path, stages: Sequence[Stage]) -> None:
    """Raise TrialError if a part's name holds a dot, or two mechanisms share one, such as a joint of equal arms."""
    owner: dict[str, str] = {}
    for stage in stages:
        for name in stage.about.parts or (stage.name,):
            if "." in name:
                raise TrialError(
                    f"{path}: {name}: its name holds a dot, which separates the parts of an effect's name; rename it, "
                    "a joint also in its model"
                )
            if (other := owner.setdefault(name, stage.name)) != stage.name:
                raise TrialError(
                    f"{path}: mechanisms {other} and {stage.name} both have {name}; allowed is one; rename it in one "
                    "of them, or give each a stage.yaml of its own and diagnose each alone"
                )


def _refuse_unknown_effects(path: Path, stages: Sequence[Stage]) -> None:
    """Raise TrialError if the nominal model has an effect of a mechanism that the file does not describe."""
    names = [name for stage in stages for name in stage.about.parts or (stage.name,)]
    for effect in stages[0].effects:
        if (own := effect.rpartition(".")[0]) not in names:
            raise TrialError(f"{path}: effects: {effect}: no mechanism {own}; allowed {', '.join(names)}; correct it")


def _split(found: Iterable[Recording | TrialError], table_of: TableOf) -> Iterator[Recording | TrialError]:
    """Yield recordings, those of several trials in one file split by their column."""
    for recording in found:
        if isinstance(recording, TrialError) or recording.about.split is None:
            yield recording
            continue
        try:
            tables = [table_of(path) for path in recording.files.values()]
            for number in np.unique(table_files.readings(tables[0], recording.about.split, blank=False)):
                yield replace(recording, name=f"{recording.name}-{number:.15g}", only=float(number))
        except TrialError as error:
            yield error


@dataclass(frozen=True, slots=True)
class _Read:
    """Channels of one recording, why others are missing, and warnings."""

    channels: dict[str, Series]
    missing: dict[str, str]
    warnings: tuple[str, ...]


def _read(
    about: Mechanism, recording: Recording, place: int | None, table_of: TableOf, skeleton: Skeleton | None
) -> _Read:
    """Return the channels of a recording; place: index in the lists that cells hold."""
    read: dict[str, _Rows] = {}
    channels: dict[str, Series] = {}
    missing: dict[str, str] = {}
    warnings: list[str] = []
    zoned: dict[bool | None, str] = {}
    for name, channel in about.channels.items():
        if name not in recording.files:
            missing[name] = f"trial {recording.name} names no file for it"
            continue
        path = recording.files[name]
        read[name], found, zone = _rows(table_of(path), channel, recording, place)
        zoned.setdefault(zone, f"{path}: column {channel.time.source}")
        warnings += found
    for name, rows in _within(read, recording).items():
        path, drive, stamps = recording.files[name], name in still_checks.DRIVES, about.channels[name].time
        warnings += table_checks.clock(rows.series.t_s, stamps, f"{path}: column {stamps.source}", rows.place, drive)
        channels[name], odd = checks.tidy_stamps(rows.series, f"{path}: {name}", gaps=not drive)
        warnings += (*odd, *table_checks.ranges(channels[name], about.kind, about.channels[name], f"{path}: {name}"))
    if True in zoned and False in zoned:
        raise TrialError(
            f"{zoned[True]} has time zones, {zoned[False]} has none; write both with time zones, or both without"
        )
    if about.angles == "relative":
        channels["measured"] = _absolute(channels["measured"], about.links)
    if skeleton is not None:
        tracked, where = channels.pop("mocap"), recording.files["mocap"]
        if "base" in missing:
            raise TrialError(
                f"{where}: trial {recording.name} names no file for the base channel; add it, since its joints may "
                "carry the tracked points"
            )
        known = [channels[name] for name in ("measured", "base") if name in channels]
        measured, lost = mocap.positions(skeleton, tracked, known, where)
        if "measured" in channels:
            measured = mocap.joined(measured, channels["measured"], where)
        warnings += lost
        channels = {**channels, "measured": measured}
    return _Read(channels, missing, tuple(warnings))


def _trial(stage: Stage, recording: Recording, element: str, base: Path, read: _Read) -> Trial:
    about = stage.about
    units = {
        name: {column: TableUnit(each.unit, *factor(each.unit)) for column, each in channel.columns.items()}
        for name, channel in about.channels.items()
    }
    own = element or stage.name
    named = ((*effect.rpartition("."), of) for effect, of in stage.effects.items())
    effects = {effect: of for mechanism, _, effect, of in named if mechanism == own}
    model = _in_standard_units(about, units)
    if about.kind == "mujoco":
        units["measured"] = {own: units["measured"][own]}
        model = {"mjcf": str(stage.file(str(about.model["mjcf"]), base))}
    name = f"{recording.name}/{own}" if element or stage.several else recording.name
    return Trial(
        name,
        recording.kind,
        next(iter(recording.files.values())),
        read.channels,
        "free",
        TableStage(own, about.kind, model, units, about.angles == "relative", effects),
        read.warnings,
        read.missing,
    )


@dataclass(frozen=True, slots=True)
class _Rows:
    """Rows of a channel in the order of the file, with stamps that are not checked yet."""

    series: Series
    rows: NDArray[np.intp]
    table: Table

    def place(self, index: int) -> int:
        """Return the number of a row in the file, for messages."""
        return self.table.place(int(self.rows[index]))


def _rows(
    table: Table, channel: TableChannel, recording: Recording, element: int | None
) -> tuple[_Rows, list[str], bool | None]:
    """Rows of a channel with a reading in every column, warnings about the others, and the time zones of its stamps."""
    segment = recording.about.segment
    if element is not None and not any(table_files.holds_lists(table, c, segment) for c in channel.columns.values()):
        source = next(iter(channel.columns.values())).source
        raise TrialError(
            f"{table.path}: column {source} contains plain numbers, not lists; leave `elements` out, or name another "
            "column"
        )
    stamps = table_files.stamps(table, channel.time, segment)
    columns = {n: table_files.column(table, column, segment, element) for n, column in channel.columns.items()}
    time, zoned = stamps or (table_files.counted(channel.time, len(next(iter(columns.values())))), None)
    warnings = []
    keep = np.isfinite(time)
    if recording.about.split is not None:
        keep &= table_files.readings(table, recording.about.split, blank=False) == recording.only
    for name, values in columns.items():
        if len(values) != len(time):
            raise TrialError(
                f"{table.path}: column {name} has {len(values)} rows, the time column {len(time)}; complete it"
            )
        gone = ~np.isfinite(values)
        source = channel.columns[name].source
        if gone.all():
            raise TrialError(
                f"{table.path}: column {source} has no value in any row; leave it out of the stage.yaml, or this trial"
            )
        if gone.mean() > _MANY:
            warnings.append(
                f"{table.path}: column {source} has no value in {gone.mean():.0%} of the rows, which are left out; "
                f"leave the column out if {name} is not needed"
            )
        keep &= ~gone
    if not keep.any():
        raise TrialError(f"{table.path}: no row has a value in every column; leave columns out of the stage.yaml")
    rows = np.flatnonzero(keep)
    series = Series(time[rows], {name: values[rows] for name, values in columns.items()})
    return _Rows(series, rows, table), warnings, zoned


def _within(channels: dict[str, _Rows], recording: Recording) -> dict[str, _Rows]:
    """Channels in the window of a trial; one that drives the rig keeps its last value from before."""
    from_s, to_s = recording.about.from_s, recording.about.to_s
    if from_s == 0 and to_s is None:
        return channels
    first = min(float(rows.series.t_s[0]) for rows in channels.values())
    last = max(float(rows.series.t_s.max()) for rows in channels.values())
    low, high = first + from_s, math.inf if to_s is None else first + to_s
    if low >= last:
        raise TrialError(
            f"{next(iter(recording.files.values()))}: trial {recording.name}: from_s is {from_s:g}, but the "
            f"recording lasts {last - first:.4g} s; allowed below {last - first:.4g} s; correct it"
        )
    found = {}
    for name, each in channels.items():
        t, columns = each.series.t_s, each.series.columns
        # Stamps are rounded in the file, so a row on an edge may be a little beyond it.
        keep = (t >= low - EDGE_S) & (t <= high + EDGE_S)
        before = np.flatnonzero(t < low - EDGE_S)
        if name in still_checks.DRIVES and before.size and not np.any(keep & (t <= low + EDGE_S)):
            keep[before[np.argmax(t[before])]], t = True, np.maximum(t, low)
        if not keep.any():
            raise TrialError(
                f"{recording.files[name]}: trial {recording.name}: no row of the {name} channel is between from_s "
                "and to_s; allowed a part that holds rows; correct them"
            )
        series = Series(t[keep], {column: values[keep] for column, values in columns.items()})
        found[name] = _Rows(series, each.rows[keep], each.table)
    return found


def _in_standard_units(about: Mechanism, units: Mapping[str, Mapping[str, TableUnit]]) -> Mapping[str, ModelValue]:
    """Model of a stage with the parameters of a tracking stage converted from its columns' units."""
    if about.kind != "tracking":
        return about.model
    followed = stage_rules.followed(units["measured"]) or ""
    to, from_ = units["measured"][followed].factor, units["command"]["command"].factor
    factors = {"gain": to / from_, "offset": to, "rate_limit": to, "acceleration_limit": to}
    return {key: _times(value, factors.get(key, 1.0), from_, to) for key, value in about.model.items()}


def _times(value: ModelValue, by: float, from_: float, to: float) -> ModelValue:
    if isinstance(value, tuple):  # a map
        return tuple((command * from_, reached * to) for command, reached in value)  # type: ignore[misc]
    return value if isinstance(value, str) else value * by


def _absolute(series: Series, links: int) -> Series:
    """Absolute angles and rates from relative ones; a rate is left out if one before it is missing."""
    columns = dict(series.columns)
    for name in ("angle", "rate"):
        own = [columns.pop(f"{name}{i}", None) for i in range(1, links + 1)]
        total = np.zeros(len(series))
        for i, each in enumerate(own, 1):
            if each is None:
                break
            total = total + each
            columns[f"{name}{i}"] = total
    return Series(series.t_s, columns)
