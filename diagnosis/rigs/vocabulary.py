"""The effects of single-stage tables: the registry's, under the table's own name, and what such a rig has beyond them.

`servo1.deadband` is `pressure.deadband` for a thing whose unit is rad; meaning and source come from the registry.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from softarm.diagnosis.rigs.scales import Span
from softarm.schemas.trial import StageKind
from softarm.simulator.effect_table import shape, strength
from softarm.simulator.effects import REGISTRY, Effect, Parameter

__all__ = ["Effect", "Parameter", "effects"]


@dataclass(frozen=True, slots=True)
class _Use:
    """A registry effect on a rig: how its parameters are called there, and which of them a rig does not have."""

    origin: str  # empty: beyond the registry, see _SECOND_ORDER
    names: Mapping[str, str]  # registry parameter -> here
    meaning: str = ""  # where the rig's law differs
    downwards: Mapping[str, str] = field(default_factory=dict)  # registry parameter -> a second one, for the other way


# What a follower of commands can do wrong, in the order in which a command meets it.
_TRACKING: dict[str, _Use] = {
    "dead_time": _Use("pressure.dead_time", {"delay": "delay"}, meaning="it starts to react late"),
    "gain": _Use(
        "pressure.gain",
        {"scale": "scale", "offset": "offset"},
        meaning="it ends at the nominal end x (1 + scale) + offset: a proportional loop droops under a load",
    ),
    "ceiling": _Use(
        "pressure.ceiling", {"limit": "limit"}, meaning="it ends at no more than this: what drives it saturates"
    ),
    "deadband": _Use(
        "pressure.deadband",
        {"width": "width"},
        meaning="an error up to the width, either way, moves nothing: dry friction against a proportional loop",
    ),
    "lag": _Use(
        "pressure.lag",
        {"inflate": "rise", "deflate": "fall"},
        meaning="it nears the command exponentially, with an own time constant upwards and downwards",
    ),
    "rate_limit": _Use(
        "pressure.rate_limit",
        {"rate": "rate"},
        meaning="it moves no faster than this, upwards and downwards",
        downwards={"rate": "fall"},
    ),
    "acceleration_limit": _Use(
        "rail.acceleration_limit",
        {"acceleration": "acceleration"},
        meaning="its velocity changes no faster than this: a motor's torque has an end",
    ),
    "second_order": _Use("", {"frequency": "frequency", "damping": "damping", "coupling": "coupling"}),
    "backlash": _Use("rail.backlash", {"gap": "gap"}),
    "hysteresis": _Use(
        "arm.hysteresis",
        {"strength": "strength", "width": "width"},
        meaning="a loop between command and end, as wide at any speed (Bouc-Wen): soft material, no free travel",
    ),
    "coulomb_friction": _Use(
        "rail.coulomb_friction",
        {"force": "loss"},
        meaning="dry friction against a loop of speed: it stays behind by this, either way, and stands still below",
    ),
    "sensor_bias": _Use("pressure.sensor_bias", {"bias": "bias"}, meaning="the sensor reads high"),
    "latency": _Use("mocap.latency", {"delay": "delay"}, meaning="readings are older than their stamps say"),
}
_KINDS: dict[str, dict[str, _Use]] = {"tracking": _TRACKING}

# Beyond the registry: the robot's regulator and rail are first-order, other people's loops ring.
_SECOND_ORDER = Effect(
    "second_order",
    (
        strength("frequency", "Hz", math.inf, 0.01, 1000.0, 5.0, "undamped natural frequency"),
        shape("damping", "-", 0.5, 0.02, 0.9, 0.5, "damping ratio; from 1 on it would be lags"),
        # Beyond 0 .. 1, so that either end is none of the range.
        shape("coupling", "-", 0.0, -0.25, 1.25, 0.5, "share of the damping between what is driven and what is seen"),
    ),
    "it follows as a second-order system: a mass on a spring, a loop with an integrator",
    "standard second-order system, w^2 / (s^2 + 2 z w s + w^2); Franklin, Powell and Emami-Naeini, Feedback Control",
)
# Registry's unit -> how often what is measured is divided by seconds.
_TIMES = {"kPa": 0, "m": 0, "N": 0, "kPa/s": 1, "m/s^2": 2}

# Pairs easily taken for each other on a rig, and what tells them apart; beside what the registry says.
_RIVALS: tuple[tuple[str, str, str], ...] = (
    ("deadband", "backlash", "reversals under load: play shuts, a friction's dead zone stays"),
    ("deadband", "lag", "a slow ramp: a lag's error shrinks with its slope, a dead zone's stays"),
    (
        "rate_limit",
        "acceleration_limit",
        "fast sines of two sizes: a rate limit makes triangles, the other turns over late",
    ),
    ("hysteresis", "backlash", "small reversals: play hides them whole, a loop lets a part through"),
    ("hysteresis", "deadband", "small reversals: a dead zone hides them whole, a loop lets a part through"),
    ("hysteresis", "lag", "the same loop at three rates: its area stays for hysteresis"),
    (
        "second_order",
        "lag",
        "a step: a second-order system starts flat and may overshoot, a lag starts with its steepest slope",
    ),
    (
        "second_order",
        "dead_time",
        "a multisine over a decade: a resonance changes the size of what it passes, a dead time does not",
    ),
    ("second_order", "acceleration_limit", "steps of several sizes: only a limit takes longer for larger ones"),
    (
        "dead_time",
        "latency",
        "only the sum shows from command to reading; another sensor's stamps of the same motion split it",
    ),
    ("gain", "sensor_bias", "another sensor, or a hand on the zero: a wrong reading stays when what is read is right"),
    ("ceiling", "deadband", "an amplitude sweep: a ceiling leaves low commands alone"),
    ("rate_limit", "lag", "steps of several sizes: the time grows with the step only for a limit"),
    ("acceleration_limit", "lag", "sines of two sizes: only a limit answers the larger one less"),
    ("coulomb_friction", "gain", "a sweep of commands: a gain's error grows, dry friction's not"),
    ("coulomb_friction", "deadband", "slowing down without a stop: friction helps, a dead zone stays above"),
)


def effects(kind: StageKind, stage: str, unit: str, spans: Mapping[str, Span] | None = None) -> tuple[Effect, ...]:
    """Every effect that a stage of this kind can have.

    unit: of what is measured; spans: 'effect.parameter' -> bounds on this rig, from its recording
    (`scales.tracking_spans`): an effect that has no span there cannot be told from it.
    """
    uses = _KINDS[kind]
    if spans is not None:
        uses = {name: use for name, use in uses.items() if any(key.startswith(f"{name}.") for key in spans)}
    return tuple(_effect(stage, name, uses, unit, spans or {}) for name in uses)


def _effect(stage: str, name: str, uses: Mapping[str, _Use], unit: str, spans: Mapping[str, Span]) -> Effect:
    use = uses[name]
    registered = REGISTRY[use.origin] if use.origin else _SECOND_ORDER
    known = {p.name: p for p in registered.parameters}
    parameters = [
        _parameter(known[there], here, unit, spans.get(f"{name}.{here}"))
        for there, here in (*use.names.items(), *use.downwards.items())
    ]
    differences = dict(text.split(": ", 1) for text in registered.separated_by.split("; ") if ": " in text)
    apart = {other: differences[u.origin] for other, u in uses.items() if u.origin in differences and other != name}
    for one, other, how in _RIVALS:
        if name in (one, other) and {one, other} <= uses.keys():
            apart[other if name == one else one] = how
    return Effect(
        f"{stage}.{name}",
        tuple(parameters),
        use.meaning or registered.meaning,
        registered.source,
        tuple(f"{stage}.{other}" for other in apart),
        "; ".join(f"{stage}.{other}: {how}" for other, how in apart.items()),
    )


def _parameter(p: Parameter, name: str, unit: str, span: Span | None) -> Parameter:
    """The registry's parameter on this rig: its name, its unit, its bounds."""
    found = replace(p, name=name, unit=_unit(p.unit, unit))
    if span is None:
        return found
    own = p.default if p.default is None else span.usual
    neutral = found.neutral if span.neutral is None else span.neutral
    neutral = span.usual if own is not None else neutral
    return replace(found, low=span.low, high=span.high, exemplar=span.usual, neutral=neutral, default=own)


def _unit(registered: str, unit: str) -> str:
    """The registry's unit with the length or pressure in it replaced by what is measured here."""
    times = _TIMES.get(registered)
    if times is None:
        return registered
    base, _, below = unit.partition("/s")
    times += 0 if not below and "/s" not in unit else int(below.lstrip("^") or 1)
    return base + ("" if times == 0 else "/s" if times == 1 else f"/s^{times}")
