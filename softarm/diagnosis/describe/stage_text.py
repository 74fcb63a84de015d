"""Text of a new stage.yaml, with a line about each key and the candidates of each channel."""

import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import yaml

from softarm.common.quantity import PURE, Quantity
from softarm.diagnosis.describe.clocks import Clock
from softarm.diagnosis.describe.proposal import Proposal, Use
from softarm.diagnosis.describe.survey import Signal, Survey
from softarm.schemas.stage_model import MODEL_KEYS, ModelValue
from softarm.schemas.trial import TableForm

_CHANNELS = {
    "command": "what was commanded, after every limit of the controller",
    "force": "what moves the mass: force, torque, current or voltage",
    "torque": "torques of the joints, commanded or measured",
    "measured": "what the sensors show",
    "mocap": "coordinates of sites and bodies by motion capture",
    "base": "position of the cart that carries the first joint",
}
_MOVED = "joints that are moved from outside or follow another, and poses of floating bodies"
_KINDS = {
    "tracking": "the output follows a command",
    "driven_mass": "a force moves a mass",
    "pendulum": "links swing freely",
    "chain": "links with joint torques",
    "mujoco": "joints of a MuJoCo model: softarm new rig MODEL.xml DATA...",
}
_PLAIN = re.compile(r"[A-Za-z_][\w./{}#*-]*")
_CANDIDATES_MAX = 8


def text(survey: Survey, proposal: Proposal, name: str, folder: Path, run: str) -> str:
    """Return the text of a stage.yaml in a folder, to which paths are relative; `run` is the command that checks it."""
    return "\n".join([*_head(survey, proposal, name, run), *_channels(survey, proposal),
                      *_model(proposal), *_table(survey.form), *_trials(survey, proposal, folder), ""])  # fmt: skip


def _head(survey: Survey, proposal: Proposal, name: str, run: str) -> Iterator[str]:
    others = ", ".join(f"{kind} ({what})" for kind, what in _KINDS.items() if kind != proposal.kind)
    yield f"# Describes the recordings of a rig for the diagnosis. After each change: {run}"
    yield "# All keys: docs/reference/trials.md"
    yield ""
    if proposal.kind == "mujoco":
        yield "# Effects are called JOINT.NAME in the answer."
    else:
        yield f"# The mechanism's name; effects are called {name}.NAME in the answer."
        yield f"name: {scalar(name)}"
    about = _KINDS[proposal.kind]
    yield f"# {about[0].upper()}{about[1:]} ({proposal.why})."
    yield f"# Other kinds: {others}."
    yield f"kind: {proposal.kind}"
    if proposal.kind in ("pendulum", "chain"):
        yield "# Number of links, from the base on."
        yield f"links: {proposal.links}"
    if proposal.angles is not None:
        yield "# absolute: from the vertical; relative: from the link before."
        yield f"angles: {proposal.angles}"
    lists = [use.signal.elements for columns in proposal.channels.values() for use in columns.values()]
    if elements := min(filter(None, lists), default=0):
        yield "# Cells hold lists: one mechanism for each element. Give them their names."
        yield "elements: {" + ", ".join(f"{scalar(f'{name}_{i + 1}')}: {i}" for i in range(elements)) + "}"


def _channels(survey: Survey, proposal: Proposal) -> Iterator[str]:
    yield "# Columns by their headers, with the unit that they are written in."
    yield "channels:"
    for channel, columns in proposal.channels.items():
        used = [use.signal for use in columns.values()]
        others = [s for s in proposal.candidates.get(channel, ()) if s not in used]
        also = f" Other candidates: {_named(others)}." if others else ""
        what = _MOVED if (proposal.kind, channel) == ("mujoco", "base") else _CHANNELS[channel]
        yield f"  # {what.capitalize()}.{also}"
        yield f"  {channel}:"
        yield f"    time: {_clock(proposal.clocks[channel])}"
        yield "    columns:"
        for name, use in columns.items():
            yield f"      {name}: {_column(use)}"
    for note in proposal.notes:
        yield f"# {note}."
    used = [use.signal for columns in proposal.channels.values() for use in columns.values()]
    times = [clock.signal for clock in proposal.clocks.values()]
    if left := [s for s in survey.signals if s not in used and s not in times]:
        yield f"# Not used: {_named(left)}."
    yield from (f"# Left out: {reason}." for reason in survey.unused[:_CANDIDATES_MAX])


def _clock(clock: Clock) -> str:
    parts = {"source": scalar(clock.source)}
    if clock.signal is None:
        parts["scale"] = f"{clock.scale:g}"
    parts["unit"] = scalar(clock.unit)
    if clock.signal is not None and clock.signal.marks:
        parts["missing"] = _marks(clock.signal.marks)
    return f"{_flow(parts)}  # {clock.note}"


