"""Errors of a good model that are no effect: masses of single bodies, and the integration of a recorded simulation.

MuJoCo's integrators of first order apply the forces of a step's start to the whole step, so that Coriolis forces have
the speed of half a step ago. A recording that MuJoCo made contains that error; the views here integrate without it.
"""

from collections.abc import Sequence

import numpy as np

from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.laws import joint as laws
from softarm.diagnosis.rigs.mjcf import others
from softarm.diagnosis.rigs.mjcf.mechanism import Change, Course, Joint, Mechanism
from softarm.diagnosis.rigs.motion import Motion

MASS, INTEGRATION = "mass_", "integration"


def shares(mechanism: Mechanism, joint: Joint, of_mass: float, moves: bool) -> dict[str, float]:
    """Return the size of each error of a joint, as a share of the body's mass or of the model's time step.

    Args:
        mechanism: the model.
        joint: the joint.
        of_mass: share of a body's mass; 0 if masses behind the joint have no effect.
        moves: whether other joints move, without which there are no Coriolis forces.
    """
    bodies = joint.bodies if of_mass and len(joint.bodies) > 1 else ()
    late = {INTEGRATION: 1.0} if moves and mechanism.is_first_order else {}
    return {MASS + body: of_mass for body in bodies} | late


def terms(
    mechanism: Mechanism,
    joint: Joint,
    name: str,
    share: float,
    motions: Sequence[Motion],
    around: Sequence[others.Around],
    courses: Sequence[Course],
) -> Array:
    """Return the rigid-body terms [ROWS, M] with one error.

    Args:
        mechanism: the model.
        joint: the joint.
        name: the error.
        share: its size, of `shares`.
        motions: motion of the joint in each trial.
        around: motion of the other joints in each trial.
        courses: motion of the whole model in each trial.
    """
    if name == INTEGRATION:
        late_s = share * mechanism.step_s
        found = [_late(mechanism, joint, m, each, late_s) for m, each in zip(motions, around, strict=True)]
    else:
        heavier = Change(mass_share=share, body=name.removeprefix(MASS))
        found = [mechanism.terms(joint, course, heavier) for course in courses]
    return np.concatenate(found, axis=1)


def _late(mechanism: Mechanism, joint: Joint, motion: Motion, around: others.Around, late_s: float) -> Array:
    """Return the rigid-body terms of a trial if its forces have the speeds of some time ago, [ROWS, T]."""
    moved = {name: (x, v - late_s * a, a) for name, (x, v, a) in around.items()}
    moved[joint.name] = motion.position, motion.speed - late_s * motion.acceleration, motion.acceleration
    found = mechanism.terms(joint, mechanism.course(joint, moved))
    found[laws.INERTIA] -= late_s * found[laws.BY_SPEED]  # the joint's own simulated speed
    return found
