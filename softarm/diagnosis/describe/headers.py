"""Unit, role and quantity that the header of a column suggests: `angle [deg]`, `torque_Nm`, `t/ms`, `Druck (mbar)`."""

import re
from dataclasses import dataclass
from typing import Literal

from softarm.common.quantity import PURE, UNITS, factor

Role = Literal["time", "command", "measured", ""]

# Standard units that a column of a rig may have.
STANDARDS = ("s", "m", "m/s", "rad", "rad/s", "kPa", "N", "N m", "A", "V", "counts", PURE)
# Unit -> other spellings, in small letters.
_SPELLINGS = {
    "s": "sec secs seconds sekunden",
    "ms": "msec",
    "us": "usec",
    "ns": "nsec",
    "deg": "grad degree \N{DEGREE SIGN}",
    "deg/s": "degs dps \N{DEGREE SIGN}/s",
    "rad": "radian radians",
    "rad/s": "radps",
    "m/s": "mps",
    "rpm": "u/min 1/min",
    "counts": "ticks cnt raw lsb",
}
# Words of headers in English and German.
_ROLES: dict[Role, str] = {
    "time": "t time times timestamp stamp zeit zeitstempel clock elapsed date datetime",
    "command": "cmd cmds command commands commanded con control set setpoint sp soll sollwert target ref reference "
    "desired des goal wanted demand demanded input valve ventil pwm duty u w ctrl action actions",
    "measured": "meas measured measurement act actual ist istwert feedback fb state sensor encoder enc output y",
}
_QUANTITIES = {
    "rad": "angle angles ang theta phi alpha beta winkel encoder enc q qpos",
    "m": "position positions pos displacement weg distance dist abstand x",
    "rad/s": "omega drehzahl gyro qd dq qdot qvel rpm",
    "m/s": "vel velocity velocities speed geschwindigkeit",
    "kPa": "pressure press druck chamber kammer",
    "N": "force kraft",
    "N m": "torque torques tau drehmoment moment effort",
    "A": "current strom amps amp",
    "V": "voltage volt volts spannung",
}
# Quantity of a joint without another word, and what a position or velocity of a joint is.
_JOINT = {"joint", "joints"}
_OF_JOINT = {"": "rad", "m": "rad", "m/s": "rad/s"}
# A place in a list is no unit: data[1].
_BRACKETS = re.compile(r"(?!.*\w\[1\])(.*?)[\s_/]*[\[(<{]\s*([^\])>}]+?)\s*[\])>}]\s*")
_SLASH = re.compile(r"(.*?[^\s/])(?:\s*/\s*|\s+in\s+)([^\s/][^/]*(?:/\s*s(?:\^?2)?)?)\s*")
_COMPOUND = re.compile(r"(soll|ist)(\w+)")
_WORD = re.compile(r"[^\W\d_]+")


@dataclass(frozen=True, slots=True)
class Header:
    """Content of a column's header."""

    name: str  # without the unit
    unit: str | None  # as it may be written in a stage.yaml
    role: Role
    quantity: str  # standard unit of the named quantity, or an empty text


def read(text: str) -> Header:
    """Return what a header suggests."""
    name, unit = _split(text)
    words = {word.lower() for word in _WORD.findall(re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name))}
    words |= {part for word in words if (found := _COMPOUND.fullmatch(word)) for part in found.groups()}
    roles: list[Role] = [role for role, known in _ROLES.items() if words & set(known.split())]
    role: Role = roles[0] if roles else ""
    if unit is not None and factor(unit)[1] == "s":
        role = "time"
    quantity = next((of for of, known in _QUANTITIES.items() if words & set(known.split())), "")
    if words & _JOINT:
        quantity = _OF_JOINT.get(quantity, quantity)
    return Header(name, unit, role, factor(unit)[1] if unit is not None else quantity)


def unit_named(text: str) -> str | None:
    """Return a unit as a stage.yaml may have it, or None for a text that is no unit of a column."""
    plain = text.strip()
    spelled = next((unit for unit, others in _SPELLINGS.items() if plain.lower() in others.split()), plain)
    known = {name.lower(): name for own in STANDARDS for name in (own, *UNITS.get(own, {}))}
    for each in (spelled, known.get(spelled.lower(), spelled)):
        try:
            _, standard = factor(each)
        except ValueError:
            continue
        if standard in STANDARDS:
            return "1" if each == PURE else each
    return None


def _split(text: str) -> tuple[str, str | None]:
    """Name and unit of a header."""
    for pattern in (_BRACKETS, _SLASH):
        if (found := pattern.fullmatch(text)) and (unit := unit_named(found[2])):
            return found[1] or text, unit
    parts = re.split(r"[_. ]", text)
    for count in range(min(3, len(parts) - 1), 0, -1):
        end = parts[-count:]
        if unit := _suffix(end):
            return "_".join(parts[:-count]), unit
    if (found := re.fullmatch(r"(.*[a-z])([A-Z][a-z]+)", text)) and (unit := unit_named(found[2].lower())):
        return found[1], unit
    return text, None


def _suffix(parts: list[str]) -> str | None:
    """Return the unit that the end of a name is: `deg`, `Nm`, `rad_s` or `m_s2`."""
    if len(parts) == 1:
        word = parts[0]
        # `p_in` is an inlet, `x_ref` no unit, and of single letters only those in their own case are units.
        if word.lower() in ("in", "-", "raw") or (len(word) == 1 and word not in ("s", "m", "V", "A", "N")):
            return None
        return unit_named(word)
    *words, last = parts
    per = {"s": "/s", "s2": "/s^2"}.get(last)
    if per is not None:
        plain = unit_named(" ".join(words)) or unit_named("".join(words))
        return unit_named(plain + per) if plain and plain != "s" else None
    return unit_named(" ".join(parts))