def _column(use: Use) -> str:
    signal = use.signal
    parts = {"source": scalar(signal.source)}
    if signal.row is not None:
        parts["row"] = str(signal.row)
    parts["unit"] = scalar(use.unit)
    if signal.marks:
        parts["missing"] = _marks(signal.marks)
    if use.add:
        parts["add"] = f"{use.add:.15g}"
    gone = float(np.mean([not np.isfinite(x) for each in signal.values for x in each]))
    said = [f"{signal.all.min():.4g} to {signal.all.max():.4g}", f"unit {use.note}"]
    said += [f"{gone:.1%} of the rows have no value"] if gone else []
    said += ["it hangs at half a turn"] if use.add else []
    return f"{_flow(parts)}  # {'; '.join(said)}"


def _model(proposal: Proposal) -> Iterator[str]:
    yield "# The nominal model: the values of your simulator. A key behind # has its default."
    yield "# If your simulator has more, such as play or a resonance, add `effects:` (docs/reference/trials.md)."
    yield "model:"
    keys = MODEL_KEYS[proposal.kind]
    width = max(len(key.name) for key in keys) + 12
    for key in keys:
        unit = _unit(key.unit, proposal)
        about = f"# {key.meaning}" + (f", {unit}" if unit else "")
        if key.name in proposal.model:
            yield f"{f'  {key.name}: {_value(proposal.model[key.name])}':{width}}  {about}"
        else:
            example = {"pairs": "[[0, 0], [1, 1]]"}.get(key.each, "" if key.default is None else f"{key.default:g}")
            allowed = Quantity(low=key.low, high=key.high, above=key.above).bounds
            yield f"{f'  # {key.name}: {example}':{width}}  {about}" + (f"; {allowed}" if allowed else "")


def _unit(unit: str, proposal: Proposal) -> str:
    """Unit of a key of the model, with the units of the file's columns."""
    if "measured" not in unit or proposal.kind != "tracking":
        return "" if unit == PURE else unit
    (place, *_), command = proposal.channels["measured"].values(), proposal.channels["command"]["command"]
    return unit.replace("measured", place.unit).replace("command", command.unit)


def _table(form: TableForm) -> Iterator[str]:
    given = form.model_dump(exclude_defaults=True)
    if given:
        yield "# Format of the text files; keys that are missing here are detected."
        yield "table: " + _flow({key: scalar(value) for key, value in given.items()})


def _trials(survey: Survey, proposal: Proposal, folder: Path) -> Iterator[str]:
    yield "# One for each recording. `kind` is the excitation: kinds are held out in turn, so name them well."
    yield "# Cut a recording with from_s and to_s, in seconds after its first row."
    yield "trials:"
    groups = {channel: next(iter(columns.values())).signal.group for channel, columns in proposal.channels.items()}
    stamps = proposal.clocks["measured" if "measured" in proposal.clocks else "mocap"].times_s
    for recording, times in zip(survey.recordings, stamps, strict=True):
        files = {channel: _path(recording.files[group], folder) for channel, group in groups.items()}
        one = next(iter(files.values())) if len(set(files.values())) == 1 else None
        parts = {"name": scalar(recording.name), "kind": scalar(recording.kind)}
        if recording.segment is not None:
            parts["segment"] = scalar(recording.segment)
        parts["files"] = one or _flow(files)
        seconds = float(np.nanmax(times) - np.nanmin(times))
        yield f"  - {_flow(parts)}  # {len(times)} rows, {seconds:.4g} s"


def _path(path: Path, folder: Path) -> str:
    """Path of a recording, relative to the stage file unless that climbs to the root."""
    relative = Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()
    return scalar(relative if relative.count("../") < 4 else path.resolve().as_posix())


def _named(signals: Sequence[Signal]) -> str:
    """Names of columns, each with a reason against it if there is one."""
    shown = [s.described for s in signals[:_CANDIDATES_MAX]]
    more = len(signals) - len(shown)
    return ", ".join(shown) + (f" and {more} more" if more else "")


def _marks(marks: Sequence[str | float]) -> str:
    shown = [scalar(mark) for mark in marks]
    return shown[0] if len(shown) == 1 else f"[{', '.join(shown)}]"


def _value(value: ModelValue) -> str:
    if isinstance(value, str):
        return scalar(value)
    return f"{value:.9g}" if isinstance(value, int | float) else json.dumps(list(value))


def _flow(parts: Mapping[str, str]) -> str:
    return "{" + ", ".join(f"{key}: {value}" for key, value in parts.items()) + "}"


def scalar(value: object) -> str:
    """Return a value as YAML, with quotes where a reader would take it for something else."""
    if not isinstance(value, str):
        return json.dumps(value)
    is_plain = _PLAIN.fullmatch(value) and "{" not in value and yaml.safe_load(value) == value
    return value if is_plain or value in ("m/s", "rad/s") else json.dumps(value, ensure_ascii=False)
