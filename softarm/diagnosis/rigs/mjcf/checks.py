"""Checks of a joint's recordings against its MuJoCo model before a fit: units, signs, gears and zeros."""

import math
from collections.abc import Iterator, Mapping

import numpy as np

from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.mjcf.mechanism import Joint, Mechanism

# Degrees per radian, and the relative tolerance of a ratio that is taken for it.
DEGREES, ALIKE = 180 / math.pi, 0.2
# Share of a joint's range by which readings may exceed it.
BEYOND = 0.25
# Correlations of two signals that certainly go together, are the same, and do not go together. A servo that friction
# slows shows 0.77 between its command and its torque. Then, the ratio of two torques that no effect explains.
TOGETHER, SAME, APART, FAR = 0.6, 0.85, 0.3, 3.0
# Ratio of squared errors without and with a factor of the torque, up to which friction explains it as well.
RUBBING = 2.0
# Share of a torque's square that is no friction, at least, to judge its size.
OWN = 0.05
# Share of the commanded travel up to which a joint counts as stuck.
STUCK = 0.02


def mistakes(
    joint: Joint, where: str, seen: Array, speed: Array, command: Array | None, needed: Array
) -> Iterator[str]:
    """Yield what is certainly wrong in the description of a joint, each with its remedy.

    Args:
        joint: joint of the model, with the actuator that drives it.
        where: file and channel, for messages.
        seen: readings, rad or m, [T].
        speed: their speed, [T].
        command: joint torque, or position of a position loop, that the actuator was sent, [T]; None without one.
        needed: torque that the measured motion needs by the model, [T].
    """
    unit = "rad" if joint.turns else "m"
    yield from _range(joint, where, seen, unit)
    if command is None or np.ptp(command) <= 0 or np.ptp(seen) <= 0:
        return
    follows = joint.actuator is not None and joint.actuator.kp > 0
    answer, other = (seen, needed) if follows else (needed, seen)
    together = float(np.corrcoef(command, answer)[0, 1])
    if together < APART and np.ptp(other) > 0 and float(np.corrcoef(command, other)[0, 1]) > SAME:
        yield f"{where}: {_other_kind(joint, follows)}"
        return
    name = "moves against its command" if follows else "needs the opposite of the torque that it was given"
    if together < -TOGETHER:
        yield f"{where}: {joint.name} {name}; one of the two has the opposite sign: write `scale: -1` for it"
    elif follows and joint.turns:
        ratio = float(np.std(seen) / np.std(command))
        for of, times in (("measured", ratio), ("command", 1 / ratio)):
            if abs(times / DEGREES - 1) < ALIKE:
                yield f"{where}: {joint.name} has a {of} range {times:.3g} times as wide; write `unit: deg` there"
    elif not follows and together > TOGETHER:
        small = np.abs(command) <= np.median(np.abs(command))  # a torque limit leaves these alone
        times, near = (_times(*(x[part] for x in (command, answer, speed))) for part in (slice(None), small))
        if not 1 / FAR < times < FAR and not 1 / FAR < near < FAR:
            yield (
                f"{where}: the motion of {joint.name} needs {times:.3g} times the torque that it was given; correct "
                "the unit, or write the gear ratio as `gear` of its actuator"
            )


def _times(command: Array, needed: Array, speed: Array) -> float:
    """Return the needed torque per given torque; 1 if friction that the model may lack explains the difference."""
    friction = np.stack((np.sign(speed), speed), axis=1)
    both = np.column_stack((needed, friction))
    share = np.linalg.lstsq(both, command)[0]
    own, left, left_alone = (
        float(np.sum((y - x @ np.linalg.lstsq(x, y)[0]) ** 2))
        for x, y in ((friction, needed), (both, command), (friction, command - needed))
    )
    if own < OWN * float(needed @ needed) or left_alone < RUBBING * left:
        return 1.0
    return float(1 / share[0])


def stuck(joint: Joint, seen: Array, command: Array) -> Iterator[str]:
    """Yield a warning if a joint stays where it is while the command of its position loop moves.

    Args:
        joint: joint with a position loop.
        seen: readings, rad or m, [T].
        command: command of the actuator, [T].
    """
    assert joint.actuator is not None
    asked, moved = float(np.ptp(command)) * abs(joint.actuator.scale) / joint.actuator.kp, float(np.ptp(seen))
    if moved < STUCK * asked:
        unit = "rad" if joint.turns else "m"
        yield (
            f"{joint.name} moves by {moved:.2g} {unit}, and its command by {asked:.2g} {unit}: it is blocked, switched "
            "off or weaker than its friction; free it and record again, or leave its column out"
        )


def _other_kind(joint: Joint, follows: bool) -> str:
    """Return the remedy for a torque that was given as a position, or the reverse."""
    assert joint.actuator is not None
    if follows:
        return (
            f"the command of {joint.name} resembles the torque of its motion, and its actuator {joint.actuator.name} "
            f"takes positions; move the column to `torque`, as {joint.name}"
        )
    return (
        f"the command of {joint.name} resembles its position, and its actuator {joint.actuator.name} takes torques; "
        "name the column of the torques, or make it a `position` actuator in the model"
    )


def _range(joint: Joint, where: str, seen: Array, unit: str) -> Iterator[str]:
    low, high = joint.range
    if not math.isfinite(high - low):
        return
    first, last = float(np.quantile(seen, 0.01)), float(np.quantile(seen, 0.99))
    allowed = BEYOND * (high - low)
    if first >= low - allowed and last <= high + allowed:
        return
    said = f"{where}: {joint.name} is {first:.3g} to {last:.3g} {unit}, but its range in the model is {low:.3g} to "
    said += f"{high:.3g} {unit}"
    if joint.turns and last - first > 3 * (high - low):
        yield f"{said}; are the readings in degrees? write `unit: deg`"
    elif last - first <= high - low + 2 * allowed:
        middle = 0.5 * (low + high) - 0.5 * (first + last)
        yield f"{said}; their zeros differ: write `add` for the column, such as {middle:.3g}"
    else:
        yield f"{said}; correct the column's `unit`, or name another column"


def assumptions(mechanism: Mechanism, joint: Joint, measured: Mapping[str, object]) -> Iterator[str]:
    """Yield a warning for each assumption about other joints; measured: columns of joints."""
    if still := mechanism.still(joint, measured):
        yield (
            f"{joint.name}: no column measures {', '.join(still)}, which carry it or are carried by it: they count as "
            "still; add them to `measured` or `base` (a floating body: its position _x to _z and quaternion _qw to _qz)"
        )
