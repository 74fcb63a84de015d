"""Errors of a good model that are no effect: masses of single parts."""

from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.mjcf.mechanism import Change, Joint
from softarm.diagnosis.rigs.mjcf.others import OtherJoints

MASS = "mass_"


def shares(joint: Joint, of_mass: float) -> dict[str, float]:
    """Return the size of each error of a joint, as a share of the part's mass; of_mass: 0 if masses have no effect."""
    return {MASS + part: of_mass for part in joint.parts if of_mass and len(joint.parts) > 1}


def terms(others: OtherJoints, joint: Joint, name: str, share: float) -> Array:
    """Return the rigid-body terms [ROWS, M] with an error of `shares`."""
    return others.terms(Change(mass_share=share, bodies=joint.parts[name.removeprefix(MASS)]))
