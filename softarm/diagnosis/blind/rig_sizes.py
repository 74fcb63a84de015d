"""True sizes of rigs' faults, for those whose law the diagnosis shares."""

import math
from collections.abc import Callable, Mapping
from typing import Any, Final

from softarm.reality.rigs.presets import RIGS, Kind, Rig, mass_of
from softarm.reality.rigs.record import nominal
from softarm.schemas.verdict import Estimate

Size = Callable[[Rig, float], float]


def _same(rig: Rig, value: float) -> float:
    return value


def _beyond_nominal_delay(rig: Rig, value: float) -> float:
    """Return the whole delay; the fault adds to the delay that the rig's owner knows."""
    return float(nominal(rig).get("delay_s", 0.0)) + value  # type: ignore[arg-type]


def _relative_mass(rig: Rig, value: float) -> float:
    return value / mass_of(rig) - 1


def _hertz(rig: Rig, value: float) -> float:
    return value / math.tau


# Setting of a fault -> effect.parameter of the diagnosis, and its size in standard units.
_CHAIN: Final[Mapping[str, tuple[str, Size]]] = {
    "drag_n_s2_m2": ("drag.coefficient", _same),
    "payload_kg": ("payload.mass", _same),
    "tilt_rad": ("tilt.angle", _same),
    "strength": ("gain.scale", _same),
    "delay_s": ("dead_time.delay", _beyond_nominal_delay),
}
_SIZES: Final[Mapping[Kind, Mapping[str, tuple[str, Size]]]] = {
    "tracking": {
        "delay_s": ("dead_time.delay", _beyond_nominal_delay),
        "late_s": ("latency.delay", _same),
        "lag_s": ("lag.rise", _same),
        "lag_down_s": ("lag.fall", _same),
        "rate": ("rate_limit.rate", _same),
        "acceleration": ("acceleration_limit.acceleration", _same),
        "gain": ("gain.scale", _same),
        "offset": ("gain.offset", _same),
        "dead_zone": ("deadband.width", _same),
        "ceiling": ("ceiling.limit", _same),
        "bias": ("sensor_bias.bias", _same),
        "gap": ("backlash.gap", _same),
        "mode_rad_s": ("second_order.frequency", _hertz),
    },
    "driven_mass": {
        "friction_up_n": ("coulomb_friction.force", _same),
        "viscous_n_s_m": ("damping.viscous", _same),
        "drag_n_s2_m2": ("drag.coefficient", _same),
        "force_n": ("force_offset.force", _same),
        "mass_kg": ("mass.scale", _relative_mass),
        "gain": ("gain.scale", _same),
        "delay_s": ("dead_time.delay", _beyond_nominal_delay),
        "lag_s": ("lag.time", _same),
        "gap_m": ("backlash.gap", _same),
    },
    "pendulum": {"moment": ("stiffness.scale", _same), **_CHAIN},
    "chain": _CHAIN,
}


def true_sizes(truth: Mapping[str, Any]) -> dict[str, float]:
    """Return the true value of each `effect.parameter` that a case's truth states, in standard units."""
    rig, table = RIGS[truth["rig"]], _SIZES[truth["kind"]]
    found = {}
    for cause in truth["causes"]:
        settings = cause["settings"]
        uneven = len({settings[name] for name in ("friction_up_n", "friction_down_n") if name in settings}) > 1
        for name, value in settings.items():
            if name in table and not uneven and not isinstance(value, list):
                path, size = table[name]
                if path.partition(".")[0] in cause["names"]:
                    found[path] = size(rig, value)
    return found


def in_standard_units(estimate: Estimate, rig: Rig) -> tuple[float, float]:
    """Return the ends of an interval, which has the units of the rig's table, in standard units."""
    for unit, worth in ((rig.measured_unit, rig.measured_worth), (rig.command_unit, rig.command_worth)):
        if estimate.unit == unit or estimate.unit.startswith(f"{unit}/"):
            return estimate.low * worth, estimate.high * worth
    return estimate.low, estimate.high


def held(truth: Mapping[str, Any], answer: Mapping[str, Any]) -> dict[str, bool]:
    """Return for each size that the truth states and the answer names whether the interval holds it."""
    rig, true, found = RIGS[truth["rig"]], true_sizes(truth), {}
    for effect in answer["verdict"]["effects"] if answer["verdict"] else ():
        for name, given in effect["parameters"].items():
            path = f"{effect['name'].rpartition('.')[2]}.{name}"
            if path in true:
                low, high = in_standard_units(Estimate.model_validate(given), rig)
                found[path] = low <= true[path] <= high
    return found
