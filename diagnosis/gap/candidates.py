"""What may be fitted: effects as candidates with physical bounds, and what lies within tolerance beside every one.

Everything about an effect is read from the registry; here stand only where a search starts and what is no news.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from softarm.diagnosis.gap.robot_views import ABOUT_RAIL, ON_MOTOR
from softarm.diagnosis.gap.view import Point
from softarm.schemas.model import Model
from softarm.simulator.effects import REGISTRY, Parameter, value

BOUND_SHARE = 0.02  # of a parameter's size: closer to a bound than this is at it


@dataclass(frozen=True, slots=True)
class FittedParameter:
    """A parameter as a search moves it: one coordinate u. Where the neutral value is infinite, u = 1 / value."""

    path: str
    unit: str
    nominal: float  # u of the nominal model
    low: float  # physical bounds, u
    high: float
    size: float  # of a usual change, u
    neutral: float  # u at which the effect is absent
    inverse: bool = False
    news: float = 0.0  # a smaller change, u, is none that anybody would call a gap
    least: float = 0.0  # of an inverse parameter: below lies nothing but the neutral value

    def value(self, u: float) -> float:
        """In the registry's unit, within the bounds."""
        u = min(max(u, self.low), self.high)
        if not self.inverse:
            return u
        return 1 / max(u, self.least) if u > self.least / 2 else math.inf


@dataclass(frozen=True, slots=True)
class Candidate:
    """An effect that may be the cause. `form`: what is assumed with it (where an encoder sits); no number to fit."""

    name: str
    stage: str
    parameters: tuple[FittedParameter, ...]
    starts: tuple[tuple[float, ...], ...]  # where a search begins, u of each parameter
    form: Mapping[str, float] = field(default_factory=dict)

    def is_news(self, u: Sequence[float]) -> bool:
        """Whether a parameter is off its nominal value by more than well-kept robots are."""
        return any(abs(x - d.nominal) >= d.news for d, x in zip(self.parameters, u, strict=True))

    def at_bound(self, u: Sequence[float]) -> bool:
        """Whether a parameter stands at a physical bound that is neither its nominal nor its neutral value."""
        return any(
            min(x - d.low, d.high - x) < BOUND_SHARE * d.size
            and min(abs(x - d.nominal), abs(x - d.neutral)) > BOUND_SHARE * d.size
            for d, x in zip(self.parameters, u, strict=True)
        )

    def point(self, u: tuple[float, ...]) -> dict[str, float]:
        """The registry's parameters at coordinates u."""
        return {d.path: d.value(x) for d, x in zip(self.parameters, u, strict=True)} | dict(self.form)


@dataclass(frozen=True, slots=True)
class Nuisance:
    """A parameter that a well-kept simulator may be off by without anybody calling it a gap: a box about nominal."""

    path: str
    nominal: float
    low: float  # registry's unit
    high: float

    @property
    def point(self) -> Point:
        """At the edge of the box that is further away: the column of a linear model is taken there."""
        return {self.path: self.edge}

    @property
    def edge(self) -> float:
        """See point."""
        return self.high if self.high - self.nominal >= self.nominal - self.low else self.low


# Half widths of the boxes: absolute in the registry's unit, or relative to the nominal value.
_ABSOLUTE = {
    "pressure.dead_time.delay": 0.006,
    "pressure.gain.scale": 0.02,
    "pressure.gain.offset": 0.15,
    "rail.delay.delay": 0.004,
    "rail.lag.time": 0.006,
    "rail.gain.scale": 0.01,
    "rail.coulomb_friction.viscous": 1.0,
    "arm.tilt.angle": 0.003,
    "mocap.latency.delay": 0.002,
    "mocap.rotation.angle": 0.002,
    "mocap.scale.scale": 0.002,
    "mocap.offset.y": 0.002,
    "mocap.offset.z": 0.002,
}
_RELATIVE = {
    "pressure.lag.inflate": 0.10,
    "pressure.lag.deflate": 0.10,
    "rail.acceleration_limit.acceleration": 0.08,
}
# Smallest change that is news, where it is not twice the box: what well-kept robots of one kind differ by.
_NEWS = {
    "pressure.deadband.width": 0.4,
    "pressure.gain.offset": 0.3,
    "pressure.sensor_bias.bias": 0.3,
    "rail.lag.time": 0.012,
    "rail.coulomb_friction.force": 0.5,
    "rail.backlash.gap": 0.001,
    "arm.stiffness.scale": 0.08,
    "arm.damping.scale": 0.30,
    "arm.muscle_gain.scale": 0.07,
    "arm.torque_offset.scale": 0.4,
    "arm.coulomb_friction.torque": 0.003,
    "arm.stiffening.cubic": 0.4,
    "arm.hysteresis.strength": 0.12,
    "arm.payload.mass": 0.007,
    "arm.tilt.angle": 0.008,
    "arm.drag.coefficient": 0.003,
    "arm.creep.strength": 0.08,
}
_NEWS_SHARE = 0.1  # of a usual change, where neither a box nor a line above says more
# Of single joints, for ArmView.joint_directions: shares of the joint's own value, the offset's of the largest joint's.
JOINT_SHARES = {
    "stiffness_nm_rad": 0.05,
    "damping_nm_s_rad": 0.15,
    "muscle_gain_nm_kpa": 0.05,
    "torque_offset_nm": 0.10,
}
_STAGES = ("pressure", "rail", "arm", "mocap")
_COUNTED = ("mocap.dropout", "mocap.noise")  # read off stamps and noise, not fitted (diagnosis.gap.counts)
_FORMS: dict[str, tuple[dict[str, float], ...]] = {
    "rail.gain": ({}, {ON_MOTOR: 1.0}),
    "rail.backlash": ({}, {ON_MOTOR: 1.0}),
    "mocap.rotation": ({}, {ABOUT_RAIL: 0.0}),
}
_SHARES = (0.25, 0.7, 1.5, 3.0)  # of the exemplar's change: starts


