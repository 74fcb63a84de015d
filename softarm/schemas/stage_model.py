"""Channels and keys of the nominal model of each kind of stage, for stage.yaml.

docs/reference/trials.md shows both; `python -m softarm.schemas.stage_model` prints the second.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, get_args

from softarm.common.quantity import PURE, Quantity, shown
from softarm.common.words import did_you_mean

StageKind = Literal["tracking", "driven_mass", "pendulum", "chain", "mujoco"]
# Kinds that recordings alone can describe; the others need a model file.
DESCRIBED: tuple[StageKind, ...] = tuple(kind for kind in get_args(StageKind) if kind != "mujoco")
Pairs = tuple[tuple[float, float], ...]
ModelValue = float | str | tuple[float, ...] | Pairs

LINKS_MAX = 12
# Base units that a column may have, by the beginning of its name. Other columns may have any unit.
COLUMN_UNITS: dict[str, tuple[str, ...]] = {
    "position": ("m", "rad", "counts", PURE),
    "velocity": ("m/s", "rad/s", "counts/s", "-/s", PURE),
    "pressure": ("kPa",),
    "force": ("N", "N m"),
    "current": ("A",),
    "voltage": ("V",),
    "torque": ("N m",),
    "angle": ("rad",),
    "rate": ("rad/s",),
}


@dataclass(frozen=True, slots=True)
class Channel:
    """Columns that a kind of stage reads from one channel; N in a name is the number of the link."""

    any_of: tuple[str, ...]  # at least one of these is required
    others: tuple[str, ...] = ()
    optional: bool = False  # the whole channel
    named_after: str = ""  # columns may have any name: those of the model's joints, actuators, sites or bodies
    instead_of: str = ""  # the other channel, which need not be given beside it

    def needed(self, links: int) -> tuple[str, ...]:
        """Return the names of which at least one column is required."""
        return _counted(self.any_of, links)

    def columns(self, links: int) -> tuple[str, ...]:
        """Return all names that a column may have."""
        return _counted((*self.any_of, *self.others), links)


def _counted(names: tuple[str, ...], links: int) -> tuple[str, ...]:
    """Replace each name that ends with N by one name a link."""
    each = ((f"{name[:-1]}{i}" for i in range(1, links + 1)) if name[-1] == "N" else (name,) for name in names)
    return tuple(name for group in each for name in group)


# Kind -> channel -> its columns. A tracking stage is judged by the first present column of `measured`.
CHANNELS: dict[StageKind, dict[str, Channel]] = {
    "tracking": {
        "command": Channel(("command",)),
        "measured": Channel(("position", "pressure", "velocity", "value"), ("effort",)),
    },
    "driven_mass": {
        "force": Channel(("force", "current", "voltage")),
        "measured": Channel(("position", "velocity")),
    },
    "pendulum": {
        "measured": Channel(("angleN",), ("rateN",)),
        "base": Channel(("position",), optional=True),
    },
    "chain": {
        "measured": Channel(("angleN",), ("rateN",)),
        "torque": Channel(("torqueN",), optional=True),
        "base": Channel(("position",), optional=True),
    },
    "mujoco": {
        "measured": Channel((), named_after="joint"),
        "mocap": Channel((), named_after="coordinate of a site or body", instead_of="measured"),
        "command": Channel((), optional=True, named_after="actuator"),
        "torque": Channel((), optional=True, named_after="joint"),
        "base": Channel((), optional=True, named_after="joint"),  # joints that are moved from outside
    },
}


@dataclass(frozen=True, kw_only=True)
class ModelKey(Quantity):
    """One key of `model:`: a quantity, its number of values, and whether it is required."""

    each: Literal["one", "link", "pairs", "text"] = "one"
    needed: bool = False
    instead: str = ""  # the other key that it replaces
    called: tuple[str, ...] = ()  # other spellings, for hints


_MEASURED, _PER_COMMAND = "measured", "measured/command"  # units as the file's own columns have them
_LINKS = (
    ModelKey(name="mass_kg", unit="kg", low=0, above=True, each="link", needed=True, called=("mass", "m"),
             meaning="mass of each link"),
    ModelKey(name="centre_m", unit="m", low=0, each="link", needed=True, called=("center_m", "com_m", "r"),
             meaning="from each joint to its link's centre of mass"),
    ModelKey(name="inertia_kg_m2", unit="kg m^2", low=0, each="link", needed=True, called=("inertia",),
             meaning="of each link, about its centre of mass"),
    ModelKey(name="length_m", unit="m", low=0, above=True, each="link", called=("length", "l"),
             meaning="from each joint to the next; the last link's may be left out"),
    ModelKey(name="damping_nm_s_rad", unit="N m s/rad", low=0, each="link", default=0.0,
             called=("damping", "viscous", "viscous_nm_s_rad"),
             meaning="viscous friction of each joint; one number stands for all"),
    ModelKey(name="gravity_m_s2", unit="m/s^2", low=0, high=30, default=9.81, called=("g", "gravity"),
             meaning="0 for links that turn in a horizontal plane"),
)  # fmt: skip
MODEL_KEYS: dict[StageKind, tuple[ModelKey, ...]] = {
    "tracking": (
        ModelKey(name="lag_s", unit="s", low=0, high=1000, default=0.0,
                 called=("time_constant_s", "time_constant", "tau_s", "tau", "lag"),
                 meaning="time constant of the first-order lag that follows the command"),
        ModelKey(name="delay_s", unit="s", low=0, high=100, default=0.0,
                 called=("dead_time_s", "dead_time", "latency_s", "delay"),
                 meaning="dead time before a command acts"),
        ModelKey(name="gain", unit=_PER_COMMAND, called=("scale", "static_gain", "k"),
                 meaning="what is reached for one of the command; 1 where both have one unit"),
        ModelKey(name="offset", unit=_MEASURED, default=0.0, called=("bias", "zero"),
                 meaning="what is reached at a command of zero"),
        ModelKey(name="map", each="pairs", called=("table", "curve", "lookup"),
                 meaning="instead of gain and offset: [command, reached] pairs, commands rising; lines between"),
        ModelKey(name="rate_limit", unit=f"{_MEASURED}/s", low=0, above=True, called=("rate_limit_m_s", "max_rate"),
                 meaning="it moves no faster than this"),
        ModelKey(name="acceleration_limit", unit=f"{_MEASURED}/s^2", low=0, above=True, called=("max_acceleration",),
                 meaning="its rate changes no faster than this"),
    ),
    "driven_mass": (
        ModelKey(name="mass_kg", unit="kg", low=0, above=True, called=("mass", "m"),
                 meaning="what the force moves along a line; or inertia_kg_m2"),
        ModelKey(name="inertia_kg_m2", unit="kg m^2", low=0, above=True, called=("inertia",),
                 meaning="what the torque turns; or mass_kg"),
        ModelKey(name="gain", unit="N or N m per N, N m, A or V", default=1.0,
                 called=("motor_constant", "torque_constant", "force_constant", "kt"),
                 meaning="force (torque) for one of the input, A and V even where the column has mA; "
                         "needed where it is a current or a voltage"),
        ModelKey(name="viscous", unit="N s/m or N m s/rad", low=0, default=0.0,
                 called=("damping", "viscous_n_s_m", "viscous_nm_s_rad", "damping_n_s_m", "damping_nm_s_rad"),
                 meaning="friction that grows with the speed"),
        ModelKey(name="coulomb", unit="N or N m", low=0, default=0.0,
                 called=("coulomb_n", "coulomb_nm", "dry", "friction", "frictionloss"),
                 meaning="dry friction, the same at every speed"),
        ModelKey(name="offset", unit="N or N m", default=0.0, called=("gravity", "load", "bias"),
                 meaning="a constant force besides, in the direction of the position: a weight on a slope"),
        ModelKey(name="delay_s", unit="s", low=0, high=100, default=0.0,
                 called=("dead_time_s", "dead_time", "latency_s", "delay"), meaning="dead time before a force acts"),
    ),
    "pendulum": _LINKS,
    "chain": (
        *_LINKS,
        ModelKey(name="inertia_joint_kg_m2", unit="kg m^2", low=0, above=True, each="link", instead="inertia_kg_m2",
                 meaning="of each link alone about its joint, instead of inertia_kg_m2"),
        ModelKey(name="coulomb_nm", unit="N m", low=0, each="link", default=0.0,
                 called=("coulomb", "dry", "friction", "frictionloss"),
                 meaning="dry friction of each joint; one number stands for all"),
        ModelKey(name="armature_kg_m2", unit="kg m^2", low=0, each="link", default=0.0,
                 called=("rotor_inertia_kg_m2", "armature"),
                 meaning="rotor behind its gear (inertia x ratio^2) of each joint: counts for the joint's own turning"),
    ),
    "mujoco": (
        ModelKey(name="mjcf", each="text", needed=True, called=("urdf", "xml", "file", "path"),
                 meaning="MJCF or URDF file, relative to the stage.yaml or to the data folder"),
    ),
}  # fmt: skip


def complaints(kind: StageKind, model: Mapping[object, object], links: int) -> Iterator[tuple[str, str]]:
    """Yield the errors of a model as (key, sentence); the key is empty if the model as a whole is incomplete."""
    known = {key.name: key for key in MODEL_KEYS[kind]}
    for name, value in model.items():
        if name not in known:
            meant = next((key.name for key in known.values() if name in key.called), None)
            near = f"did you mean {meant}? " if meant else did_you_mean(str(name), known)
            yield str(name), f"unknown key; {near}the model of a {kind} stage has {', '.join(known)}"
        elif said := _complaint(known[name], value, links):
            yield str(name), said
    if kind == "driven_mass":
        if len({"mass_kg", "inertia_kg_m2"} & model.keys()) != 1:
            yield "", "a driven_mass stage needs either mass_kg (it moves along a line) or inertia_kg_m2; write one"
    elif twice := [key for key in known.values() if {key.name, key.instead} <= model.keys()]:
        yield twice[0].name, f"is given together with {twice[0].instead}; keep one of the two"
    elif lacking := [
        key
        for key in known.values()
        if key.needed and not model.keys() & {key.name, *(k.name for k in known.values() if k.instead == key.name)}
    ]:
        named = ", ".join(f"{key.name} ({key.meaning})" for key in lacking)
        yield "", f"the model of a {kind} stage lacks {named}; add it"
    if "map" in model and (both := sorted({"gain", "offset"} & model.keys())):
        yield "map", f"is given together with {' and '.join(both)}; keep one of the two: the map holds gain and offset"
    if links > 1 and "length_m" in known and "length_m" not in model:
        yield "", f"{links} links need length_m, from each joint to the next; add it"


def _complaint(key: ModelKey, value: object, links: int) -> str:
    """Return the error of one key's value, or an empty text."""
    if key.each == "text":
        return "" if isinstance(value, str) and value else f"is {shown(value)}; allowed a file; write its path"
    if key.each == "pairs":
        return _wrong_map(value)
    if not isinstance(value, list | tuple):
        if key.name == "gain" and value == 0:
            return "is 0, so nothing would move; write the value that is reached per unit of the command"
        if not key.takes(value):
            return key.complaint(value)
        if key.each == "one" or key.default is not None:
            return ""
        value = [value]
    elif key.each == "one":
        return f"is a list; allowed one number, {key}; write one"
    if bad := [each for each in value if not key.takes(each)]:
        return key.complaint(bad[0])
    least = links - 1 if key.name == "length_m" else links
    if not least <= len(value) <= links and not (len(value) == 1 and key.default is not None):
        count = f"{len(value)} number{'s' * (len(value) != 1)}"
        return f"has {count}, the stage has {links} links; write a list with one for each, or correct `links`"
    return ""


