"""Candidate effects of the robot with their tolerances and starts; everything else comes from the registry."""

import math
from collections.abc import Collection, Iterator, Mapping

from softarm.diagnosis.engine.candidates import Candidate, FittedParameter, Nuisance, starts
from softarm.diagnosis.robot.views import ABOUT_RAIL, ON_MOTOR
from softarm.schemas.model import Model
from softarm.simulator.effects import REGISTRY, Parameter, find, value

# Half widths of the boxes: absolute in the registry's unit, or relative to the nominal value.
_ABSOLUTE = {
    "pressure.dead_time.delay": 0.006,
    "pressure.gain.scale": 0.01,
    "pressure.gain.offset": 0.1,
    "rail.delay.delay": 0.004,
    "rail.lag.time": 0.006,
    "rail.gain.scale": 0.005,
    "rail.coulomb_friction.viscous": 1.0,
    "arm.stiffness.scale": 0.06,  # a beam in more pieces than the model's bends 5 % more softly
    "arm.tilt.angle": 0.003,
    "mocap.latency.delay": 0.002,
    "mocap.rotation.angle": 0.001,
    "mocap.scale.scale": 0.001,
    "mocap.offset.y": 0.001,
    "mocap.offset.z": 0.001,
}
_RELATIVE = {
    "pressure.lag.inflate": 0.06,
    "pressure.lag.deflate": 0.06,
    "rail.acceleration_limit.acceleration": 0.08,
}
# Difference between well-kept robots, if it is not twice the box.
_TOLERANCE = {
    "pressure.deadband.width": 0.4,
    "pressure.gain.offset": 0.2,
    "pressure.leak.rate": 0.13,  # lowers the pressure as much as the smallest gain beyond tolerance
    "pressure.sensor_bias.bias": 0.12,  # a zero error is fitted with it
    "rail.lag.time": 0.010,
    "rail.coulomb_friction.force": 0.4,
    "rail.backlash.gap": 0.0008,
    "arm.stiffness.scale": 0.075,  # 2 % of independent robots with constants off by 1 to 3 % exceed 0.065
    "arm.damping.scale": 0.22,
    "arm.muscle_gain.scale": 0.048,
    "arm.torque_offset.scale": 0.25,
    "arm.coulomb_friction.torque": 0.002,
    "arm.stiffening.cubic": 0.4,
    "arm.hysteresis.strength": 0.06,
    "arm.payload.mass": 0.0065,
    "arm.tilt.angle": 0.008,
    "arm.drag.coefficient": 0.003,
    "arm.creep.strength": 0.05,
}
# A muscle with several plays turns back less than the strongest loop of our law.
_OPEN_ENDS = ("arm.hysteresis.strength",)
_TOLERANCE_SHARE = 0.1  # default tolerance, in usual changes
_STAGES = ("pressure", "rail", "arm", "mocap")
_COUNTED = ("mocap.dropout", "mocap.noise")  # measured from stamps and noise (robot/counts.py)
# Relative errors of parameters that every model has: they are constant in time and over excitations. A delay is not,
# since its strength varies with the drive's law.
_CONSTANT = ("rail.gain", "arm.stiffness", "arm.damping", "arm.muscle_gain", "arm.torque_offset")
# A valve acts at other commands if its dead zone is 0.05 kPa wider: starts lie that close, from 0.25 to 5 kPa, and no
# step of a fit is longer.
_JUMP_KPA = 0.05
_REACH = {"pressure.deadband.width": _JUMP_KPA}
_MANY_STARTS: dict[str, tuple[tuple[float, ...], ...]] = {
    "pressure.deadband": tuple((_JUMP_KPA * i,) for i in range(5, 101)),
}
# Without the arm's motion, the regulator's reading shows only the sum of this parameter and a nuisance.
_SUMMED = {"pressure.sensor_bias.bias": "pressure.gain.offset"}
_FORMS: dict[str, tuple[dict[str, float], ...]] = {
    "rail.gain": ({}, {ON_MOTOR: 1.0}),
    "rail.backlash": ({}, {ON_MOTOR: 1.0}),
    "mocap.rotation": ({}, {ABOUT_RAIL: 0.0}),
}


def candidates(model: Model, stages: Collection[str] = _STAGES) -> tuple[Candidate, ...]:
    """Return every effect that a fit can find for a nominal model, in causal order; stages: those that are compared."""
    summed = {} if "arm" in stages else _SUMMED
    names = [n for n, e in REGISTRY.items() if e.stage in _STAGES and e.parameters and n not in _COUNTED]
    return tuple(each for name in names for each in _forms(name, model, summed))


def nuisances(model: Model) -> tuple[Nuisance, ...]:
    """Return the parameters that are fitted within their boxes in every fit."""
    found = []
    for path, half in (_ABSOLUTE | _RELATIVE).items():
        effect, parameter = find(path)
        nominal = value(model, effect.name, parameter.name)
        if not math.isfinite(nominal) or (path in _RELATIVE and nominal == parameter.neutral):
            continue
        width = half * abs(nominal) if path in _RELATIVE else half
        low, high = max(parameter.low, nominal - width), min(parameter.high, nominal + width)
        found.append(Nuisance(path, nominal, low, high))
    return tuple(found)


def _forms(name: str, model: Model, summed: Mapping[str, str]) -> Iterator[Candidate]:
    effect = REGISTRY[name]
    parameters = tuple(_parameter(name, p, model, summed.get(f"{name}.{p.name}", "")) for p in effect.parameters)
    for form in _FORMS.get(name, ({},)):
        begun = _MANY_STARTS.get(name) or tuple(starts(parameters, effect.parameters))
        yield Candidate(name, effect.stage, parameters, begun, form, name in _CONSTANT)


def _parameter(name: str, p: Parameter, model: Model, twin: str) -> FittedParameter:
    path, nominal = f"{name}.{p.name}", value(model, name, p.name)
    if math.isinf(p.neutral):
        u = 0.0 if math.isinf(nominal) else 1 / nominal
        size = abs(1 / p.exemplar - u) or 1 / p.exemplar
        return FittedParameter(
            path, p.unit, u, 0.0, (1 - 1e-9) / p.low, size, 0.0, True, _tolerance(path, u, size), (1 + 1e-9) / p.high
        )
    size = p.exemplar if p.default is not None else abs(p.exemplar - p.neutral)
    return FittedParameter(
        path,
        p.unit,
        nominal,
        p.low,
        p.high,
        size,
        p.neutral,
        tolerance=_tolerance(path, nominal, size),
        open_end=path in _OPEN_ENDS,
        shape=p.default is not None,
        twin=twin,
        reach=_REACH.get(path, math.inf),
    )


def _tolerance(path: str, nominal: float, size: float) -> float:
    if path in _TOLERANCE:
        return _TOLERANCE[path]
    if path in _RELATIVE and nominal:
        return 2 * _RELATIVE[path] * abs(nominal)
    return 2 * _ABSOLUTE[path] if path in _ABSOLUTE else _TOLERANCE_SHARE * size
