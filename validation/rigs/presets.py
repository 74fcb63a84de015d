"""The machines of the corpus; their sizes, time scales and units vary as much as those of real rigs."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np

from validation.rigs.laws import GRAVITY_M_S2

Plant = Literal["velocity axis", "position axis", "chamber", "cart", "pendulum", "arm", "cart-pendulum"]
Kind = Literal["tracking", "driven_mass", "pendulum", "chain"]
KINDS: Final[dict[Plant, Kind]] = {
    "velocity axis": "tracking",
    "position axis": "tracking",
    "chamber": "tracking",
    "cart": "driven_mass",
    "pendulum": "pendulum",
    "arm": "chain",
    "cart-pendulum": "chain",
}
Parameters = Mapping[str, float | tuple[float, ...]]


@dataclass(frozen=True, slots=True)
class Rig:
    """Nominal description of a machine, as its owner knows it."""

    name: str  # name of the stage
    plant: Plant
    pace_s: float  # time scale: a lag, or the duration of a motion
    rate_hz: float  # sample rate of a recording
    reach: float  # half of the range of the command, in the base unit (kPa, m, m/s or rad)
    centre: float = 0.0
    measured_unit: str = "rad"
    measured_worth: float = 1.0  # base units per measured unit
    command_unit: str = "rad"
    command_worth: float = 1.0  # base units that are reached per unit of the command
    quantum: float = 0.0  # resolution of the sensor, in the base unit
    duration_s: tuple[float, float] = (8.0, 12.0)
    one_file: bool = False  # whether command and measurement are columns of one file
    parameters: Parameters = field(default_factory=dict)  # parameters of the plant, without the lag

    @property
    def kind(self) -> Kind:
        """Return the kind of the stage."""
        return KINDS[self.plant]


_DEG = math.pi / 180
_PSI, _BAR, _MBAR = 6.894757, 100.0, 0.1
_SMALL = {"mass_kg": (0.15,), "centre_m": (0.15,), "inertia_kg_m2": (1.2e-3,), "length_m": (0.3,)}
_LARGE = {"mass_kg": (3.0,), "centre_m": (0.6,), "inertia_kg_m2": (0.4,), "length_m": (1.1,)}
_TRIPLE = {
    "mass_kg": (0.5, 0.35, 0.2),
    "centre_m": (0.12, 0.1, 0.08),
    "inertia_kg_m2": (2.5e-3, 1.3e-3, 5e-4),
    "length_m": (0.25, 0.2, 0.16),
}
_ARM = {
    "mass_kg": (2.0, 1.2),
    "centre_m": (0.18, 0.16),
    "inertia_kg_m2": (0.022, 0.012),
    "length_m": (0.35, 0.32),
}
_POLE = {"mass_kg": (0.25,), "centre_m": (0.2,), "inertia_kg_m2": (3.5e-3,), "length_m": (0.4,)}
RIGS: Final[dict[str, Rig]] = {
    rig.name: rig
    for rig in (
        Rig("belt", "velocity axis", 0.025, 250, 0.8, 0.0, "m/s", 1.0, "m/s", 1.0),
        Rig("gantry", "velocity axis", 0.35, 50, 0.12, 0.0, "mm/s", 1e-3, "mm/s", 1e-3, duration_s=(12, 18)),
        Rig("stage", "position axis", 0.008, 500, 2e-3, 0.0, "mm", 1e-3, "mm", 1e-3, 1e-6, (8, 9)),
        Rig("servo", "position axis", 0.09, 50, 40 * _DEG, 0.0, "deg", _DEG, "deg", _DEG, 0.088 * _DEG, (10, 16), True),
        Rig("shoulder", "position axis", 0.4, 100, 1.0, 0.2, "rad", 1.0, "rad", 1.0, 2e-4, (12, 20), True),
        Rig("bellows", "chamber", 0.04, 200, 8.0, 14.0, "mbar", _MBAR, "mbar", _MBAR, 0.02, (8, 11), False,
            {"supply_kpa": 45.0}),
        Rig("finger", "chamber", 0.2, 60, 40.0, 62.0, "psi", _PSI, "psi", _PSI, 0.05, (10, 16), True,
            {"supply_kpa": 190.0}),
        Rig("tank", "chamber", 1.5, 50, 120.0, 200.0, "bar", _BAR, "bar", _BAR, 0.2, (20, 20), False,
            {"supply_kpa": 700.0}),
        # Command and measurement have different units.
        Rig("grip", "chamber", 0.12, 100, 60.0, 100.0, "kPa", 1.0, "V", 40.0, 0.1, (8, 14), False,
            {"supply_kpa": 300.0}),
        Rig("cart", "cart", 0.25, 100, 0.15, 0.0, "mm", 1e-3, "N", 1.0, 5e-5, (10, 14), False, {"mass_kg": 1.2}),
        Rig("slide", "cart", 0.06, 500, 0.02, 0.0, "mm", 1e-3, "A", 22.0, 1e-6, (8, 9), True, {"mass_kg": 8.0}),
        Rig("coil", "cart", 0.02, 500, 1e-3, 0.0, "um", 1e-6, "mA", 9e-3, 2e-7, (8, 8), False, {"mass_kg": 0.05}),
        Rig("pendulum", "pendulum", 0.14, 200, 1.3, quantum=1e-3, duration_s=(10, 14), parameters=_SMALL),
        Rig("boom", "pendulum", 0.28, 100, 1.2, quantum=3e-4, duration_s=(14, 20), parameters=_LARGE,
            measured_unit="deg", measured_worth=_DEG),
        Rig("chain", "pendulum", 0.15, 200, 0.7, quantum=4e-4, duration_s=(8, 10), parameters=_TRIPLE),
        Rig("arm", "arm", 0.25, 250, 0.6, 0.4, command_unit="N m", quantum=2e-4, duration_s=(8, 10), parameters=_ARM),
        Rig("pole", "cart-pendulum", 0.25, 200, 0.12, quantum=1e-3, duration_s=(10, 14), parameters=_POLE),
    )
}  # fmt: skip


def moments_of(rig: Rig) -> tuple[float, ...]:
    """Return the moment of the weight on each joint of a chain, N m."""
    mass, centre, length = (np.ravel(rig.parameters[k]) for k in ("mass_kg", "centre_m", "length_m"))
    beyond = np.concatenate((np.cumsum(mass[::-1])[::-1][1:], [0.0]))
    return tuple(float(m) for m in GRAVITY_M_S2 * (mass * centre + length * beyond))


def damping_of(rig: Rig) -> tuple[float, ...]:
    """Return the viscous friction of each joint of a chain, N m s; joints with motors have more."""
    ratio = {"pendulum": 0.004, "cart-pendulum": 0.02, "arm": 0.03}[rig.plant]
    return tuple(2 * ratio * moment * rig.pace_s for moment in moments_of(rig))


def mass_of(rig: Rig) -> float:
    """Return the mass of a cart, kg."""
    return float(np.ravel(rig.parameters["mass_kg"])[0])