def candidates(model: Model) -> tuple[Candidate, ...]:
    """Every effect of the robot that a fit can find, for a nominal model; in causal order."""
    names = [n for n, e in REGISTRY.items() if e.stage in _STAGES and e.parameters and n not in _COUNTED]
    return tuple(each for name in names for each in _forms(name, model))


def nuisances(model: Model) -> tuple[Nuisance, ...]:
    """What is fitted within its box beside every candidate."""
    return tuple(_nuisances(model))


def _nuisances(model: Model) -> Iterator[Nuisance]:
    for path, half in (_ABSOLUTE | _RELATIVE).items():
        effect, _, name = path.rpartition(".")
        parameter = next(p for p in REGISTRY[effect].parameters if p.name == name)
        nominal = value(model, effect, name)
        if not math.isfinite(nominal) or (path in _RELATIVE and nominal == parameter.neutral):
            continue
        width = half * abs(nominal) if path in _RELATIVE else half
        yield Nuisance(path, nominal, max(parameter.low, nominal - width), min(parameter.high, nominal + width))


def _forms(name: str, model: Model) -> Iterator[Candidate]:
    effect = REGISTRY[name]
    parameters = tuple(_parameter(name, p, model) for p in effect.parameters)
    for form in _FORMS.get(name, ({},)):
        yield Candidate(name, effect.stage, parameters, tuple(starts(parameters, effect.parameters)), form)


def _parameter(name: str, p: Parameter, model: Model) -> FittedParameter:
    path, nominal = f"{name}.{p.name}", value(model, name, p.name)
    if math.isinf(p.neutral):
        u = 0.0 if math.isinf(nominal) else 1 / nominal
        size = abs(1 / p.exemplar - u) or 1 / p.exemplar
        return FittedParameter(
            path, p.unit, u, 0.0, (1 - 1e-9) / p.low, size, 0.0, True, _news(path, u, size), (1 + 1e-9) / p.high
        )
    size = p.exemplar if p.default is not None else abs(p.exemplar - p.neutral)
    return FittedParameter(path, p.unit, nominal, p.low, p.high, size, p.neutral, news=_news(path, nominal, size))


def _news(path: str, nominal: float, size: float) -> float:
    if path in _NEWS:
        return _NEWS[path]
    if path in _RELATIVE and nominal:
        return 2 * _RELATIVE[path] * abs(nominal)
    return 2 * _ABSOLUTE[path] if path in _ABSOLUTE else _NEWS_SHARE * size


def starts(parameters: tuple[FittedParameter, ...], declared: tuple[Parameter, ...]) -> Iterator[tuple[float, ...]]:
    """Changes of several sizes, both ways where the bounds allow; with a shape parameter at three of its values."""
    strengths = [d for d, p in zip(parameters, declared, strict=True) if p.default is None]
    shapes = [(d, p) for d, p in zip(parameters, declared, strict=True) if p.default is not None]
    seen = set()
    for share in (*_SHARES, *(-s for s in _SHARES)):
        moved = {d.path: min(max(d.nominal + share * d.size, d.low), d.high) for d in strengths}
        alone = [moved]
        if len(strengths) > 1:  # both together, and each for itself
            still = {d.path: d.nominal for d in strengths}
            alone += [{**still, path: u} for path, u in moved.items()]
        for each in alone:
            for factor in (0.4, 1.0, 2.5) if shapes else (1.0,):
                shaped = {d.path: min(max((p.default or 0.0) * factor, d.low), d.high) for d, p in shapes}
                u = tuple((each | shaped)[d.path] for d in parameters)
                if u not in seen and any(each[d.path] != d.nominal for d in strengths):
                    seen.add(u)
                    yield u
