"""Refinement of the arm model: each of its n links is cut into m pieces.

Mass, inertia, static bending and relaxation of the whole arm stay the same. A joint of the model represents the
bending of the beam around it. A triangular weight, as wide as one link on each side, spreads this bending over the
joints of the finer chain, so its amount and its centre stay the same. Only the first joint, at the clamp, stays whole.

Springs in series add their compliances: with the weights w, 1/k_j = sum_i w_ij / K_i. Muscle gain, torque offset and
relaxation time D/K of a fine joint are means over the model's joints, weighted with w_ij / K_i. With these weights, the
angles under a pressure and their rates add up to the model's. A piece has 1/m of the mass and the length of its link.
Its inertia is chosen so that the inertia of the whole link stays the same.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softarm.schemas.model import Arm

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Chain:
    """Properties of the fine links, arrays [m n]; joint j carries link j."""

    length_m: Array
    mass_kg: Array
    # About the link's centre.
    inertia_kg_m2: Array
    stiffness_nm_rad: Array
    damping_nm_s_rad: Array
    muscle_gain_nm_kpa: Array
    torque_offset_nm: Array
    # Angle of a fine joint as a share of the model's angle at that place, for non-linear laws.
    share: Array


def refine(arm: Arm, pieces: int) -> Chain:
    """Cut every link of an arm into equal pieces.

    Raises:
        ValueError: A joint has no stiffness, or the links have too little inertia for so many pieces.
    """
    stiffness = np.array(arm.stiffness_nm_rad)
    if not (stiffness > 0).all():
        raise ValueError(f"stiffness_nm_rad is {arm.stiffness_nm_rad}; a beam needs every entry above 0")
    compliance = _shares(arm.links, pieces) / stiffness  # [m n, n]
    total = compliance.sum(axis=1)

    def mean(values: tuple[float, ...] | Array) -> Array:
        return np.asarray(compliance @ np.asarray(values) / total)

    k = 1 / total
    length, mass = np.array(arm.link_length_m), np.array(arm.link_mass_kg)
    # Steiner's terms of the pieces about the whole link's centre.
    spread = mass * length**2 * (pieces**2 - 1) / (12 * pieces**2)
    inertia = np.array(arm.link_inertia_kg_m2) - spread
    if not (inertia > 0).all():
        raise ValueError(
            f"link_inertia_kg_m2 is {arm.link_inertia_kg_m2}; {pieces} pieces need more than {spread.tolist()}"
        )
    return Chain(
        length_m=np.repeat(length / pieces, pieces),
        mass_kg=np.repeat(mass / pieces, pieces),
        inertia_kg_m2=np.repeat(inertia / pieces, pieces),
        stiffness_nm_rad=k,
        damping_nm_s_rad=k * mean(np.array(arm.damping_nm_s_rad) / stiffness),
        muscle_gain_nm_kpa=mean(arm.muscle_gain_nm_kpa),
        torque_offset_nm=mean(arm.torque_offset_nm),
        share=total / mean(1 / stiffness),
    )


def _shares(links: int, pieces: int) -> Array:
    """Return the share of each model joint's compliance at each fine joint, [m n, n]; columns add up to 1."""
    fine = np.arange(links * pieces)[:, None]
    distance = np.abs(fine - pieces * np.arange(links))
    shares: Array = np.clip(pieces - distance, 0, None) / pieces**2
    shares[:, 0] = fine[:, 0] == 0
    return shares
