"""Survey of a rig's recordings: files of one form, recordings, and the facts of every column."""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from softarm.diagnosis.data import bags, table_files
from softarm.diagnosis.data.stage_file import kind_of
from softarm.diagnosis.data.still_checks import spread
from softarm.diagnosis.data.trials import Array, TrialError
from softarm.diagnosis.describe import headers
from softarm.diagnosis.describe.headers import Header
from softarm.schemas.trial import TableForm

ROWS_LEAST = 20
# Lines above the header of a logger's file that are tried.
SKIP_MAX = 20
# Rows of a .mat matrix that may be signals.
SIGNALS_MAX = 24
# Share of a column's cells that must be numbers.
NUMBERS_LEAST = 0.5
MARKS_MAX = 4
# Numbers that loggers write for a missing value, and the jump to them in usual steps.
_MARKS = (0.0, -1.0, 999.0, 9999.0, 99999.0, 65535.0, 32767.0, -32768.0, -99.0, -999.0, -9999.0, -99999.0)
_JUMP = 6.0
# Levels of a column that is no switch.
_LEVELS_LEAST = 20
# Columns that files of one form share; files of two devices share fewer, such as the time.
_SHARED_LEAST = 3
# Rows in a row that a dropout lasts, where its mark may also be a reading.
RUN_MAX = 20

# Source of a column, row of a .mat matrix, and header.
Key = tuple[str | int, int | None, str]


@dataclass(frozen=True, slots=True)
class Signal:
    """One column, in every recording."""

    source: str | int  # as a stage.yaml names it
    header: Header
    group: int  # of files with the same columns
    label: str  # for messages and options: the source, with its file where several have such a column
    values: tuple[Array, ...]  # of each recording, NaN where missing; of lists the first element that moves
    row: int | None = None
    marks: tuple[str | float, ...] = ()  # cells that mean "not measured"
    elements: int = 0  # of the lists in its cells
    dates: bool = False

    @property
    def names(self) -> tuple[str, str, str]:
        """Return the texts by which a user may name the column."""
        return self.label, str(self.source), self.header.name

    @property
    def all(self) -> Array:
        """Return the readings of all recordings."""
        found = np.concatenate(self.values)
        return found[np.isfinite(found)]

    @property
    def is_constant(self) -> bool:
        """Return whether no reading differs from the first."""
        return not spread(self.all)

    @property
    def described(self) -> str:
        """Return the label, with a note if the column is constant."""
        label = self.label or '""'
        return f"{label} (constant)" if self.is_constant else label


@dataclass(frozen=True, slots=True)
class Recorded:
    """One recording, with its file for each group of columns."""

    name: str
    kind: str
    files: Mapping[int, Path]
    segment: str | None = None


@dataclass(frozen=True, slots=True)
class Survey:
    """Recordings of a rig and their columns."""

    recordings: tuple[Recorded, ...]
    signals: tuple[Signal, ...]
    form: TableForm
    unused: tuple[str, ...]  # files and columns without numbers, each with its reason


@dataclass(frozen=True, slots=True)
class _File:
    path: Path
    columns: Mapping[Key, Any]  # raw values
    segment: str | None
    comma: bool


def survey(paths: Sequence[Path]) -> Survey:
    """Read every recording and its columns.

    Raises TrialError if there is no table, or files belong to no common recording.
    """
    form, unused, files = TableForm(), Counter[str](), list[_File]()
    for path, named in tables(paths):
        try:
            found, form = _load(path, form)
        except TrialError as error:
            if named:
                raise
            unused[f"{path.name}: {str(error).removeprefix(f'{path}: ')}"] += 1
            continue
        files += found
    files = [replace(f, columns={k: raw for k, raw in f.columns.items() if _is_numeric(raw, f.comma)}) for f in files]
    for each in [each for each in files if len(each.columns) < 2]:
        unused[f"{each.path.name}: has no two columns of numbers"] += 1
        files.remove(each)
    if not files:
        raise TrialError("\n".join([f"{paths[0]}: no file has two columns of numbers; name others", *_counted(unused)]))
    members, alone = _paired(files)
    for each in alone:
        unused[f"{each.path.name}: has no file with the other columns"] += 1
    count = Counter(key for file in members[0].values() for key in file.columns)
    signals = []
    for k, file in members[0].items():
        for key in file.columns:
            label = str(key[0]) if key[1] is None else f"{key[0]}#{key[1]}"
            label = label if count[key] == 1 else f"{file.path.stem}:{label}"
            signals.append(_signal(k, key, label, [each[k].columns[key] for each in members], file.comma))
    return Survey(_recordings(members), tuple(signals), form, tuple(_counted(unused)))


