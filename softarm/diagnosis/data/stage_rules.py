"""Rules for a stage.yaml beyond its schema: channels, columns and units of its kind, and its model's keys."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any, get_args

from softarm.common.quantity import PURE, factor
from softarm.common.words import did_you_mean
from softarm.common.yaml_lines import Place
from softarm.schemas.stage_model import CHANNELS, COLUMN_UNITS, LINKS_MAX, StageKind, complaints

# Ends of the columns of a floating body's or ball joint's orientation.
QUATERNION = ("_qw", "_qx", "_qy", "_qz")
# Units of the columns of a MuJoCo model's joints, by channel.
_JOINT_UNITS = {"measured": ("rad", "m"), "base": ("rad", "m"), "torque": ("N m", "N"), "mocap": ("m",)}

Findings = dict[Place, Callable[[], str]]


def findings(data: Any) -> Findings:
    """Return the mistakes in a file's plain data by place; malformed values are left to the schema."""
    found: Findings = {}
    for place, about in mechanisms(data):
        links = about.get("links", 1)
        kind: StageKind | None = next((kind for kind in get_args(StageKind) if kind == about.get("kind")), None)
        if kind is None or not isinstance(links, int) or not 1 <= links <= LINKS_MAX:
            continue
        model = about.get("model") or {}
        for each in (
            _model(kind, model, links),
            _channels(kind, _group(about, "channels"), links),
            _units(kind, _group(about, "channels")),
            _fitting(kind, _group(about, "channels"), model),
            _angles(kind, about),
        ):
            for where, text in each:
                found.setdefault((*place, *where), partial(str, text))
    return found


def mechanisms(data: Any) -> Iterator[tuple[Place, dict[str, Any]]]:
    """Yield every group of a file that describes a mechanism, with its place."""
    if not isinstance(data, dict):
        return
    if "mechanisms" not in data:
        yield (), data
        return
    for name in (several := _group(data, "mechanisms")):
        if isinstance(several[name], dict):
            yield ("mechanisms", name), several[name]


def standard_unit(column: Mapping[str, Any]) -> str | None:
    """Return the standard unit for a column's unit, or None if the unit is unknown."""
    try:
        return factor(column["unit"])[1]
    except (KeyError, TypeError, ValueError, AttributeError):
        return None


