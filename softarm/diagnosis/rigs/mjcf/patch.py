"""Patch of an MJCF file: findings of a diagnosis as changed attributes, with all other text as it was.

A URDF has no place for most findings, and an MJCF may be spread over several files; then the patch is the one MJCF that
MuJoCo makes of it.
"""

import difflib
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import NamedTuple
from xml.parsers import expat

import numpy as np

from softarm.common.quantity import factor
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.mjcf.actuators import Actuator
from softarm.diagnosis.rigs.mjcf.effects import GAIN_OF, MASS, of_actuator
from softarm.diagnosis.rigs.mjcf.links import PLACE
from softarm.diagnosis.rigs.mjcf.mechanism import Inertial, Joint, Mechanism, mechanism
from softarm.schemas.verdict import Verdict

# Parameter of a joint's effect -> attribute of its `joint` element.
_JOINT = {
    "coulomb_friction.torque": "frictionloss",
    "damping.viscous": "damping",
    "armature.inertia": "armature",
    "spring.stiffness": "stiffness",
}
# Laws of dry friction, and the impedance with which MuJoCo's friction holds a joint; by default it creeps under a load.
_FRICTION = "coulomb_friction", "stiction", "load_friction"
_HOLDS = "0.9999 0.9999"
_ACTUATORS = "position", "velocity", "motor", "general", "cylinder", "muscle"
_DIGITS = 6
# Remedies for findings that are left out.
_OTHER = "--patch FILE.yaml writes it"
_UNNAMED = "the body has no name; name it in the model and diagnose again"
_POINT_KG_M2 = "1e-9"  # inertia of a point mass: MuJoCo refuses zero


@dataclass(frozen=True, slots=True)
class MjcfPatch:
    """Patched MJCF file with its difference."""

    text: str
    diff: str  # unified diff against the original
    left_out: tuple[str, ...]  # findings that the file cannot express, each with its value and the remedy


def patched(path: Path, verdict: Verdict, calibration: bool, best_fit: bool = False) -> MjcfPatch | None:
    """Return an MJCF file with the findings of its diagnosis, or None if there are none.

    Args:
        path: MJCF or URDF file.
        verdict: its verdict.
        calibration: whether calibrated parameters are written as well.
        best_fit: whether joints with a best fit get that instead.
    """
    found = {place: standard(*of) for place, of in verdict.findings(calibration, best_fit).items()}
    if not found:
        return None
    stages = {*verdict.where.share, *(place.partition(".")[0] for place in found)}
    model, left_out = mechanism(path, stages), []
    found = agreed(found, model)
    before = model.mjcf()
    edits = _Edits(before)
    payloads: dict[str, list[tuple[float, ...]]] = {}  # body -> mass and place of each joint that weighs it
    shares: dict[str, list[float]] = {}
    tilts: dict[str, list[float]] = {}  # axis -> the base's tilt about it by each joint that it loads, rad
    named = {place.partition(".")[2] for place in found}
    for place, value in sorted(found.items()):
        name, _, parameter = place.partition(".")
        joint = model.joint(name)
        if f"{parameter}.scale" in named:
            continue  # the calibration of a body whose mass other joints have as an effect
        if parameter.startswith(MASS):
            first = parameter.removeprefix(MASS).removesuffix(".scale")
            for body in joint.parts.get(first, (first,)):
                shares.setdefault(body, []).append(value)
        elif parameter == "payload.mass":
            link = model.last_link(joint)
            at = link.place([found.get(f"{name}.payload.{axis}", 0.0) for axis in PLACE])
            payloads.setdefault(link.body, []).append((value, *at))
        elif parameter in {f"payload.{axis}" for axis in PLACE}:
            continue  # written with the mass
        elif parameter.startswith("tilt."):
            tilts.setdefault(parameter.removeprefix("tilt."), []).append(value)
        elif not _written(edits, joint, parameter, value, found):
            left_out.append(f"{place} = {_short(value)}: the MJCF has no place for it; {_OTHER}")
    rubbing = {place.partition(".")[0] for place in found if place.split(".")[1] in _FRICTION}
    rubbing |= {name for name in stages & model.joints.keys() if model.joints[name].friction}
    for name in sorted(rubbing.difference(verdict.creeping)):
        edits.set(_Element("joint", name), "solimpfriction", _HOLDS)
    left_out += _write_bodies(edits, model, shares, payloads)
    if shares or payloads or any(place.endswith(".armature.inertia") for place in found):
        left_out += _write_dampers(edits, model, found)
    if tilts:
        edits.set_option("gravity", _numbers(_tilted(model, tilts)))
    after = edits.text
    lines = difflib.unified_diff(
        before.splitlines(keepends=True), after.splitlines(keepends=True), path.name, f"patched {path.name}", n=0
    )
    return MjcfPatch(after, "".join(lines), tuple(left_out))


