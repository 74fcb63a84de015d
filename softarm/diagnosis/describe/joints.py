"""Proposal of a stage.yaml for a MuJoCo model: columns found by the names of its joints and actuators."""

import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from softarm.common.quantity import PURE, factor
from softarm.diagnosis.data.stage_rules import QUATERNION
from softarm.diagnosis.data.trials import TrialError
from softarm.diagnosis.describe import headers
from softarm.diagnosis.describe.proposal import Answers, Draft, Proposal, Use
from softarm.diagnosis.describe.survey import Signal, Survey

# Readings this much wider than the joint's range, or than two turns of a position loop without one, are in degrees.
WIDER, TURNS_RAD = 1.5, 13.0
# Tracked points further away than this are in millimetres.
FARTHEST_M = 20.0
OF_MODEL, BY_RANGE = "of the model", "by the range of the joint"  # notes on a unit
_RATES = ("m/s", "rad/s")
TORQUE = {"rad": "N m", "m": "N"}  # unit of a joint -> of its torque
# Units that a quantity may have: a header rarely shows whether a joint is a hinge or a slide.
_ALIKE = (("rad", "m"), _RATES, tuple(TORQUE.values()))
# Ends of a pose's headers, in letters and digits: a part of the orientation or of the position. With its name before.
_PART = re.compile(r"(?:quaternion|quat|orientation|rotation|q)(?P<turn>[wxyz])|(?:position|pos|p)?(?P<place>[xyz])")
_POSE = re.compile(f"(?P<name>.*?)(?:{_PART.pattern})")


@dataclass(frozen=True, slots=True)
class ModelJoint:
    """Joint of a model, as a description needs it."""

    name: str
    unit: str  # rad or m
    span: float  # of its range; inf without a limit
    actuator: str  # empty without one
    command_unit: str
    moved: bool = False  # a column of a floating body's pose, which no torque of the model moves
    shares: Mapping[str, str] = field(default_factory=dict)  # several actuators -> unit of the command

    @property
    def widest(self) -> float:
        """Return the widest readings in the model's unit; a joint without a limit or a position loop may spin."""
        spins = self.span == float("inf") and self.command_unit != self.unit
        return self.span if spins else min(WIDER * self.span, TURNS_RAD)


def propose(
    survey: Survey,
    answers: Answers,
    joints: Sequence[ModelJoint],
    model: str,
    leaders: Callable[[Collection[str]], Mapping[str, str]],
    places: Mapping[str, Collection[str]] = MappingProxyType({}),
) -> Proposal:
    """Return the content of a stage file of kind mujoco.

    Args:
        survey: columns of the recordings.
        answers: answers of the user.
        joints: joints of the model.
        model: path of the model as the stage file names it.
        leaders: returns which of some measured joints follow another by the model's equalities, with that joint.
        places: sites and bodies of the model, which motion capture may track, with the columns of all joints that move
            them.

    Raises:
        Unknown: the stamps or their unit are unknown.
        TrialError: no column has the name of a joint or of a tracked point.
    """
    draft = Draft(survey, answers)
    found = _used(draft, joints, _tracked(draft, joints, places), places)
    for name, leader in leaders(found.get("measured", {})).items():
        found.setdefault("base", {})[name] = found["measured"].pop(name)
        found.get("torque", {}).pop(name, None)
        draft.notes.append(f"{name} follows {leader} by an equality of the model and is under base")
    found = {channel: _alike(columns) for channel, columns in found.items() if columns}
    driven = {joint.name for joint in joints if joint.actuator} | found.get("torque", {}).keys()
    if free := [name for name in found.get("measured", {}) if name not in driven]:
        draft.notes.append(
            f"Without actuator or torque, these joints count as free: {', '.join(free)}; if motors drive them, "
            "record their torques, or write them under base"
        )
    if not (found.get("measured") or found.get("mocap")):
        raise _unfound(survey, joints, model, tuple(found.get("base", ())))
    stamps = {name: draft.clock(next(iter(columns.values())).signal) for name, columns in found.items()}
    reasons = [f"{len(found['measured'])} joints of the model are measured"] if found.get("measured") else []
    reasons += ["points are tracked"] if "mocap" in found else []
    return Proposal("mujoco", " and ".join(reasons), 1, None, found, stamps, {}, {"mjcf": model}, draft.notes)


