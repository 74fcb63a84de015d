"""Checks of a joint's recordings against its MuJoCo model before a fit: units, signs, gears and zeros."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import lsq_linear

from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.mjcf.body_terms import torque
from softarm.diagnosis.rigs.mjcf.mechanism import Joint, Mechanism
from softarm.diagnosis.rigs.motion import Motion

# Degrees per radian, and the relative tolerance of a ratio that is taken for it.
DEGREES, ALIKE = 180 / math.pi, 0.2
# Share of a joint's range by which readings may exceed it.
BEYOND = 0.25
# Correlations of two signals that certainly go together, and are the same. A servo that friction slows shows 0.77
# between its command and its torque.
TOGETHER, SAME = 0.6, 0.85
# Ratios of the needed to the given torque that no effect explains. A payload on a light wrist makes the second large.
FAR, FAR_LESS = 3.0, 1 / 50
# Share of a square that another description, or the effects of a good one, may leave; correlations that count as equal.
LEFT, AS_WELL = 0.25, 0.05
# Share of a torque's variation that the motion explains, at least, without a warning.
ALIKE_LEAST = 0.5
# Ratio of squared errors without and with a factor of the torque, up to which friction explains it as well.
RUBBING = 2.0
# Share of a torque's square that is no friction, at least, to judge its size.
OWN = 0.05
# Share of a signal's largest value up to which its range is rounding.
ROUNDING = 1e-9
# Share of the commanded travel up to which a joint counts as stuck.
STUCK = 0.02
# Share of a command's power at frequencies that the smoothing keeps, and its width at most, in lengths of a recording.
KEPT, WIDEST = 0.9, 0.025
# Returns smoothed signals of all recordings one after the other, [M]; it takes those of each recording, [T].
Smooth = Callable[[Iterable[Array]], Array]


class Compared(NamedTuple):
    """Signals of a joint whose likeness is checked, [T of all recordings] each."""

    seen: Array  # readings, rad or m
    command: Array  # joint torque, or position of a position loop, that the actuator was sent
    needed: Array  # torque that the motion needs by the model
    friction: Array  # [T, 2] sign of the speed, and speed
    mirrored: Callable[[], Array]  # torque that the motion needs if the readings have the opposite sign


def mistakes(joint: Joint, where: str, signals: Compared) -> Iterator[str]:
    """Yield what is certainly wrong in the description of a joint's command, each with its remedy.

    Args:
        joint: joint of the model, with the actuator that drives it.
        where: file and channel, for messages.
        signals: command and motion of the joint.
    """
    seen, command, needed, friction = signals[:4]
    if _is_constant(command) or _is_constant(seen):
        return
    follows = joint.follows
    answer, other = (seen, needed) if follows else (needed, seen)
    together, resembles = _correlation(command, answer), _correlation(command, other)
    mirrored = -together if follows or together > SAME else _correlation(command, signals.mirrored())
    opposite = max(-together, mirrored)
    if _is_far_better(resembles, together) and resembles > opposite:
        yield f"{where}: {_other_kind(joint)}"
    elif _is_far_better(opposite, together) or _is_turned(joint, together, signals):
        if follows or _beats_effects(signals, signals.mirrored() if mirrored > -together else -needed):
            yield f"{where}: {_opposite(joint, together, mirrored)}"
    elif follows and joint.turns:
        ratio = float(np.std(seen) / np.std(command))
        for of, times in (("measured", ratio), ("command", 1 / ratio)):
            if abs(times / DEGREES - 1) < ALIKE:
                yield f"{where}: {joint.name} has a {of} range {times:.3g} times as wide; write `unit: deg` there"
    elif not follows and together > TOGETHER:
        small = np.abs(command) <= np.median(np.abs(command[command != 0]))  # a torque limit leaves these alone
        times, near = (_times(*(x[part] for x in (command, answer, friction))) for part in (slice(None), small))
        far = all(each > FAR or 0 < each < FAR_LESS for each in (times, near))
        if far and unexplained(command, friction, needed) < LEFT:  # a wrong zero makes torques of another form
            yield (
                f"{where}: the motion of {joint.name} needs {times:.3g} times the torque that it was given; correct "
                "the unit, or write the gear ratio as `gear` of its actuator"
            )


def unlike(joint: Joint, signals: Compared, right: Callable[[], str] = lambda: "") -> Iterator[str]:
    """Yield a warning if the torque that a joint was given hardly resembles the torque that its motion needs.

    Args:
        joint: joint of the model, with the actuator that drives it; nothing is said of a position loop.
        signals: command and motion of the joint.
        right: returns the change of a column that explains the torque, or an empty string.
    """
    if joint.follows:
        return
    seen, command, needed, friction = signals[:4]
    share = 1 - unexplained(command, friction, needed)
    if share < ALIKE_LEAST and unexplained(command, friction, needed, seen) > LEFT:  # a spring explains the others
        remedy = right() or "check that its columns belong to this joint, and the zeros and signs of all joints"
        yield (
            f"{joint.name}: by the model, its motion explains {100 * share:.0f} % of the variation of its torque; "
            f"{remedy}"
        )


def _correlation(one: Array, other: Array) -> float:
    """Return the correlation of two signals; 0 if one of them is constant."""
    return float(np.corrcoef(one, other)[0, 1]) if np.ptp(one) > 0 and np.ptp(other) > 0 else 0.0


def _is_far_better(other: float, together: float) -> bool:
    """Report whether a correlation by another description leaves far less of a signal unexplained."""
    return other > SAME and 1 - other**2 < LEFT * (1 - together**2)


def _is_turned(joint: Joint, together: float, signals: Compared) -> bool:
    """Report whether an actuator was sent the opposite, besides friction that the model may lack."""
    if joint.follows:
        return together < -TOGETHER
    times = _times(signals.command, signals.needed, signals.friction)
    return together < -TOGETHER and abs(times + 1) < ALIKE


def _beats_effects(signals: Compared, turned: Array) -> bool:
    """Report whether a turned torque leaves far less than effects do, since a strong spring turns a torque as well."""
    seen, command, needed, friction = signals[:4]
    return unexplained(command, friction, turned) < LEFT * unexplained(command, friction, needed, seen)


def _opposite(joint: Joint, together: float, mirrored: float) -> str:
    name = "moves against its command" if joint.follows else "needs another torque than it was given"
    which = "one of the two has"
    if abs(mirrored + together) > AS_WELL:
        which = "its readings have" if mirrored > -together else "its command has"
    return f"{joint.name} {name}; {which} the opposite sign: write `scale: -1` for it"


def _times(command: Array, needed: Array, friction: Array) -> float:
    """Return the needed torque per given torque; 1 if friction that the model may lack explains the difference."""
    both = np.column_stack((needed, friction))
    share = np.linalg.lstsq(both, command)[0]
    own, left, left_alone = (
        float(np.sum((y - x @ np.linalg.lstsq(x, y)[0]) ** 2))
        for x, y in ((friction, needed), (both, command), (friction, command - needed))
    )
    if own < OWN * float(needed @ needed) or left_alone < RUBBING * left:
        return 1.0
    return float(1 / share[0])


def _is_constant(signal: Array) -> bool:
    """Return whether a signal varies by no more than the rounding of its means over samples."""
    return bool(np.ptp(signal) <= ROUNDING * np.max(np.abs(signal)))


def unexplained(command: Array, friction: Array, *torques: Array) -> float:
    """Return the share of a given torque's square that positive multiples of torques and any friction leave.

    Args:
        command: given torque, [T].
        friction: laws of friction along the motion, [T, 2].
        torques: other torques, [T each].
    """
    if _is_constant(command):
        return 0.0
    known, target = np.column_stack((*torques, friction)), command - command.mean()
    known = known - known.mean(axis=0)
    low = np.repeat((0.0, -np.inf), (len(torques), friction.shape[1]))
    scaled = known / np.maximum(known.std(axis=0), 1e-300)
    return float(2 * lsq_linear(scaled, target / target.std(), (low, np.inf)).cost / len(target))


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


def _other_kind(joint: Joint) -> str:
    """Return the remedy for a torque that was given as a position, or the reverse."""
    assert joint.actuator is not None
    if joint.follows:
        return (
            f"the command of {joint.name} resembles the torque of its motion, and its actuator {joint.actuator.name} "
            f"takes positions; move the column to `torque`, as {joint.name}"
        )
    return (
        f"the command of {joint.name} resembles its position, and its actuator {joint.actuator.name} takes torques; "
        "name the column of the torques, or make it a `position` actuator in the model"
    )


def out_of_range(joint: Joint, where: str, seen: Array) -> Iterator[str]:
    """Yield what is wrong if readings lie far beyond the joint's range, with its remedy; seen: rad or m, [T]."""
    unit, (low, high) = "rad" if joint.turns else "m", joint.range
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
        zero = f"`add` for the column, such as {middle:.3g}"
        if -last >= low - allowed and -first <= high + allowed:
            yield f"{said}; their sign or zero differs: write `scale: -1`, or {zero}"
        else:
            yield f"{said}; their zeros differ: write {zero}"
    else:
        yield f"{said}; correct the column's `unit`, or name another column"


