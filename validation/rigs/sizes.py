"""True sizes of rigs' faults, for those whose law the diagnosis shares."""

import math
from collections.abc import Mapping
from typing import Any, Final

from softarm.schemas.verdict import Estimate
from validation.rigs.follower import LONGER_SHARE
from validation.rigs.presets import RIGS, Kind, Rig, mass_of
from validation.rigs.record import nominal

# Setting of a fault -> effect.parameter of the diagnosis.
_CHAIN: Final[Mapping[str, str]] = {
    "drag_n_s2_m2": "drag.coefficient",
    "payload_kg": "payload.mass",
    "tilt_rad": "tilt.angle",
    "strength": "gain.scale",
    "delay_s": "dead_time.delay",
}
_SIZES: Final[Mapping[Kind, Mapping[str, str]]] = {
    "tracking": {
        "delay_s": "dead_time.delay",
        "late_s": "latency.delay",
        "lag_s": "lag.rise",
        "lag_down_s": "lag.fall",
        "rate": "rate_limit.rate",
        "acceleration": "acceleration_limit.acceleration",
        "gain": "gain.scale",
        "offset": "gain.offset",
        "dead_zone": "deadband.width",
        "ceiling": "ceiling.limit",
        "bias": "sensor_bias.bias",
        "gap": "backlash.gap",
        "mode_rad_s": "second_order.frequency",
    },
    "driven_mass": {
        "friction_up_n": "coulomb_friction.force",
        "viscous_n_s_m": "damping.viscous",
        "drag_n_s2_m2": "drag.coefficient",
        "force_n": "force_offset.force",
        "mass_kg": "mass.scale",
        "gain": "gain.scale",
        "delay_s": "dead_time.delay",
        "lag_s": "lag.time",
        "gap_m": "backlash.gap",
    },
    "pendulum": {"moment": "stiffness.scale", **_CHAIN},
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
                path = table[name]
                if path.partition(".")[0] in cause["names"]:
                    found[path] = _size(rig, name, value)
    return found


def _size(rig: Rig, setting: str, value: float) -> float:
    """Return a setting of a fault as the parameter of the diagnosis."""
    match setting:
        case "delay_s":  # the fault adds to the delay that the rig's owner knows
            return float(nominal(rig).get("delay_s", 0.0)) + value  # type: ignore[arg-type]
        case "lag_s" | "lag_down_s" if rig.kind == "tracking":
            return value * LONGER_SHARE
        case "mass_kg":
            return value / mass_of(rig) - 1
        case "mode_rad_s":
            return value / math.tau
        case "tilt_rad":  # of the links against gravity; the diagnosis tilts gravity
            return -value
    return value


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
