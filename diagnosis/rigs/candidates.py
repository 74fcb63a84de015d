"""What may be fitted to a stage of a rig, and what is no news beside it: as `robot/candidates.py`, for tables."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from softarm.diagnosis.engine.candidates import Candidate, FittedParameter, Nuisance
from softarm.diagnosis.rigs.views import RigView
from softarm.simulator.effects import Effect, Parameter

# Half widths: what a well-kept model of a rig may be off by. The zeros are taken in floors of the view. A published
# viscous friction was fitted as the only one, and took the others' share: it is fitted anew beside every rival, or the
# truth could never be reached one effect at a time.
_ABSOLUTE = {
    "gain.scale": 0.01,
    "dead_time.delay": 0.004,
    "stiffness.scale": 0.01,
    "sensor_bias.bias": 0.003,
    "damping.scale": 1.0,
}
_FLOORS = {"gain.offset": 1.0}
_BEYOND = 1.001  # of a box: what lies within it is no news
_SHARES = (0.3, 1.0, 2.5)  # of the usual change: starts


# Seen from command to reading these are one thing: one box holds for both.
_TWINS = {"sensor_bias.bias": "gain.offset", "latency.delay": "dead_time.delay"}


@dataclass(frozen=True, slots=True)
class Falling(FittedParameter):
    """A parameter whose neutral value is its highest: u is how far it has fallen, so that every effect grows with u."""

    top: float = 0.0

    def value(self, u: float) -> float:
        """See FittedParameter; the neutral itself at 0."""
        return self.top - min(max(u, self.low), self.high)


def candidates(view: RigView) -> tuple[Candidate, ...]:
    """Every effect that the stage can have; of those that are one in every recording the first."""
    again = {twin for others in view.twins.values() for twin in others}
    return tuple(_candidate(view, effect) for effect in view.effects if effect.name not in again)


def nuisances(view: RigView) -> tuple[Nuisance, ...]:
    """What is fitted within its box beside every candidate."""
    return tuple(_nuisances(view))


def _candidate(view: RigView, effect: Effect) -> Candidate:
    parameters = tuple(_parameter(view, effect, p) for p in effect.parameters)
    return Candidate(effect.name, view.stage, parameters, tuple(_starts(parameters, effect.parameters)))


def _parameter(view: RigView, effect: Effect, p: Parameter) -> FittedParameter:
    path = f"{effect.name}.{p.name}"
    local = path.partition(".")[2]
    nominal, news = view.nominal(local), _BEYOND * _widths(view).get(local, 0.0)
    if math.isinf(p.neutral):
        u = 0.0 if math.isinf(nominal) else 1 / nominal
        return FittedParameter(
            path, p.unit, u, 0.0, 1 / p.low, abs(1 / p.exemplar - u) or 1 / p.exemplar, 0.0, True, news
        )
    size = p.exemplar if p.default is not None else abs(p.exemplar - nominal) or abs(p.exemplar)
    if p.default is None and p.neutral == p.high > p.low:
        fallen = p.neutral - nominal
        return Falling(path, p.unit, fallen, 0.0, p.neutral - p.low, size, 0.0, news=news, top=p.neutral)
    return FittedParameter(path, p.unit, nominal, p.low, p.high, size, p.neutral, news=news)


def _starts(parameters: Sequence[FittedParameter], declared: Sequence[Parameter]) -> Iterator[tuple[float, ...]]:
    """Changes of several sizes, both ways where the bounds allow; a shape parameter stays as it is."""
    seen = set()
    for share in (*_SHARES, *(-s for s in _SHARES)):
        u = tuple(
            d.nominal if p.default is not None else min(max(d.nominal + share * d.size, d.low), d.high)
            for d, p in zip(parameters, declared, strict=True)
        )
        if u not in seen and u != tuple(d.nominal for d in parameters):
            seen.add(u)
            yield u


def _widths(view: RigView) -> dict[str, float]:
    """'effect.parameter' -> half width of its box."""
    return (
        _ABSOLUTE | {local: share * float(view.floor.max()) for local, share in _FLOORS.items()} | dict(view.tolerances)
    )


def _nuisances(view: RigView) -> Iterator[Nuisance]:
    widths = _widths(view)
    known = {f"{e.name}.{p.name}".partition(".")[2] for e in view.effects for p in e.parameters}
    for effect in view.effects:
        for p in effect.parameters:
            path = f"{effect.name}.{p.name}"
            local = path.partition(".")[2]
            if local in widths and _TWINS.get(local) not in known:
                nominal = view.nominal(local)
                yield Nuisance(path, nominal, max(p.low, nominal - widths[local]), min(p.high, nominal + widths[local]))