def agreed(found: Mapping[str, float], model: Mechanism) -> dict[str, float]:
    """Return the findings with one size for all joints that an actuator moves: the mean over those that show it."""
    sizes: dict[tuple[str, str], list[float]] = {}  # by actuator and parameter
    moved: dict[str, Actuator] = {}
    for place, value in found.items():
        name, _, parameter = place.partition(".")
        actuator = model.joint(name).actuator
        if actuator is not None and actuator.others:
            moved[name] = actuator
            if of_actuator(effect := parameter.partition(".")[0]) or effect == "ceiling":
                sizes.setdefault((actuator.name, parameter), []).append(value / _worth(actuator, parameter))
    common = {
        f"{name}.{parameter}": float(np.mean(values)) * _worth(actuator, parameter)
        for name, actuator in moved.items()
        for (of, parameter), values in sizes.items()
        if of == actuator.name
    }
    return {**found, **common}


def _worth(actuator: Actuator, parameter: str) -> float:
    """Return the size of a parameter at a joint for a size of one at its actuator; a limit is a torque."""
    return abs(actuator.gear) if parameter == "ceiling.limit" else 1.0


def _written(edits: "_Edits", joint: Joint, parameter: str, value: float, found: Mapping[str, float]) -> bool:
    """Write a parameter into the file and return whether the format can express it."""
    if parameter == "coulomb_friction.torque":
        value = max(value - joint.followers_dry, 0.0)
    if parameter in _JOINT:
        return edits.set(_Element("joint", joint.name), _JOINT[parameter], _short(value))
    actuator = joint.actuator
    if actuator is not None and actuator.shares:
        return _written_to_shares(edits, joint, parameter, value)
    element = edits.actuator(actuator.name, joint.name) if actuator else None
    if actuator is None or element is None:
        return False
    factor, stiffer = (1 + found.get(f"{joint.name}.{name}.scale", 0.0) for name in ("gain", "position_gain"))
    gear = actuator.gear * (factor if element.tag == "motor" else 1.0)
    if parameter == "ceiling.limit":
        changes = _limited(-value, value, gear)
        if actuator.joint_limited:
            edits.set(_Element("joint", joint.name), "actuatorfrcrange", _numbers((-value, value)))
    elif parameter == "lag.time":
        changes = _lag(element.tag, value)
    elif parameter in ("gain.scale", "position_gain.scale"):
        changes = _gains(element.tag, actuator, factor, factor * stiffer)
        if element.tag == "motor" and math.isfinite(actuator.high) and f"{joint.name}.ceiling.limit" not in found:
            changes |= _limited(actuator.low, actuator.high, gear)
    else:
        return False
    if element.tag == "motor" and "gainprm" in changes:
        element = edits.rename(element, "general")
    return bool(changes) and all(edits.set(element, attribute, text) for attribute, text in changes.items())


def _written_to_shares(edits: "_Edits", joint: Joint, parameter: str, value: float) -> bool:
    """Write a parameter of several actuators of a joint: the gain of one of them, or the lag of all.

    Of actuators whose strengths change with the motion, the file can express the gain of a muscle or a motor.
    """
    assert joint.actuator is not None
    effect, written = parameter.partition(".")[0], joint.actuator.shares
    if effect.startswith(GAIN_OF):
        written = {name: each for name, each in written.items() if effect == GAIN_OF + name}
        parameter = "gain.scale"
    if joint.actuator.by_motion:
        elements = [edits.actuator(each.name, joint.name) for each in written.values()]
        if parameter != "gain.scale" or any(e is None or e.tag not in ("muscle", "motor") for e in elements):
            return False
    found = {f"{joint.name}.{parameter}": value}
    done = [_written(edits, replace(joint, actuator=each), parameter, value, found) for each in written.values()]
    return bool(done) and all(done)


def _limited(low: float, high: float, gear: float) -> dict[str, str]:
    """Return the attributes of an actuator whose joint torque is limited, by its gear."""
    return {"forcelimited": "true", "forcerange": _numbers(sorted((low / gear, high / gear)))}


def _lag(tag: str, time_s: float) -> dict[str, str]:
    """Return the attributes of an actuator with a time constant; a motor with one is a general actuator."""
    if tag in ("position", "cylinder"):
        return {"timeconst": _short(time_s)}
    if tag in ("motor", "general"):
        own = {"gaintype": "fixed", "gainprm": "1", "biastype": "none"} if tag == "motor" else {}
        return own | {"dyntype": "filterexact", "dynprm": _short(time_s)}
    return {}