def assumptions(mechanism: Mechanism, joint: Joint, measured: Mapping[str, object]) -> Iterator[str]:
    """Yield a warning for each assumption about other joints; measured: columns of joints."""
    if still := mechanism.still(joint, measured):
        yield (
            f"{joint.name}: no column measures {', '.join(still)} of the same chain: counted as still; "
            "add columns to `measured` or `base` (a floating body: its position _x to _z and quaternion _qw to _qz)"
        )


def smoother(
    motions: Sequence[Motion], sent: Sequence[Array], free: Sequence[NDArray[np.bool_]], width: float = 1.0
) -> Smooth:
    """Return the smoothing that keeps most of the commands, at samples without a contact.

    The double difference of an encoder's noise is larger than most accelerations, but lies at higher frequencies than
    the command. A weighted mean of both keeps their ratio.

    Args:
        motions: motion of each recording.
        sent: its command, [T of the recording].
        free: samples without a contact or a limit, [T of the recording].
        width: factor of the smoothing's width.
    """
    widths = [width * _width(s, m.grid.step_s) for s, m in zip(sent, motions, strict=True)]

    def smooth(signals: Iterable[Array]) -> Array:
        recordings = zip(signals, free, widths, strict=True)
        return np.concatenate([_smooth(values, used, width)[used] for values, used, width in recordings])

    return smooth