def _group(data: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    found = data.get(name)
    return found if isinstance(found, dict) else {}


def _columns(channels: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    return _group(_group(channels, name), "columns")


def _model(kind: StageKind, model: Any, links: int) -> Iterator[tuple[Place, str]]:
    if isinstance(model, dict):
        for key, text in complaints(kind, model, links):
            yield (("model", key) if key else ("model",)), text


def _channels(kind: StageKind, channels: Mapping[str, Any], links: int) -> Iterator[tuple[Place, str]]:
    """Channels and columns that are unknown to the kind of stage, or missing."""
    for name in channels:
        if name not in CHANNELS[kind]:
            near = did_you_mean(name, CHANNELS[kind])
            yield (
                ("channels", name),
                f"unknown channel; {near}a {kind} stage has {', '.join(CHANNELS[kind])}; call it one of these",
            )
    for name, channel in CHANNELS[kind].items():
        columns, known = _columns(channels, name), channel.columns(links)
        for column in columns:
            if not channel.named_after and column not in known:
                near = did_you_mean(column, known)
                yield (
                    ("channels", name, "columns", column),
                    f"unknown column; {near}{name} of a {kind} stage has {', '.join(known)}; call it one of these",
                )
        if name not in channels:
            others = {channel.instead_of, *(n for n, each in CHANNELS[kind].items() if each.instead_of == name)}
            if not channel.optional and not others & channels.keys():
                wanted = _any(channel.needed(links)) or f"for each {channel.named_after}"
                yield ("channels",), f"a {kind} stage needs a channel {name} with a column {wanted}; add it"
        elif channel.named_after:
            continue
        elif channel.any_of[0].startswith("angle"):
            lacking = [f"angle{i}" for i in range(1, links + 1) if f"angle{i}" not in columns]
            if lacking:
                yield (
                    ("channels", name),
                    f"links is {links}, but there is no column {', '.join(lacking)}; add it, or correct `links`",
                )
        elif not set(channel.needed(links)) & columns.keys() and not columns.keys() - set(known):
            yield ("channels", name), f"a {kind} stage needs a column {_any(channel.needed(links))} there; add it"


def _units(kind: StageKind, channels: Mapping[str, Any]) -> Iterator[tuple[Place, str]]:
    """Units that do not fit the column's name."""
    for name, channel in channels.items():
        if not isinstance(channel, dict):
            continue
        unit = standard_unit(_group(channel, "time"))
        if unit not in (None, "s"):
            yield ("channels", name, "time", "unit"), f"is a unit of {unit}, not of time; write s, ms, us or ns"
        for column, about in _columns(channels, name).items():
            unit = standard_unit(about) if isinstance(about, dict) else None
            allowed = COLUMN_UNITS.get(column.rstrip("0123456789"), ())
            allowed = ("m",) if name == "base" else allowed
            if kind == "mujoco":  # columns have the names of joints and actuators
                allowed = _JOINT_UNITS.get(name, ())
                if name in ("base", "mocap") and column.endswith(QUATERNION):
                    allowed = (PURE,)
            if unit and allowed and unit not in allowed:
                yield (
                    ("channels", name, "columns", column, "unit"),
                    f"is {about['unit']}, not a unit of {column.rstrip('0123456789')}; allowed are units of "
                    f"{_any(allowed)}; correct it, or give the column its right name",
                )


def _fitting(kind: StageKind, channels: Mapping[str, Any], model: Any) -> Iterator[tuple[Place, str]]:
    """Units of columns that do not match each other or the model."""
    model = model if isinstance(model, dict) else {}
    measured = _columns(channels, "measured")
    units = {name: standard_unit(about) for name, about in measured.items() if isinstance(about, dict)}
    if kind == "tracking":
        column = followed(measured)
        command = _group(_columns(channels, "command"), "command")
        from_, to = standard_unit(command), units.get(column) if column else None
        if column and from_ and to and from_ != to and not {"gain", "map"} & model.keys():
            same = next((name for name, unit in units.items() if unit == from_), None)
            yield (
                ("model",),
                f"the command is in {command['unit']}, the measured {column} in {measured[column]['unit']}: write "
                f"`gain` ({measured[column]['unit']} for one {command['unit']}) or `map`, or correct the unit"
                + (f", or leave {column} out to compare {same}" if same else ""),
            )
    if kind == "driven_mass":
        turns = {unit.startswith("rad") for unit in units.values() if unit}
        if turns and turns != {"inertia_kg_m2" in model}:
            wanted = "inertia_kg_m2" if True in turns else "mass_kg"
            yield ("model",), f"the measured columns are in {_any(units.values())}: write {wanted}"
        drive = _columns(channels, "force")
        unit = standard_unit(_group(drive, "force"))
        if unit and turns and unit != ("N m" if True in turns else "N"):
            yield (
                ("channels", "force", "columns", "force", "unit"),
                f"is {drive['force']['unit']}, but the measured columns are in {_any(units.values())}; "
                "correct one of them",
            )
        if drive.keys() & {"current", "voltage"} and "force" not in drive and "gain" not in model:
            yield ("model",), "the input is a current or a voltage: write `gain`, in N or N m per A or V"


def _angles(kind: StageKind, about: Mapping[str, Any]) -> Iterator[tuple[Place, str]]:
    if "angles" in about and kind != "chain":
        yield ("angles",), f"is for a chain; this is a {kind} stage: remove it"
    if about.get("links", 1) != 1 and kind not in ("chain", "pendulum"):
        yield ("links",), f"is for a chain or a pendulum; this is a {kind} stage: remove it"


def followed(measured: Mapping[str, Any]) -> str | None:
    """Return the measured column that follows the command of a tracking stage, or None without one."""
    return next((name for name in CHANNELS["tracking"]["measured"].any_of if name in measured), None)


def _any(names: Any) -> str:
    return " or ".join(dict.fromkeys(map(str, names)))