def _gains(tag: str, actuator: Actuator, factor: float, stiff: float) -> dict[str, str]:
    """Return the attributes of an actuator whose gain has a factor, and its position gain another one."""
    gear = actuator.gear
    kp, kd = stiff * actuator.kp / gear**2, factor * actuator.kd / gear**2
    if tag == "position":
        return {"kp": _short(kp), "kv": _short(kd)}
    if tag == "velocity":
        return {"kv": _short(kd)}
    if tag == "motor":
        return {"gear": _short(factor * actuator.own_gear)}
    if tag == "muscle":
        return {"force": _short(factor * actuator.peak)}
    if tag == "general":
        bias = stiff * actuator.offset / gear, -kp, -kd
        return {"gainprm": _short(stiff * actuator.scale / gear)} | ({"biasprm": _numbers(bias)} if any(bias) else {})
    return {}


def _write_bodies(
    edits: "_Edits",
    model: Mechanism,
    shares: Mapping[str, Sequence[float]],
    payloads: Mapping[str, Sequence[tuple[float, ...]]],
) -> list[str]:
    """Write masses and payloads, each the mean over the joints that weigh it, and return what is left out.

    Args:
        edits: the file.
        model: its model.
        shares: relative changes of the mass, by body.
        payloads: mass and place, by body.
    """
    left_out = []
    for body, values in shares.items():
        factor, inertial = 1 + float(np.mean(values)), model.inertial(body)
        if not edits.change_mass(body, factor, inertial):
            why = "its geoms define it; change theirs" if inertial is None else _UNNAMED
            left_out.append(f"mass of {body} x {_short(factor)}: {why}")
    for body, loads in payloads.items():
        mass, *at = np.mean(loads, axis=0)
        if not edits.add_point_mass(body, float(mass), at):
            left_out.append(f"payload of {_short(mass)} kg at {body}: {_UNNAMED}, or {_OTHER}")
    return left_out


def _write_dampers(edits: "_Edits", model: Mechanism, found: Mapping[str, float]) -> list[str]:
    """Write the dampers that MuJoCo would compute again from a changed inertia, and return what is left out."""
    left_out = []
    for joint in model.with_damping_ratio():
        if (own := joint.actuator) and not _written(edits, joint, "gain.scale", 0.0, found):
            kv = _short(own.kd / own.gear**2)
            left_out.append(f"the damper of {joint.name}: its dampratio gives another one; write kv={kv} instead")
    return left_out


def _tilted(model: Mechanism, tilts: Mapping[str, Sequence[float]]) -> Array:
    """Return gravity in the frame of a tilted base, m/s^2, [3]; tilts: the angles about each axis, rad."""
    gravity: Array = np.array(model.model.opt.gravity)
    tilted = gravity + sum(float(np.mean(angles)) * model.level_axes[axis] for axis, angles in tilts.items())
    return np.asarray(tilted * np.linalg.norm(gravity) / np.linalg.norm(tilted))


class _Element(NamedTuple):
    """Opening tags with a name."""

    tag: str
    name: str
    joint: str | None = None  # of actuators without a name at this joint
    body: str | None = None  # directly in this body