def _used(
    draft: Draft, joints: Sequence[ModelJoint], tracked: Mapping[str, Signal], places: Mapping[str, Collection[str]]
) -> dict[str, dict[str, Use]]:
    """Return the columns by channel and by the model's name for them.

    A joint's torque counts if its actuators are not commanded. Tracked points count if a joint that moves one has no
    column of its own.
    """
    found = dict[str, dict[str, Use]]()
    poses, taken, unseen = _poses(draft, joints), [*tracked.values()], dict[str, dict[str, Use]]()
    for joint in joints:
        if joint.name in poses:
            found.setdefault("base", {})[joint.name] = _use(draft, poses[joint.name], joint.unit, joint.widest)
            continue
        own = [s for s in draft.readings if not s.elements and s not in taken and joint in _owners(s, joints)]
        signals = [s for s in own if not s.is_constant]
        commands = [s for s in own if draft.role(s) == "command" or _is_command(s, joint)]
        driven = {"command": _sent(draft, joint, [s for s in commands if not s.is_constant])}
        if not driven["command"]:
            driven = {"torque": _torque(draft, joint, signals)}
        driven = {channel: columns for channel, columns in driven.items() if columns}
        measured = _likeliest(draft, joint, [s for s in signals if s not in commands], joint.unit)
        if measured is None:
            _add(unseen, driven)
            continue
        channel = "base" if joint.moved or (joint.actuator and not driven) else "measured"
        _add(found, {channel: {joint.name: _use(draft, measured, joint.unit, joint.widest)}, **driven})
        if channel == "base" and not joint.moved:
            still = any(s.is_constant for s in commands)
            reason = f"the command of {joint.actuator} is constant" if still else f"no column commands {joint.actuator}"
            draft.notes.append(f"{joint.name} counts as moved from outside: {reason}")
    carriers = {column for name in tracked for column in places[name.rpartition("_")[0]]}
    if carriers - found.get("measured", {}).keys() - found.get("base", {}).keys():
        found["mocap"] = _coordinates(draft, tracked)
        _add(found, unseen)
        if all(places[name.rpartition("_")[0]] for name in tracked):
            draft.notes.append("Tracked points have to be in the model's frame, since none is fixed to its base")
    return found


def _alike(columns: Mapping[str, Use]) -> dict[str, Use]:
    """Return a channel's columns, all angles without a unit in degrees if the range of one of them shows degrees."""
    if all(use.note != BY_RANGE for use in columns.values()):
        return dict(columns)
    small = {name: use for name, use in columns.items() if (use.unit, use.note) == ("rad", OF_MODEL)}
    return {**columns, **{name: replace(use, unit="deg", note="as of the others") for name, use in small.items()}}


def _add(found: dict[str, dict[str, Use]], more: Mapping[str, Mapping[str, Use]]) -> None:
    """Add columns to the channels found so far."""
    for channel, columns in more.items():
        found.setdefault(channel, {}).update(columns)


def _sent(draft: Draft, joint: ModelJoint, commands: Sequence[Signal]) -> dict[str, Use]:
    """Return the columns of a joint's actuators by their names, none if one is missing; commands: those of the joint.

    Of several actuators a column has the name.
    """
    if joint.shares:
        named = {name: [s for s in commands if _plain(s.header.name) == _plain(name)] for name in joint.shares}
        found = {name: _use(draft, of[0], joint.shares[name], math.inf) for name, of in named.items() if of}
        return found if len(found) == len(named) else {}
    command = _likeliest(draft, joint, commands, joint.command_unit)
    if command is None or not joint.actuator:
        return {}
    return {joint.actuator: _use(draft, command, joint.command_unit, joint.widest)}


def _torque(draft: Draft, joint: ModelJoint, signals: Sequence[Signal]) -> dict[str, Use]:
    """Return the column of a joint's torque by the joint's name, measured rather than commanded; signals: its own."""
    if joint.moved:
        return {}
    unit = TORQUE[joint.unit]
    torques = [s for s in signals if draft.standard(s) and _may_be(draft, s, unit)]
    found = _likeliest(draft, joint, [s for s in torques if draft.role(s) != "command"] or torques, unit)
    return {} if found is None else {joint.name: _use(draft, found, unit, math.inf)}


