"""Inputs of a joint's actuator in its recordings: commands, and the motion of other joints that it moves."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from softarm.diagnosis.data.trials import Series, Trial, TrialError
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.grid import held_integral, held_means
from softarm.diagnosis.rigs.laws import joint as laws
from softarm.diagnosis.rigs.mjcf.actuators import Actuator
from softarm.diagnosis.rigs.mjcf.mechanism import Joint
from softarm.diagnosis.rigs.motion import Motion

# Time in which the unknown state of an actuator at the start of a recording fades, in its time constants.
SETTLES = 4.0


def columns(trials: Sequence[Trial]) -> tuple[set[str], set[str]]:
    """Return the columns of `measured` and of `base`."""
    measured, base = ([t.channels[name].columns for t in trials if name in t.channels] for name in ("measured", "base"))
    return set().union(*measured), set().union(*base)


def inputs(joint: Joint, trials: Sequence[Trial]) -> tuple[Actuator | None, list[tuple[Array, Array]]]:
    """Return a joint's actuator, and stamps and integral of every trial's command within its range.

    A measured torque replaces the actuator. Without either there are no commands.

    Raises:
        TrialError: the model's actuators cannot be used, or a column of theirs is missing.
    """
    actuator, channel = joint.actuator, "command"
    if not _lacking(trials, "torque", joint.name):
        actuator, channel = Actuator(joint.name), "torque"
    elif joint.problem:
        raise TrialError(joint.problem)
    elif actuator is None:
        return None, []
    elif missing := [
        (t, each) for each in actuator.shares or (actuator.name,) for t in _lacking(trials, channel, each)
    ]:
        trial, name = missing[0]
        raise TrialError(
            f"{trial.source}: joint {joint.name} is moved by the actuator {name}, whose command is "
            f"missing; add a column {name} to `command`, or {joint.name} to `torque`"
        )
    elif unseen := sorted(actuator.others.keys() - set().union(*columns(trials))):
        raise TrialError(
            f"{trials[0].source}: {actuator.name} moves {joint.name} and {', '.join(unseen)}, which no column "
            "measures; add it to `measured` or `base`"
        )
    return actuator, received(actuator.sent, [t.channel(channel) for t in trials])


def received(
    signal: Callable[[Callable[[str], Array]], Array], commands: Sequence[Series]
) -> list[tuple[Array, Array]]:
    """Return stamps and integral of a signal made of the commands of each trial, such as `Actuator.sent`."""
    return [held_integral(series, signal(series.__getitem__), 10.0) for series in commands]


def settled_s(actuator: Actuator | None, trials: Sequence[Trial]) -> list[float]:
    """Return the time in each trial from which the unknown state of a slow actuator at its start is forgotten, s."""
    if actuator is None or not actuator.lag_s:
        return [-np.inf] * len(trials)
    return [float(t.channel("command").t_s[0]) + SETTLES * actuator.lag_s for t in trials]


def along(
    actuator: Actuator | None, around: Sequence[Mapping[str, tuple[Array, Array, Array]]]
) -> list[tuple[Array, Array]]:
    """Return length and speed of an actuator by the other joints that it moves, [T] of each trial.

    A motor does not feel them: then, and without other joints, the list is empty.

    Args:
        actuator: the actuator, or None.
        around: column -> position, speed and acceleration of other joints, [T] each.
    """
    if actuator is None or not actuator.others or not (actuator.kp or actuator.kd):
        return []
    names, ratios = [*actuator.others], np.array([*actuator.others.values()])
    return [(ratios @ [each[n][0] for n in names], ratios @ [each[n][1] for n in names]) for each in around]


def sent(
    actuator: Actuator | None,
    commands: Sequence[tuple[Array, Array]],
    lengths: Sequence[tuple[Array, Array]],
    motions: Sequence[Motion],
) -> list[Array]:
    """Return each trial's command at its samples, [T]; without an actuator there are none.

    It is the command that would move the joint alike if its actuator moved no other joint.

    Args:
        actuator: the actuator, or None.
        commands: stamps and integral of every trial's command.
        lengths: result of `along`.
        motions: motion of the joint in each trial.
    """
    pairs = zip(commands, motions if commands else (), strict=True)
    found = [held_means(i, m.grid.t_s[0] - 0.5 * m.grid.step_s, m.grid.step_s, len(m.grid.t_s)) for i, m in pairs]
    if actuator is None or not lengths:
        return found
    kp, kd = (each / (actuator.gear * actuator.scale) for each in (actuator.kp, actuator.kd))
    return [command - kp * length - kd * speed for command, (length, speed) in zip(found, lengths, strict=True)]


def acting(actuator: Actuator | None, commands: Sequence[Array], motions: Sequence[Motion]) -> list[Array]:
    """Return each trial's command after the lag of the actuator, [T]; commands: result of `sent`."""
    if actuator is None or not actuator.lag_s:
        return [*commands]
    found = [np.empty_like(command) for command in commands]
    for command, m, out in zip(commands, motions, found, strict=True):
        laws.follow(command, np.inf, actuator.lag_s, m.grid.step_s, out)
    return found


def _lacking(trials: Sequence[Trial], channel: str, column: str) -> list[Trial]:
    """Return the trials without a column."""
    return [t for t in trials if channel not in t.channels or column not in t.channels[channel].columns]