def _counted(reasons: Mapping[str, int]) -> list[str]:
    return [f"{reason} ({count} files)" if count > 1 else reason for reason, count in reasons.items()]


def tables(paths: Iterable[Path]) -> Iterator[tuple[Path, bool]]:
    """Yield the table files of files and folders, and whether each was named itself."""
    for path in paths:
        if (path / "trial.yaml").is_file():
            raise TrialError(f"{path}: a trial of the robot; `softarm diagnose` reads it without a stage file")
        if path.is_dir():
            inside = sorted(p for p in path.rglob("*") if p.is_file() and p.suffix.lower() in table_files.SUFFIXES)
            if not inside:
                raise TrialError(f"{path}: contains no table ({', '.join(table_files.SUFFIXES)}); name another folder")
            yield from ((each, False) for each in inside)
        elif not path.exists():
            raise TrialError(f"{path}: does not exist; name the files or folders of your recordings")
        elif path.suffix.lower() not in table_files.SUFFIXES:
            raise TrialError(
                f"{path}: no table; tables are {', '.join(table_files.SUFFIXES)}; export it as one of these"
            )
        else:
            yield path, True


def _load(path: Path, form: TableForm) -> tuple[list[_File], TableForm]:
    """Columns of a file, and the form of text tables that reads it."""
    table, first = None, TrialError()
    for skip in (form.skip, *(k for k in range(SKIP_MAX) if k != form.skip)):
        try:
            table = table_files.load(path, form.model_copy(update={"skip": skip}))
        except TrialError as error:
            first = first if first.args else error
            if path.suffix.lower() not in table_files.TEXT or " cells, " not in str(error):
                break
            continue
        form = form.model_copy(update={"skip": skip})
        break
    if table is None:
        raise first
    if path.suffix.lower() == ".mat":
        return list(_of_matlab(path, table.columns)), form
    if path.suffix.lower() in bags.SUFFIXES:
        return list(_of_bag(path, table.columns)), form
    texts = (cell for cells in table.columns.values() if isinstance(cells, list) for cell in cells[:ROWS_LEAST])
    if not table.comma and form.decimal is None and any(re.fullmatch(r"-?\d+,\d+", cell.strip()) for cell in texts):
        return _load(path, form.model_copy(update={"decimal": ","}))
    named = table.named
    columns: dict[Key, Any] = {
        (name if named else int(name), None, name if named else ""): raw for name, raw in table.columns.items()
    }
    return [_File(path, columns, None, table.comma)], form


def _of_bag(path: Path, columns: Mapping[str, Any]) -> Iterator[_File]:
    """Yield the columns of each topic of a bag, which share a clock."""
    topics: dict[str, dict[Key, Any]] = {}
    for name, values in columns.items():
        topics.setdefault(bags.topic_of(name, columns), {})[(name, None, name)] = values
    for own in topics.values():
        yield _File(path, own, None, False)


def _of_matlab(path: Path, variables: Mapping[str, Any]) -> Iterator[_File]:
    """Signals of a .mat file; cells of several recordings become segments."""
    plain: dict[Key, Any] = {}
    cells: dict[str, list[Any]] = {}
    for source, values in (leaf for name, value in variables.items() for leaf in _leaves(name, value)):
        if isinstance(values, list):
            cells[source] = values
        else:
            plain |= _rows(source, values)
    # Signals of one length share a clock.
    for rows in dict.fromkeys(map(len, plain.values())):
        if len(own := {key: values for key, values in plain.items() if len(values) == rows}) > 1:
            yield _File(path, own, None, False)
    # Y_id and Time_id are one recording; their segments replace {segment} in Y_{segment}.
    ends = {name: name.rpartition("_")[2] for name in cells}
    for end in dict.fromkeys(ends.values()):
        parts = {name: values for name, values in cells.items() if ends[name] == end}
        for i in range(min(map(len, parts.values()))):
            found: dict[Key, Any] = {}
            for name, values in parts.items():
                found |= _rows(f"{name.removesuffix(end)}{{segment}}", np.squeeze(values[i]))
            yield _File(path, found, f"{end}[{i}]", False)