def compared(
    joint: Joint,
    motions: Sequence[Motion],
    sent: Sequence[Array],
    smooth: Smooth,
    terms: Callable[[Sequence[Motion]], Iterable[Array]],
) -> Compared:
    """Return command and motion of a joint in all recordings, smoothed alike.

    Args:
        joint: joint of the model, with the actuator that drives it.
        motions: motion of each recording.
        sent: its command, [T of the recording].
        smooth: result of `smoother`.
        terms: returns the rigid-body terms of each recording along a motion of the joint, [ROWS, T].
    """
    assert joint.actuator is not None
    factor = 1.0 if joint.follows else joint.actuator.scale

    def needed(along: Sequence[Motion]) -> Array:
        return smooth(_needed(joint, each, m) for each, m in zip(terms(along), along, strict=True))

    return Compared(
        seen=smooth(m.position for m in motions),
        command=smooth(factor * s for s in sent),
        needed=needed(motions),
        friction=np.stack((smooth(np.sign(m.speed) for m in motions), smooth(m.speed for m in motions)), axis=1),
        mirrored=lambda: needed([m.mirrored() for m in motions]),
    )


def _needed(joint: Joint, terms: Array, motion: Motion) -> Array:
    friction = joint.viscous * motion.speed + joint.friction * np.sign(motion.speed)
    spring = 0.0 if joint.follows else joint.spring * (motion.position - joint.rest)
    return torque(terms, motion.position, motion.speed, motion.acceleration) + friction + spring


def _width(command: Array, step_s: float) -> float:
    """Return the standard deviation of the Gaussian that keeps most of a command, in samples."""
    power = np.cumsum(np.abs(np.fft.rfft(command - np.mean(command))) ** 2)
    fastest_hz = np.fft.rfftfreq(len(command), step_s)[max(int(np.searchsorted(power, KEPT * power[-1])), 1)]
    return min(float(1 / (2 * np.pi * fastest_hz * step_s)), WIDEST * len(command))


def _smooth(values: Array, used: NDArray[np.bool_], width: float) -> Array:
    """Return the weighted mean of the used values around each sample, [T]."""
    total, weight = (gaussian_filter1d(x, width, mode="constant") for x in (np.where(used, values, 0.0), 1.0 * used))
    return np.asarray(total / np.maximum(weight, 1e-300))
