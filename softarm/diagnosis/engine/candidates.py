"""Candidate effects with physical bounds, and nuisance parameters with tolerances."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine.view import Point
from softarm.simulator.effects import Parameter

_SHARES = (0.25, 0.7, 1.5, 3.0)  # starts, in changes of the exemplar
BOUND_SHARE = 0.02  # distance that counts as at a bound, in sizes of a parameter


@dataclass(frozen=True, slots=True)
class FittedParameter:
    """Parameter as the search moves it: one coordinate u, which is 1 / value if the neutral value is infinite."""

    path: str
    unit: str
    nominal: float  # u of the nominal model
    low: float  # physical bounds, u
    high: float
    size: float  # of a usual change, u
    neutral: float  # u at which the effect is absent
    inverse: bool = False
    tolerance: float = 0.0  # change, u, that a well-kept robot may have
    smallest: float = 0.0  # smallest u of an inverse parameter apart from the neutral value
    open_end: bool = False  # `high` ends the form of the law and is no physical bound
    shape: bool = False  # a shape of the law, without meaning if its strength is neutral
    twin: str = ""  # path of a nuisance of which data show only the sum with this parameter
    reach: float = math.inf  # largest step, u, of a fit: a law with jumps is linear only nearby

    def value(self, u: float) -> float:
        """Return the value at a coordinate, in the registry's unit and within the bounds."""
        u = min(max(u, self.low), self.high)
        if not self.inverse:
            return u
        return 1 / max(u, self.smallest) if u > self.smallest / 2 else math.inf

    def margin(self, u: float) -> float:
        """Return the distance to the nearer bound; a shape of zero (rigid friction) is a law's simplest form."""
        low = math.inf if self.shape and self.low == 0.0 else u - self.low
        return min(low, math.inf if self.open_end else self.high - u)


@dataclass(frozen=True, slots=True)
class Candidate:
    """Effect that may be the cause of the gap."""

    name: str
    stage: str
    parameters: tuple[FittedParameter, ...]
    starts: tuple[tuple[float, ...], ...]  # initial u of each parameter
    # Assumptions that are not fitted, such as an encoder's place.
    form: Mapping[str, float] = field(default_factory=dict)
    constant: bool = False  # the model has this parameter already, so its strength is the same everywhere
    far: tuple[tuple[float, ...], ...] = ()  # initial u far from nominal, for a fit of all effects at once

    @property
    def is_missing(self) -> bool:
        """Return whether the model lacks the effect; otherwise a change within tolerance is calibration."""
        return not self.constant and all(d.nominal == d.neutral for d in self.parameters if not d.shape)

    def exceeds_tolerance(self, u: Sequence[float]) -> bool:
        """Return whether a parameter differs from nominal by more than its tolerance."""
        return any(abs(x - d.nominal) > d.tolerance for d, x in zip(self.parameters, u, strict=True))

    def at_bound(self, u: Sequence[float]) -> bool:
        """Return whether a parameter is at a physical bound that is neither its nominal nor its neutral value."""
        return any(
            d.margin(x) < BOUND_SHARE * d.size and min(abs(x - d.nominal), abs(x - d.neutral)) > BOUND_SHARE * d.size
            for d, x in zip(self.parameters, u, strict=True)
        )

    def point(self, u: tuple[float, ...]) -> dict[str, float]:
        """Return the parameters at coordinates u, in the registry's units."""
        return {d.path: d.value(x) for d, x in zip(self.parameters, u, strict=True)} | dict(self.form)


EffectSet = tuple[Candidate, ...]
Coordinates = tuple[tuple[float, ...], ...]  # u of each parameter, one tuple per candidate


def parameters_of(effects: EffectSet) -> list[FittedParameter]:
    """Return the p parameters of a set in order."""
    return [d for each in effects for d in each.parameters]


def joined(u: Coordinates) -> NDArray[np.float64]:
    """Return coordinates as one array, [p]."""
    return np.array([x for us in u for x in us])


def point_of(effects: EffectSet, u: Coordinates) -> dict[str, float]:
    """Return the parameters of a set at coordinates u, in the registry's units."""
    return {path: x for each, us in zip(effects, u, strict=True) for path, x in each.point(us).items()}


def split(effects: EffectSet, x: NDArray[np.float64]) -> Coordinates:
    """Split coordinates [p] into one tuple per effect."""
    parts, at = [], 0
    for each in effects:
        parts.append(tuple(float(v) for v in x[at : at + len(each.parameters)]))
        at += len(each.parameters)
    return tuple(parts)


@dataclass(frozen=True, slots=True)
class Nuisance:
    """Parameter with a tolerance: a good simulator may differ by this much without a gap."""

    path: str
    nominal: float
    low: float  # registry's unit
    high: float

    def at(self, share: float) -> Point:
        """Return the parameter at a share of the way from nominal to the edge of its box, which is exact at 1."""
        return {self.path: self.edge + (share - 1) * (self.edge - self.nominal)}

    @property
    def edge(self) -> float:
        """Return the edge of the box that is further from nominal."""
        return self.high if self.high - self.nominal >= self.nominal - self.low else self.low


def starts(parameters: tuple[FittedParameter, ...], declared: tuple[Parameter, ...]) -> Iterator[tuple[float, ...]]:
    """Yield starts of several sizes in both directions, with shape parameters at three values each."""
    strengths = [d for d, p in zip(parameters, declared, strict=True) if p.default is None]
    shapes = [(d, p) for d, p in zip(parameters, declared, strict=True) if p.default is not None]
    seen = set()
    for share in (*_SHARES, *(-s for s in _SHARES)):
        moved = {d.path: min(max(d.nominal + share * d.size, d.low), d.high) for d in strengths}
        alone = [moved]
        if len(strengths) > 1:  # together and one by one
            still = {d.path: d.nominal for d in strengths}
            alone += [{**still, path: u} for path, u in moved.items()]
        for each in alone:
            for factor in (0.4, 1.0, 2.5) if shapes else (1.0,):
                shaped = {d.path: min(max((p.default or 0.0) * factor, d.low), d.high) for d, p in shapes}
                u = tuple((each | shaped)[d.path] for d in parameters)
                if u not in seen and any(each[d.path] != d.nominal for d in strengths):
                    seen.add(u)
                    yield u