def _leaves(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield arrays of numbers with their paths, and lists of arrays in cells."""
    while isinstance(value, np.ndarray) and value.dtype == object and value.size == 1:
        value = value.reshape(-1)[0]
    if not isinstance(value, np.ndarray | np.void):
        return
    if value.dtype.names:
        if isinstance(value, np.void) or value.size == 1:
            for inner in value.dtype.names:
                yield from _leaves(f"{name}.{inner}", value[inner])
    elif value.dtype == object:
        if all(isinstance(each, np.ndarray) and each.dtype.kind in "fiu" for each in value.reshape(-1)):
            yield name, list(value.reshape(-1))
    elif value.dtype.kind in "fiu":
        yield name, np.squeeze(value)


def _rows(source: str, values: Any) -> dict[Key, Any]:
    """Signals of an array: itself, or the rows of a wide matrix."""
    if values.ndim == 1 and len(values) >= ROWS_LEAST:
        return {(source, None, source.replace("{segment}", "")): values}
    if values.ndim == 2 and values.shape[0] <= SIGNALS_MAX < values.shape[1]:
        return {(source, i, source.replace("{segment}", "")): row for i, row in enumerate(values)}
    return {}


def _is_numeric(raw: Any, comma: bool) -> bool:
    if isinstance(raw, list):
        good = sum(table_files.number(cell, comma) is not None or table_files.instant(cell) is not None for cell in raw)
        return good >= NUMBERS_LEAST * len(raw)
    if raw.dtype == object:
        if not all(isinstance(each, list | np.ndarray) for each in raw) or len({len(each) for each in raw}) > 1:
            return False
        return len(raw[0]) > 0 and np.asarray(list(raw)).dtype.kind in "fiu"
    return raw.dtype.kind in "fiubM"


def _paired(files: Sequence[_File]) -> tuple[list[dict[int, _File]], list[_File]]:
    """Files of each recording by the group of files with the same columns, and the files without a partner.

    If no recording has files of several groups, the common columns of all files form one group.
    """
    found: dict[tuple[object, ...], list[_File]] = {}
    for file in files:
        found.setdefault(tuple(file.columns), []).append(file)
    groups = list(found.values())
    if len(groups) == 1:
        return [{0: file} for file in files], []
    common = [key for key in groups[0][0].columns if all(key in each.columns for each in files)]
    keyed = _keys(groups)
    if keyed is None or len(common) >= _SHARED_LEAST:
        if len(common) < 2:
            named = "; ".join(f"{g[0].path}: {', '.join(str(key[0]) for key in g[0].columns)}" for g in groups)
            raise TrialError(f"files with different columns do not pair up: {named}; name the files of one form")
        return [{0: replace(file, columns={key: file.columns[key] for key in common})} for file in files], []
    both = [key for key in keyed[0] if all(key in other for other in keyed)]
    alone = [file for own in keyed for key, file in own.items() if key not in both]
    return [{k: own[key] for k, own in enumerate(keyed)} for key in both], alone


def _keys(groups: Sequence[Sequence[_File]]) -> list[dict[str, _File]] | None:
    """Files of each group by the text that pairs them with those of other groups; None if they do not pair up."""
    if all(len(group) == 1 for group in groups):
        same = len({group[0].path.parent for group in groups}) == 1
        return [{"": group[0]} for group in groups] if same else None
    for key in (_by_folder, _by_name):
        found = [key(group) for group in groups]
        if all(len(own) == len(group) for own, group in zip(found, groups, strict=True)) and set.intersection(
            *map(set, found)
        ):
            return found
    return None


def _by_folder(group: Sequence[_File]) -> dict[str, _File]:
    return {file.path.parent.as_posix(): file for file in group}


def _by_name(group: Sequence[_File]) -> dict[str, _File]:
    """Files by the part of their names that differs."""
    stems = [file.path.stem for file in group]
    lead = len(common_start(stems))
    trail = len(common_start([stem[lead:][::-1] for stem in stems]))
    return {
        f"{file.path.parent.as_posix()}/{stem[lead : len(stem) - trail]}": file
        for stem, file in zip(stems, group, strict=True)
    }


def common_start(texts: Sequence[str]) -> str:
    """Return the text with which all texts begin."""
    low, high = min(texts), max(texts)
    return low[: next((i for i, (a, b) in enumerate(zip(low, high, strict=False)) if a != b), len(low))]


def _recordings(members: Sequence[Mapping[int, _File]]) -> tuple[Recorded, ...]:
    """Recordings with a name of their own and their files by group."""
    names = [_name(each) for each in members]
    count = Counter(names)
    found: list[Recorded] = []
    for name, each in zip(names, members, strict=True):
        file = each[0]
        own = name if count[name] == 1 else f"{file.path.parent.name}-{name}"
        own = own if all(each.name != own for each in found) else f"{own}-{len(found) + 1}"
        files = {k: f.path for k, f in each.items()}
        found.append(Recorded(own, kind_of(name if file.segment is None else file.path.stem), files, file.segment))
    return tuple(found)


def _name(files: Mapping[int, _File]) -> str:
    path, segment = files[0].path, files[0].segment
    if segment is not None:
        return f"{path.stem}-{segment.translate(str.maketrans('[', '-', ']'))}"
    if len(files) == 1:
        return path.stem
    names = [file.path.stem for file in files.values()]
    common = common_start(names)
    return common.rstrip("_-. ") or path.parent.name if common.endswith(("_", "-", ".", " ")) else path.parent.name


def _signal(group: int, key: Key, label: str, raws: Sequence[Any], comma: bool) -> Signal:
    source, row, text = key
    header, marks, dates, elements = headers.read(text), dict[str | float, None](), False, 0
    values = []
    for raw in raws:
        if isinstance(raw, list):
            read, own = _texts(raw, comma)
            dates = dates or any(table_files.instant(cell) for cell in raw[:3])
            # A row of units below the header.
            if header.unit is None and own and (unit := headers.unit_named(raw[0])) and raw[0].strip() in own:
                header = headers.read(f"{text} [{unit}]")
            marks |= dict.fromkeys(own)
        elif raw.dtype == object:
            lists = np.array([np.asarray(cell, dtype=float) for cell in raw])
            elements = lists.shape[1]
            read = lists[:, int(np.argmax(np.ptp(lists, axis=0) > 0))]
        elif raw.dtype.kind == "M":
            read, dates = (raw - np.datetime64(0, "s")) / np.timedelta64(1, "s"), True
        else:
            read = raw.astype(float)
            marks |= dict.fromkeys(["nan"] if np.isnan(read).any() else [])
        values.append(read)
    if header.role != "time" and not dates:
        for mark in _marks(values):
            marks[int(mark) if mark == int(mark) else mark] = None
            values = [np.where(each == mark, np.nan, each) for each in values]
    return Signal(source, header, group, label, tuple(values), row, tuple(marks), elements, dates)


def _texts(cells: Sequence[str], comma: bool) -> tuple[Array, list[str]]:
    """Texts as numbers, and the texts that are none."""
    read = [table_files.number(cell, comma) for cell in cells]
    if all(each is None for each in read[:3]) and any(table_files.instant(cell) for cell in cells[:3]):
        read = [None if (at := table_files.instant(cell)) is None else table_files.unix_s(at) for cell in cells]
    gone = {cell.strip() for cell, value in zip(cells, read, strict=True) if value is None or not np.isfinite(value)}
    values = np.array([np.nan if each is None else each for each in read], dtype=float)
    return np.where(np.isfinite(values), values, np.nan), sorted(gone)[:MARKS_MAX]


def _marks(values: Sequence[Array]) -> Iterator[float]:
    """Yield numbers that stand for a missing value: the column jumps to them from afar, and back."""
    joined = np.concatenate(values)
    joined = joined[np.isfinite(joined)]
    for mark in _MARKS:
        here = joined == mark
        rest = joined[~here]
        if not here.any() or here.mean() > NUMBERS_LEAST or len(np.unique(rest)) < _LEVELS_LEAST:
            continue
        if mark < rest.min() - np.ptp(rest) or mark > rest.max() + np.ptp(rest):
            yield mark
            continue
        # A number that readings may have: each run of it is short, and the column goes on where it was.
        starts = np.flatnonzero(here[1:] & ~here[:-1])
        ends = np.flatnonzero(~here[1:] & here[:-1]) + 1
        if here[0] or here[-1] or int((ends - starts).max()) > RUN_MAX:
            continue
        usual = float(np.quantile(np.abs(np.diff(rest)), 0.99))
        before, after = joined[starts] - mark, joined[ends] - mark
        jumps = np.minimum(np.abs(before), np.abs(after))
        if usual > 0 and jumps.min() > _JUMP * usual and np.all(np.abs(before - after) < jumps / 4):
            yield mark
