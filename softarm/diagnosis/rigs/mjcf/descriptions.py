"""Search for columns with another sign, zero, unit or joint than the model's, by the torque of one joint."""

import math
from collections.abc import Iterator
from itertools import combinations

import numpy as np

from softarm.diagnosis.data.poses import Motion
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.laws import joint as laws
from softarm.diagnosis.rigs.mjcf.body_terms import load, torque
from softarm.diagnosis.rigs.mjcf.checks import DEGREES, LEFT, unexplained
from softarm.diagnosis.rigs.mjcf.mechanism import Joint, Mechanism

# Zeros that are tried, rad: descriptions of one arm usually differ by right angles.
TURNS_RAD = (0.5 * math.pi, -0.5 * math.pi, math.pi)
# Units that a column may have instead, with the factor of its readings.
UNITS = (("rad", DEGREES), ("deg", 1 / DEGREES))
# Share of the torque's square that the right description leaves at most, and number of samples that decide.
RIGHT, SAMPLES = 0.1, 300
# Most changes that are named if they explain alike, such as the opposite sign of either of two joints.
ALIKE_MOST = 2


def right_description(
    mechanism: Mechanism, joint: Joint, motions: Motion, command: Array | None = None, most: float = 1.0
) -> str:
    """Return the change of columns, or one of two, with which the motion explains a joint's torque, or "".

    Args:
        mechanism: the model.
        joint: the joint.
        motions: motion of every measured column, smoothed alike.
        command: torque that the joint was given, smoothed as well, N m [T]; None for a joint that nothing drives.
        most: share of the torque's square that the motion may leave, if that is less than usual.
    """
    every = max(len(motions[joint.name][0]) // SAMPLES, 1)
    thin = {name: (x[::every], v[::every], a[::every]) for name, (x, v, a) in motions.items()}
    given = None if command is None else command[::every]
    left = {
        change: _left(mechanism, joint, {**thin, **changed}, given) for change, changed in _changes(mechanism, thin)
    }
    best = min(left.values())
    alike = [change for change in left if best > LEFT * left[change]]
    if best > min(RIGHT, most) or len(alike) > ALIKE_MOST:
        return ""
    return f"with {' or '.join(alike)} it explains {100 * (1 - best):.0f} %"


def misread(mechanism: Mechanism, joint: Joint, motions: Motion) -> str:
    """Return what is certainly wrong with the columns of a joint that nothing drives, with its remedy, or "".

    Weight and the other joints' motion accelerate such a joint, besides friction.

    Args:
        mechanism: the model.
        joint: the joint.
        motions: motion of every measured column, smoothed alike.
    """
    left = _left(mechanism, joint, motions)
    remedy = right_description(mechanism, joint, motions, most=LEFT * left) if left > RIGHT else ""
    if not remedy:
        return ""
    share = f"{100 * (1 - left):.0f} %"
    return f"{joint.name}: by the model, the measured motion explains {share} of its acceleration; {remedy}"


def _changes(mechanism: Mechanism, motions: Motion) -> Iterator[tuple[str, Motion]]:
    """Yield changes of the description of one or two joints, each with the motions that it changes."""
    known = [mechanism.joints[name] for name in motions if name in mechanism.joints]
    for each in known:
        position, speed, acceleration = motions[each.name]
        yield f"`scale: -1` for {each.name}", {each.name: (-position, -speed, -acceleration)}
        for turn in TURNS_RAD if each.turns else ():
            yield f"`add: {turn:.4g}` for {each.name}", {each.name: (position + turn, speed, acceleration)}
        for unit, times in UNITS if each.turns else ():
            changed = times * position, times * speed, times * acceleration
            yield f"`unit: {unit}` for {each.name}", {each.name: changed}
    for one, other in combinations((each.name for each in known), 2):
        yield f"the columns of {one} and {other} exchanged", {one: motions[other], other: motions[one]}


def _left(mechanism: Mechanism, joint: Joint, motions: Motion, command: Array | None = None) -> float:
    """Return the share of a torque's square that the motion leaves; without a command, of the inertia's torque."""
    position, speed, acceleration = motions[joint.name]
    terms = mechanism.terms(joint, mechanism.course(joint, motions))
    friction = np.stack((np.sign(speed), speed), axis=1)
    if command is None:
        return unexplained(terms[laws.INERTIA] * acceleration, friction, -load(terms, position, speed))
    return unexplained(command, friction, torque(terms, position, speed, acceleration))
