"""Effects and nuisances that may be fitted to a stage of a rig (for the soft arm: `robot/candidates.py`)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from softarm.diagnosis.engine.candidates import Candidate, FittedParameter, Nuisance
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.rigs.views import RigView
from softarm.simulator.effects import Effect, Parameter

# Half-widths of the errors that a good nominal model may have. The viscous friction is free: a published value was
# usually fitted as the only friction and holds the share of all others.
_ABSOLUTE = {
    "gain.scale": 0.01,
    "dead_time.delay": 0.004,
    "stiffness.scale": 0.01,
    "sensor_bias.bias": 0.003,
    "damping.scale": 1.0,
}
# An effect counts only beyond this multiple of its parameter's half-width.
_BEYOND = 1.001
# Starting values of a fit, as shares of the usual change.
_SHARES = (0.3, 1.0, 2.5)
# A mass is known no better than the force on it, where it has no half-width of its own.
_KNOWN_AS = {"mass.scale": "gain.scale"}
# Pairs of which a reading shows only the sum: only the second one is a nuisance.
_SUMMED = {"sensor_bias.bias": "gain.offset", "latency.delay": "dead_time.delay"}


@dataclass(frozen=True, slots=True)
class Falling(FittedParameter):
    """Parameter whose neutral value is its highest; u is the fall below it, so that every effect grows with u."""

    top: float = 0.0

    def value(self, u: float) -> float:
        """Return the parameter's value at u; the neutral value at 0."""
        return self.top - min(max(u, self.low), self.high)


def candidates(view: RigView) -> tuple[Candidate, ...]:
    """Return every effect that the stage can have, of a group of indistinguishable effects only the first."""
    without = {name for others in view.indistinguishable.values() for name in others}
    without |= {f"{view.stage}.{effect}" for effect in view.corrects}
    return tuple(candidate(view, _alone(view, effect)) for effect in view.effects if effect.name not in without)


def nuisances(view: RigView) -> tuple[Nuisance, ...]:
    """Return the parameters that are fitted within their boxes next to every candidate."""
    steps = {path: float(values[1] - values[0]) for path, values in view.curved.items()}
    widths, found = {**_widths(view), **steps}, []
    known = {f"{e.name}.{p.name}".partition(".")[2] for e in view.effects for p in e.parameters}
    for effect in view.effects:
        for p in effect.parameters:
            path = f"{effect.name}.{p.name}"
            local = path.partition(".")[2]
            if local in widths and _SUMMED.get(local) not in known:
                nominal, width = view.nominal(local), widths[local]
                found.append(Nuisance(path, nominal, max(p.low, nominal - width), min(p.high, nominal + width)))
    found += [Nuisance(path, size.value, size.low, size.high) for path, size in view.held.items()]
    return tuple(found)


def setup_of(view: RigView, kinds: Sequence[str], origins: Sequence[int]) -> Setup:
    """Return the problem of a view.

    Args:
        view: view of a stage.
        kinds: excitation of each of its trials.
        origins: recording that each trial was cut from.
    """
    return Setup([view], nuisances(view), kinds, origins, view.block_s)


def candidate(view: RigView, effect: Effect) -> Candidate:
    """Return an effect of a view as the search moves it."""
    parameters = tuple(_parameter(view, effect, p) for p in effect.parameters)
    name = effect.name.rpartition(".")[2]
    far = tuple((u,) for u in view.far_starts.get(name, ()))
    first = starts(parameters)
    if name in view.gap_starts:
        suggested = tuple(map(_within, parameters, view.gap_starts[name]))
        first = (*first, suggested) if any(map(_beyond_usual, parameters, suggested)) else first
    return Candidate(effect.name, view.stage, parameters, first, far=far)


def _alone(view: RigView, effect: Effect) -> Effect:
    """Return an effect with the parameters that a stage alone determines."""
    name = effect.name.rpartition(".")[2]
    return replace(
        effect, parameters=tuple(p for p in effect.parameters if f"{name}.{p.name}" not in view.only_together)
    )


def _parameter(view: RigView, effect: Effect, p: Parameter) -> FittedParameter:
    path = f"{effect.name}.{p.name}"
    local = path.partition(".")[2]
    widths = _widths(view)
    nominal, news = view.nominal(local), _BEYOND * widths.get(local, widths.get(_KNOWN_AS.get(local, ""), 0.0))
    if math.isinf(p.neutral):
        u = 0.0 if math.isinf(nominal) else 1 / nominal
        return FittedParameter(
            path, p.unit, u, 0.0, 1 / p.low, abs(1 / p.exemplar - u) or 1 / p.exemplar, 0.0, True, news
        )
    size = p.exemplar if p.default is not None else abs(p.exemplar - nominal) or abs(p.exemplar)
    if p.default is None and p.neutral == p.high > p.low:
        fallen = p.neutral - nominal
        return Falling(path, p.unit, fallen, 0.0, p.neutral - p.low, size, 0.0, tolerance=news, top=p.neutral)
    shape, stage = p.default is not None, effect.name.partition(".")[0]
    twin = f"{stage}.{_SUMMED[local]}" if local in _SUMMED else ""
    return FittedParameter(
        path, p.unit, nominal, p.low, p.high, size, p.neutral, tolerance=news, shape=shape, twin=twin
    )


def starts(parameters: Sequence[FittedParameter]) -> tuple[tuple[float, ...], ...]:
    """Return changes of several sizes, in both directions where the bounds allow; shape parameters keep their value."""
    nominal = tuple(d.nominal for d in parameters)
    moved = [
        tuple(d.nominal if d.shape else _within(d, d.nominal + share * d.size) for d in parameters)
        for share in (*_SHARES, *(-s for s in _SHARES))
    ]
    return tuple(u for u in dict.fromkeys(moved) if u != nominal)


def _within(parameter: FittedParameter, u: float) -> float:
    return min(max(u, parameter.low), parameter.high)


def _beyond_usual(parameter: FittedParameter, u: float) -> bool:
    """Return whether a change is larger than every usual initial one."""
    return abs(u - parameter.nominal) > _SHARES[-1] * parameter.size


def _widths(view: RigView) -> dict[str, float]:
    """Return the half-width of every nuisance's box by 'effect.parameter'."""
    return {**_ABSOLUTE, "gain.offset": float(view.floor.max()), **view.tolerances}