def _wrong_map(value: object) -> str:
    pairs = value if isinstance(value, list | tuple) else []
    whole = all(isinstance(p, list | tuple) and len(p) == 2 and all(map(Quantity().takes, p)) for p in pairs)
    if len(pairs) < 2 or not whole:
        said = "a list" if isinstance(value, list | tuple) else shown(value)
        return f"is {said}; allowed two [command, reached] pairs or more; write e.g. [[0, 0], [10, 250]]"
    if any(before[0] >= after[0] for before, after in pairwise(pairs)):
        return "has commands that do not rise; sort the pairs by their command, each command once"
    return ""


def table() -> str:
    """Return the table of docs/reference/trials.md: every key of every kind of stage."""
    rows = ["| kind | key | unit | allowed | default | meaning |", "|---|---|---|---|---|---|"]
    kinds: dict[ModelKey, list[str]] = {}
    for kind in get_args(StageKind):
        for key in MODEL_KEYS[kind]:
            kinds.setdefault(key, []).append(kind)
    for key, having in kinds.items():
        plain = Quantity(low=key.low, high=key.high, above=key.above).bounds or "any"
        allowed = {"one": plain, "link": f"{plain}; one for each link", "pairs": "a list of pairs", "text": "a file"}[
            key.each
        ]
        default = "needed" if key.needed else "-" if key.default is None else f"{key.default:g}"
        names = ", ".join(having)
        rows.append(f"| {names} | `{key.name}` | {key.unit} | {allowed} | {default} | {key.meaning} |")
    return "\n".join(rows)


if __name__ == "__main__":
    print(table())
