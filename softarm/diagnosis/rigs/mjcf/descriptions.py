"""Search for columns with another sign, zero or joint than the model's, by the torque that one joint was given."""

import math
from collections.abc import Iterator
from itertools import combinations

import numpy as np

from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.mjcf.checks import LEFT, unexplained
from softarm.diagnosis.rigs.mjcf.mechanism import Joint, Mechanism
from softarm.diagnosis.rigs.mjcf.poses import Motion
from softarm.diagnosis.rigs.mjcf.torques import torque

# Zeros that are tried, rad: descriptions of one arm usually differ by right angles.
TURNS_RAD = (0.5 * math.pi, -0.5 * math.pi, math.pi)
# Share of the torque's square that the right description leaves at most, and number of samples that decide.
RIGHT, SAMPLES = 0.1, 300


def right_description(mechanism: Mechanism, joint: Joint, motions: Motion, command: Array) -> str:
    """Return the one change of columns with which the motion explains a joint's torque, or an empty string.

    Args:
        mechanism: the model.
        joint: the joint.
        motions: motion of every measured column, smoothed like the command.
        command: torque that the joint was given, N m [T].
    """
    every = max(len(command) // SAMPLES, 1)
    thin = {name: (x[::every], v[::every], a[::every]) for name, (x, v, a) in motions.items()}
    left = {
        change: _left(mechanism, joint, {**thin, **changed}, command[::every])
        for change, changed in _changes(mechanism, thin)
    }
    best, *others = sorted(left, key=lambda change: left[change])
    if left[best] > RIGHT or any(left[best] > LEFT * left[each] for each in others):
        return ""
    return f"with {best} it explains {100 * (1 - left[best]):.0f} %"


def _changes(mechanism: Mechanism, motions: Motion) -> Iterator[tuple[str, Motion]]:
    """Yield changes of the description of one or two joints, each with the motions that it changes."""
    known = [mechanism.joints[name] for name in motions if name in mechanism.joints]
    for each in known:
        position, speed, acceleration = motions[each.name]
        yield f"`scale: -1` for {each.name}", {each.name: (-position, -speed, -acceleration)}
        for turn in TURNS_RAD if each.turns else ():
            yield f"`add: {turn:.4g}` for {each.name}", {each.name: (position + turn, speed, acceleration)}
    for one, other in combinations((each.name for each in known), 2):
        yield f"the columns of {one} and {other} exchanged", {one: motions[other], other: motions[one]}


def _left(mechanism: Mechanism, joint: Joint, motions: Motion, command: Array) -> float:
    """Return the share of a torque's square that the motion leaves."""
    position, speed, acceleration = motions[joint.name]
    terms = mechanism.terms(joint, mechanism.course(joint, motions))
    needed = torque(terms, position, speed, acceleration)
    return unexplained(command, np.stack((np.sign(speed), speed), axis=1), needed)