def named(survey: Survey, joints: Sequence[ModelJoint], sensors: Mapping[str, tuple[str, str]]) -> Survey:
    """Return the columns of a model's recordings by the model's names.

    A name may end like a unit: `fl_kn` is no force in kN. A word of a joint's own name gives no role: `right_w0` is no
    set-point. A column of a sensor has the name of what the sensor reads; the longest name wins.

    Args:
        survey: columns of the recordings.
        joints: joints of the model.
        sensors: joint, site or body that each sensor reads, and the unit of a torque or "", by the sensor's name.
    """
    names = {name for joint in joints for name in _names(joint)}
    objects = {_plain(name): seen for name, seen in sensors.items()}

    def read(signal: Signal) -> Signal:
        source, header = str(signal.source), signal.header
        if header.role != "time":
            own = _read(source, joints)
            header = replace(header, role=own.role, quantity=header.quantity if header.unit else own.quantity)
            signal = replace(signal, header=header)
        if header.unit is not None and any(n in _plain(source) and n not in _plain(header.name) for n in names):
            return replace(signal, header=replace(header, name=source, unit=None, quantity=""))
        plain = _plain(header.name)
        rests = {name: plain.removeprefix(name) for name in objects if plain.startswith(name) and plain not in names}
        found = [name for name, rest in rests.items() if not rest or _PART.fullmatch(rest)]
        if not found:
            return signal
        sensor = max(found, key=len)
        name, torque = objects[sensor]
        quantity = torque or header.quantity
        return replace(signal, header=replace(header, name=f"{name} {rests[sensor]}".strip(), quantity=quantity))

    return replace(survey, signals=tuple(map(read, survey.signals)))


def _read(source: str, joints: Sequence[ModelJoint]) -> headers.Header:
    """Return what the words of a header suggest that are not part of a joint's name."""
    for name in sorted((joint.name for joint in joints), key=len, reverse=True):
        rest, found = re.subn(rf"(?<![^\W_]){re.escape(name)}(?![^\W_])", " ", source, flags=re.IGNORECASE)
        if found:
            return headers.read(rest)
    return headers.read(source)


def _tracked(draft: Draft, joints: Sequence[ModelJoint], places: Mapping[str, Collection[str]]) -> dict[str, Signal]:
    """Return the columns of tracked points by their names in a stage file, such as tip_x and tip_qw.

    They change, except those of points that no joint moves.
    """
    known = {_plain(name): name for name in sorted(places, key=len)}
    others = {name for joint in joints for name in _names(joint)}
    found = dict[str, Signal]()
    for signal in draft.readings:
        header = _plain(signal.header.name)
        place = max((name for name in known if header.startswith(name)), key=len, default="")
        part = _PART.fullmatch(header.removeprefix(place))
        if place and signal.is_constant and places[known[place]]:
            continue
        if place and part and header not in others and not signal.elements:
            found[f"{known[place]}_{part['place'] or 'q' + part['turn']}"] = signal
    return found


def _coordinates(draft: Draft, tracked: Mapping[str, Signal]) -> dict[str, Use]:
    """Return the columns of tracked points with their units; without any, far points are in millimetres."""
    found = {n: _use(draft, s, PURE if n.endswith(QUATERNION) else "m", math.inf) for n, s in tracked.items()}
    without = [n for n, use in found.items() if (use.unit, use.note) == ("m", OF_MODEL)]
    if any(np.abs(tracked[n].all).max() > FARTHEST_M for n in without):
        found |= {n: replace(found[n], unit="mm", note="by their range") for n in without}
    return found


