"""What may be fitted: an effect as a candidate with physical bounds, and what lies within tolerance beside each."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine.view import Point
from softarm.simulator.effects import Parameter

_SHARES = (0.25, 0.7, 1.5, 3.0)  # of the exemplar's change: starts
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
    open_end: bool = False  # `high` is where the law's form ends, not what is physical: what is strong may stand there

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
    # A parameter that the model has already: no law is missing, so its strength is the same everywhere.
    constant: bool = False

    def is_news(self, u: Sequence[float]) -> bool:
        """Whether a parameter is off its nominal value by more than well-kept robots are."""
        return any(abs(x - d.nominal) >= d.news for d, x in zip(self.parameters, u, strict=True))

    def at_bound(self, u: Sequence[float]) -> bool:
        """Whether a parameter stands at a physical bound that is neither its nominal nor its neutral value."""
        return any(
            min(x - d.low, math.inf if d.open_end else d.high - x) < BOUND_SHARE * d.size
            and min(abs(x - d.nominal), abs(x - d.neutral)) > BOUND_SHARE * d.size
            for d, x in zip(self.parameters, u, strict=True)
        )

    def point(self, u: tuple[float, ...]) -> dict[str, float]:
        """The registry's parameters at coordinates u."""
        return {d.path: d.value(x) for d, x in zip(self.parameters, u, strict=True)} | dict(self.form)


Set = tuple[Candidate, ...]
U = tuple[tuple[float, ...], ...]  # coordinates, a tuple for each candidate


def point_of(effects: Set, u: U) -> dict[str, float]:
    """The registry's parameters of a set at coordinates u."""
    return {path: x for each, us in zip(effects, u, strict=True) for path, x in each.point(us).items()}


def split(effects: Set, x: NDArray[np.float64]) -> U:
    """Coordinates in a row, [p], to a tuple for each effect."""
    parts, at = [], 0
    for each in effects:
        parts.append(tuple(float(v) for v in x[at : at + len(each.parameters)]))
        at += len(each.parameters)
    return tuple(parts)


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
