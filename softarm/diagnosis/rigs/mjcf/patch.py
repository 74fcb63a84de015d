"""Patch of an MJCF file: findings of a diagnosis as changed attributes, with all other text as it was.

A URDF has no place for most findings; its patch is the MJCF that MuJoCo makes of it.
"""

import difflib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.parsers import expat

import numpy as np

from softarm.common.quantity import factor
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.mjcf.effects import MASS
from softarm.diagnosis.rigs.mjcf.links import PLACE
from softarm.diagnosis.rigs.mjcf.mechanism import Joint, Mechanism, mechanism
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
_ACTUATORS = ("position", "velocity", "motor", "general", "intvelocity", "damper", "cylinder", "muscle", "adhesion")
_DIGITS = 6
_POINT_KG_M2 = "1e-9"  # inertia of a point mass: MuJoCo refuses zero


@dataclass(frozen=True, slots=True)
class MjcfPatch:
    """Patched MJCF file with its difference."""

    text: str
    diff: str  # unified diff against the original
    left_out: tuple[str, ...]  # findings that the file cannot express, each with its value


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
            left_out.append(f"{place} = {value:.{_DIGITS}g}")
    rubbing = {place.partition(".")[0] for place in found if place.split(".")[1] in _FRICTION}
    for name in sorted(rubbing.difference(verdict.creeping)):
        edits.set(("joint",), name, "solimpfriction", _HOLDS)
    for body, values in shares.items():  # several joints weigh the same body
        edits.change_mass(body, factor=1 + float(np.mean(values)))
    for body, loads in payloads.items():
        mass, *at = np.mean(loads, axis=0)
        if not edits.add_point_mass(body, float(mass), at):
            left_out.append(f"payload of {mass:.{_DIGITS}g} kg at {body}, a body without a name")
    if tilts:
        edits.set_option("gravity", " ".join(map(_short, _tilted(model, tilts))))
    after = edits.text
    lines = difflib.unified_diff(
        before.splitlines(keepends=True), after.splitlines(keepends=True), path.name, f"patched {path.name}", n=0
    )
    return MjcfPatch(after, "".join(lines), tuple(left_out))


def _written(edits: "_Edits", joint: Joint, parameter: str, value: float, found: Mapping[str, float]) -> bool:
    """Write a parameter into the file and return whether the format can express it."""
    if parameter == "coulomb_friction.torque":
        value = max(value - joint.followers_dry, 0.0)
    if parameter in _JOINT:
        return edits.set(("joint",), joint.name, _JOINT[parameter], _short(value))
    actuator = joint.actuator
    if actuator is None:
        return False
    if parameter == "ceiling.limit":
        limit = value / abs(actuator.gear)  # of the actuator, before its gear
        return edits.set(_ACTUATORS, actuator.name, "forcerange", f"{_short(-limit)} {_short(limit)}")
    if parameter == "lag.time":
        return edits.set(("position", "intvelocity", "cylinder"), actuator.name, "timeconst", _short(value))
    if parameter not in ("gain.scale", "position_gain.scale"):
        return False
    factor = 1 + found.get(f"{joint.name}.gain.scale", 0.0)
    stiff = factor * (1 + found.get(f"{joint.name}.position_gain.scale", 0.0))
    if edits.kind(_ACTUATORS, actuator.name) == "position":
        edits.set(("position",), actuator.name, "kp", _short(stiff * actuator.kp / actuator.gear**2))
        return edits.set(("position",), actuator.name, "kv", _short(factor * actuator.kd / actuator.gear**2))
    if edits.kind(_ACTUATORS, actuator.name) == "motor":
        return edits.set(("motor",), actuator.name, "gear", _short(factor * actuator.own_gear))
    return False


def _tilted(model: Mechanism, tilts: Mapping[str, Sequence[float]]) -> Array:
    """Return gravity in the frame of a tilted base, m/s^2, [3]; tilts: the angles about each axis, rad."""
    gravity: Array = np.array(model.model.opt.gravity)
    tilted = gravity + sum(float(np.mean(angles)) * model.level_axes[axis] for axis, angles in tilts.items())
    return np.asarray(tilted * np.linalg.norm(gravity) / np.linalg.norm(tilted))