def _poses(draft: Draft, joints: Sequence[ModelJoint]) -> dict[str, Signal]:
    """Return the columns of the only floating body, if the recordings have the only pose under another name."""
    parts = {joint.name.rpartition("_")[2]: joint.name for joint in joints if joint.moved}
    bodies = {joint.name.rpartition("_")[0] for joint in joints if joint.moved}
    found = dict[str, dict[str, Signal]]()
    for signal in draft.moving:
        if not signal.elements and (pose := _POSE.fullmatch(_plain(str(signal.source)))):
            part = pose["place"] or f"q{pose['turn']}"
            found.setdefault(pose["name"], {})[part] = signal
    whole = [columns for columns in found.values() if len(parts) == 7 and columns.keys() == parts.keys()]
    if len(bodies) != 1 or len(whole) != 1:
        return {}
    columns, (body,) = whole[0], bodies
    if columns["x"].source != parts["x"]:
        draft.notes.append(
            f"the only pose in the recordings counts as that of {body}; it has to be in the model's frame"
        )
    return {name: columns[part] for part, name in parts.items()}


def _unfound(survey: Survey, joints: Sequence[ModelJoint], model: str, measured: Sequence[str]) -> TrialError:
    """Return the error of recordings without a driven or free joint; measured: joints without a command."""
    columns = ", ".join(s.described for s in survey.signals)
    if measured:
        actuators = ", ".join(f"{j.actuator} of {j.name}" for j in joints if j.name in measured)
        problem = f"no column commands an actuator ({actuators})"
    else:
        names = ", ".join(joint.name for joint in joints) or "no joint"
        problem = f"no column has the name and unit of a driven or free joint; the model has {names}"
    return TrialError(
        f"{model}: {problem}; the recordings have {columns}; rename the columns, or write the stage.yaml by hand "
        "(docs/gap/mujoco.md)"
    )


def _is_command(signal: Signal, joint: ModelJoint) -> bool:
    """Return whether a column has the name of an actuator of a joint, which is not the joint's own."""
    return _plain(signal.header.name) in _names(joint) - {_plain(joint.name)}


def _names(joint: ModelJoint) -> set[str]:
    """Return the names of a joint and its actuators, in letters and digits."""
    return {_plain(name) for name in (joint.name, joint.actuator, *joint.shares)} - {""}


def _owners(signal: Signal, joints: Sequence[ModelJoint]) -> list[ModelJoint]:
    """Return the joints whose name, or whose actuator's name, a column's header contains; the longest name wins."""
    header, found = _plain(signal.header.name), dict[int, list[ModelJoint]]()
    for joint in joints:
        for own in _names(joint):
            if own in header:
                found.setdefault(len(own), []).append(joint)
    return found[max(found)] if found else []


def _likeliest(draft: Draft, joint: ModelJoint, signals: Sequence[Signal], unit: str) -> Signal | None:
    """Return the signal that is likeliest to be a joint's in a unit, else the shortest-named.

    A header that is the joint's name or states the quantity comes before one with other words, such as a temperature.
    """

    def rank(signal: Signal) -> tuple[bool, bool, int, str]:
        is_unclear = not draft.standard(signal) and _plain(signal.header.name) not in _names(joint)
        return is_unclear, is_unclear and not draft.role(signal), len(signal.label), signal.label

    return min((s for s in signals if _may_be(draft, s, unit)), key=rank, default=None)


def _may_be(draft: Draft, signal: Signal, unit: str) -> bool:
    """Return whether a signal may be in a unit, by the unit or the quantity in its header."""
    standard = draft.standard(signal)
    if unit == PURE:
        return standard not in _RATES
    if draft.units.get(signal.label) or signal.header.unit:
        return standard == unit
    return standard in ("", *next(own for own in _ALIKE if unit in own))


def _use(draft: Draft, signal: Signal, unit: str, widest: float) -> Use:
    """Return a column with its unit: given, in its header, or by the joint's widest readings."""
    if given := draft.units.get(signal.label):
        return Use(signal, given, "as given")
    if (own := signal.header.unit) and factor(own)[1] == unit:
        return Use(signal, own, "from the header")
    wide = float(signal.all.max() - signal.all.min())
    if unit == "rad" and wide > widest:
        return Use(signal, "deg", BY_RANGE)
    return Use(signal, unit, OF_MODEL)


def _plain(text: str) -> str:
    """Return the letters and digits of a name."""
    return re.sub(r"[^a-z0-9]", "", text.lower())
