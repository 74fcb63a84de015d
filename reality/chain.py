"""From the model's n links to m times as many: same mass, inertia, static bending and relaxation, finer.

A joint of the model stands for the bending of the beam around it. Here that bending is spread over the joints of
the finer chain by a triangle of one link's half-width, so that neither its amount nor its centre moves (only the
first joint, which stands at the clamp, stays whole). Springs in series add their compliances: with the shares w,
compliance 1/k_j = sum_i w_ij / K_i. Muscle gain, offset and relaxation time D/K of a fine joint are the means of
the model's, weighted with w_ij / K_i, which is what makes the angles under a pressure, and their rates, add up to
the model's. A piece of a link has 1/m of its mass and length and so much inertia that the whole keeps its own.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softarm.schemas.model import Arm

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Chain:
    """Per fine link, arrays [m n]; joint j carries link j."""

    length_m: Array
    mass_kg: Array
    inertia_kg_m2: Array  # about the link's centre
    stiffness_nm_rad: Array
    damping_nm_s_rad: Array
    muscle_gain_nm_kpa: Array
    torque_offset_nm: Array
    share: Array  # a fine joint's angle as a share of the model's joint there, for laws that are not linear


def refine(arm: Arm, pieces: int) -> Chain:
    """Cut every link of `arm` into `pieces`. Raises ValueError for a joint without stiffness."""
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
    """Share of each model joint's compliance at each fine joint, [m n, n]; columns add up to 1."""
    fine = np.arange(links * pieces)[:, None]
    distance = np.abs(fine - pieces * np.arange(links))
    shares: Array = np.clip(pieces - distance, 0, None) / pieces**2
    shares[:, 0] = fine[:, 0] == 0
    return shares