class _Edits:
    """Text of an XML file whose attributes are changed in place."""

    def __init__(self, text: str) -> None:
        self.text = text

    def set(self, element: _Element, attribute: str, value: str) -> bool:
        """Set an attribute of an element; return False if the file holds no such element."""
        place = self._place(element)
        if place is None:
            return False
        start, end = place
        tag = self.text[start:end]
        if old := _attribute(tag, attribute):
            tag = f"{tag[: old.start(3)]}{value}{tag[old.end(3) :]}"
        else:
            close = re.search(r"\s*/?>$", tag)
            assert close is not None
            tag = f'{tag[: close.start()]} {attribute}="{value}"{tag[close.start() :]}'
        if element.tag == "position" and attribute == "kv" and (ratio := _attribute(tag, "dampratio")):
            tag = tag[: ratio.start()] + tag[ratio.end() :]  # MuJoCo refuses both
        self.text = self.text[:start] + tag + self.text[end:]
        return True

    def set_option(self, attribute: str, value: str) -> None:
        """Set an attribute of the model's `option`, in a new element if there is none."""
        if not self.set(_Element("option", ""), attribute, value):
            self._add(_Element("mujoco", ""), f'<option {attribute}="{value}"/>')

    def rename(self, element: _Element, tag: str) -> _Element:
        """Give an element of the file another tag."""
        place = self._place(element)
        assert place is not None
        start, end = place
        before, inner, after = self.text[:start], self.text[start:end], self.text[end:]
        if not inner.endswith("/>"):
            after = after.replace(f"</{element.tag}", f"</{tag}", 1)
        self.text = f"{before}<{tag}{inner.removeprefix(f'<{element.tag}')}{after}"
        return element._replace(tag=tag)

    def change_mass(self, body: str, factor: float, inertial: Inertial | None) -> bool:
        """Multiply mass and inertia of a body; return False if the file cannot express it.

        Args:
            body: name of the body.
            factor: new mass over the present one.
            inertial: present mass and inertia, or None if the body's geoms define them.
        """
        if inertial is None:
            return False
        element = _Element("inertial", "", body=body)
        place = self._place(element)
        if place is None:
            frame = f'pos="{_numbers(inertial.at)}" quat="{_numbers(inertial.quat)}"'
            mass, inertia = _short(factor * inertial.mass_kg), _numbers(factor * inertial.inertia)
            return self._add(_Element("body", body), f'<inertial {frame} mass="{mass}" diaginertia="{inertia}"/>')
        tag = self.text[slice(*place)]
        for name in ("mass", "diaginertia", "fullinertia"):
            if old := _attribute(tag, name):
                self.set(element, name, _numbers(factor * float(x) for x in old[3].split()))
        return True

    def add_point_mass(self, body: str, mass_kg: float, at: Iterable[float]) -> bool:
        """Add a body without a joint to a named one, at a place in its frame, [3]; return False without such a name."""
        names = (f"{body}_payload{i if i > 1 else ''}" for i in count(1))
        name = next(each for each in names if self._place(_Element("body", each)) is None)
        more = (
            f'<body name="{name}" pos="{_numbers(at)}">'
            f'<inertial pos="0 0 0" mass="{_short(mass_kg)}" diaginertia="{" ".join([_POINT_KG_M2] * 3)}"/></body>'
        )
        return self._add(_Element("body", body), more)

    def actuator(self, name: str, joint: str) -> _Element | None:
        """Return the actuator with a name, else one without a name at a joint, else None."""
        found = (_Element(tag, *by) for by in ((name,), ("", joint)) for tag in _ACTUATORS)
        return next((each for each in found if self._place(each)), None)

    def _add(self, element: _Element, child: str) -> bool:
        """Add a child at the start of an element, in a line of its own; return False if there is no such element."""
        place = self._place(element)
        if place is None:
            return False
        start, end = place
        line = self.text[self.text.rfind("\n", 0, start) + 1 : start]
        indent = line[: len(line) - len(line.lstrip())]
        self.text = f"{self.text[:end]}\n{indent}  {child}{self.text[end:]}"
        return True

    def _place(self, element: _Element) -> tuple[int, int] | None:
        """Return start and end of the first such opening tag."""
        data, bodies = self.text.encode(), list[str]()
        found: list[int] = []
        parser = expat.ParserCreate()

        def begin(tag: str, attributes: Mapping[str, str]) -> None:
            if tag == "body":
                bodies.append(attributes.get("name", ""))
            same = tag == element.tag and attributes.get("name", "") == element.name and not found
            same &= element.joint in (None, attributes.get("joint"))
            # An equality of joints may have a joint's name.
            same &= tag != "joint" or bool(bodies)
            if same and (element.body is None or bodies[-1:] == [element.body]):
                found.append(parser.CurrentByteIndex)

        def end(tag: str) -> None:
            if tag == "body":
                bodies.pop()

        parser.StartElementHandler, parser.EndElementHandler = begin, end
        parser.Parse(data, True)
        if not found:
            return None
        start = len(data[: found[0]].decode())
        match = re.compile(r"""<(?:[^>"']|"[^"]*"|'[^']*')*>""").match(self.text, start)
        assert match is not None
        return start, match.end()


def _attribute(tag: str, name: str) -> re.Match[str] | None:
    """Return the match of an attribute in an opening tag; its third group is the value."""
    return re.search(rf"""(\s{name}\s*=\s*)(["'])(.*?)\2""", tag, re.DOTALL)


def standard(value: float, unit: str) -> float:
    """Return a value in standard units; units that only a verdict has are standard already."""
    try:
        return value * factor(unit)[0]
    except ValueError:
        return value


def _short(value: float) -> str:
    """Return a value with six significant digits."""
    return f"{value:.{_DIGITS}g}"


def _numbers(values: Iterable[float]) -> str:
    """Return values with six significant digits each, as MJCF separates them."""
    return " ".join(map(_short, values))
