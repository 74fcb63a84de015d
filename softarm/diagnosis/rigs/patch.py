"""Patch of a rig: its stage.yaml with the named effects and the calibration as the nominal model."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from softarm.common import yaml_lines
from softarm.diagnosis.data import stage_file
from softarm.diagnosis.rigs.mjcf.effects import MASS
from softarm.schemas.verdict import Verdict

_HEADER = "# Nominal model with the findings of a diagnosis. --data names the folder of its tables.\n"
# Written in place of infinity, in any unit.
ABSENT = 1e12
_LINK = re.compile(r"(inertia|mass)(\d+)")  # calibrated change of one link of a chain, relative


def patched(path: Path, verdict: Verdict, calibration: bool, best_fit: bool = False) -> str | None:
    """Return a stage.yaml with the findings of its diagnosis, or None if there are none.

    Args:
        path: stage.yaml that was diagnosed.
        verdict: its verdict, in the units of the file's columns.
        calibration: whether calibrated parameters are written as well.
        best_fit: whether stages with a best fit get that instead.
    """
    data: dict[str, Any] = yaml_lines.read(path, "").data
    found = {place: value for place, (value, _) in verdict.findings(calibration, best_fit).items()}
    if not found:
        return None
    (first, *_) = stage_file.load(path)
    if "mechanisms" not in data:
        data = {"name": first.name, **data}
    effects = {name: dict(values) for name, values in data.pop("effects", {}).items()}
    for place, value in sorted(found.items()):
        name, _, parameter = place.rpartition(".")
        if not name or parameter.startswith(MASS):
            continue  # of the model file (--patch FILE.xml)
        if link := _LINK.fullmatch(parameter):
            about = data["mechanisms"][name] if "mechanisms" in data else data
            about["model"] |= _reweighed(about["model"], about["links"], link[1], int(link[2]) - 1, value)
        else:
            effects.setdefault(name, {})[parameter] = _short(value)
    return _HEADER + yaml.safe_dump(data | {"effects": effects}, sort_keys=False, width=120, default_flow_style=None)


def _reweighed(model: dict[str, Any], links: int, of: str, i: int, share: float) -> dict[str, list[float]]:
    """Return the keys of a chain's model that change if a link's mass or inertia grows by a share.

    The inertia about the centre of mass keeps its value if the mass grows. Inertias come first, so that an inertia
    about the joint is split by the nominal mass.
    """
    key = next(name for name in ("inertia_kg_m2", "inertia_joint_kg_m2") if name in model)
    values = (np.broadcast_to(np.asarray(model[name], dtype=float), links) for name in ("mass_kg", "centre_m", key))
    mass, centre, inertia = (each.tolist() for each in values)
    arm = mass[i] * centre[i] ** 2
    if of == "inertia":
        inertia[i] += share * (inertia[i] - (arm if key == "inertia_joint_kg_m2" else 0.0))
    else:
        mass[i] *= 1 + share
        inertia[i] += share * arm if key == "inertia_joint_kg_m2" else 0.0
    return {"mass_kg": [*map(_short, mass)], key: [*map(_short, inertia)]}


def _short(value: float) -> float:
    """Return a value with seven significant digits; an absent limit as a finite one that nothing reaches."""
    return float(f"{min(value, ABSENT):.7g}")