class _Edits:
    """Text of an XML file whose attributes are changed in place."""

    def __init__(self, text: str) -> None:
        self.text = text

    def set(self, tags: Iterable[str], name: str, attribute: str, value: str) -> bool:
        """Set an attribute of the element with a tag and name; return False if the file holds no such element."""
        place = self._place(tuple(tags), name, inside=False)
        if place is None:
            return False
        start, end, _ = place
        tag = self.text[start:end]
        if old := _attribute(tag, attribute):
            tag = f"{tag[: old.start(3)]}{value}{tag[old.end(3) :]}"
        else:
            close = re.search(r"\s*/?>$", tag)
            assert close is not None
            tag = f'{tag[: close.start()]} {attribute}="{value}"{tag[close.start() :]}'
        self.text = self.text[:start] + tag + self.text[end:]
        return True

    def set_option(self, attribute: str, value: str) -> None:
        """Set an attribute of the model's `option`, in a new element if there is none."""
        if not self.set(("option",), "", attribute, value):
            place = self._place(("mujoco",), "", inside=True)
            assert place is not None
            self.text = f'{self.text[: place[1]]}\n  <option {attribute}="{value}"/>{self.text[place[1] :]}'

    def change_mass(self, body: str, factor: float) -> None:
        """Multiply mass and inertia of a body that has an `inertial` element."""
        place = self._place(("inertial",), body, inside=True)
        if place is None:
            return
        tag = self.text[place[0] : place[1]]
        for name in ("mass", "diaginertia", "fullinertia"):
            if old := _attribute(tag, name):
                numbers = [factor * float(x) for x in old[3].split()]
                tag = f"{tag[: old.start(3)]}{' '.join(map(_short, numbers))}{tag[old.end(3) :]}"
        self.text = f"{self.text[: place[0]]}{tag}{self.text[place[1] :]}"

    def add_point_mass(self, body: str, mass_kg: float, at: Iterable[float]) -> bool:
        """Add a body without a joint to a named one, at a place in its frame, [3]; return False without such a name."""
        place = self._place(("body",), body, inside=False)
        if place is None:
            return False
        start, end, _ = place
        indent = self.text[self.text.rfind("\n", 0, start) + 1 : start] + "  "
        more = (
            f'<body name="{body}_payload" pos="{" ".join(map(_short, at))}">'
            f'<inertial pos="0 0 0" mass="{_short(mass_kg)}" diaginertia="{" ".join([_POINT_KG_M2] * 3)}"/></body>'
        )
        self.text = f"{self.text[:end]}\n{indent}{more}{self.text[end:]}"
        return True

    def kind(self, tags: Iterable[str], name: str) -> str | None:
        """Return the tag of a named element."""
        place = self._place(tuple(tags), name, inside=False)
        return None if place is None else place[2]

    def _place(self, tags: tuple[str, ...], name: str, *, inside: bool) -> tuple[int, int, str] | None:
        """Return start, end and tag of an opening tag; `inside`: of the first such element in a named body."""
        data, bodies = self.text.encode(), list[str]()
        found: list[tuple[int, str]] = []
        parser = expat.ParserCreate()

        def begin(tag: str, attributes: Mapping[str, str]) -> None:
            if tag == "body":
                bodies.append(attributes.get("name", ""))
            owner = bodies[-1] if bodies else ""
            if tag in tags and (owner if inside else attributes.get("name", "")) == name and not found:
                found.append((parser.CurrentByteIndex, tag))

        def end(tag: str) -> None:
            if tag == "body":
                bodies.pop()

        parser.StartElementHandler, parser.EndElementHandler = begin, end
        parser.Parse(data, True)
        if not found:
            return None
        at, tag = found[0]
        start = len(data[:at].decode())
        match = re.compile(r"""<(?:[^>"']|"[^"]*"|'[^']*')*>""").match(self.text, start)
        assert match is not None
        return start, match.end(), tag


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
