"""Inputs of a joint's actuator in its recordings: commands, and the motion of other joints that it moves."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from softarm.diagnosis.data.trials import Series, Trial, TrialError
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.grid import held_integral, held_means
from softarm.diagnosis.rigs.laws import joint as laws
from softarm.diagnosis.rigs.mjcf.activation import Strength
from softarm.diagnosis.rigs.mjcf.actuators import Actuator, Actuators
from softarm.diagnosis.rigs.mjcf.body_terms import BodyTerms
from softarm.diagnosis.rigs.mjcf.mechanism import Joint
from softarm.diagnosis.rigs.motion import Motion

# Time for which the first and the last input hold beyond a recording, s.
MARGIN_S = 10.0


def columns(trials: Sequence[Trial]) -> tuple[set[str], set[str]]:
    """Return the columns of `measured` and of `base`."""
    measured, base = ([t.channels[name].columns for t in trials if name in t.channels] for name in ("measured", "base"))
    return set().union(*measured), set().union(*base)


class Drive:
    """Actuator of a joint, or a measured torque in its place, with its inputs in every trial.

    Attributes:
        actuator: the actuator, or None for a joint that nothing drives. Then there are no inputs.
        inputs: stamps and integral of each trial's command within its range.
        shares: the same of each of several actuators, by name; activations if their strengths change with the motion.
        strengths: then these strengths, in each trial.
        settled_s: time in each trial from which the unknown state of a slow actuator at its start is forgotten, s.
        lengths: length and speed of the actuator by the other joints that it moves, [T] of each trial. A motor does not
            feel them: then, and without other joints, the list is empty.
        sent: each trial's command at its samples, [T]. It is the command that would move the joint alike if its
            actuator moved no other joint.
    """

    def __init__(self, joint: Joint, trials: Sequence[Trial]) -> None:
        """Find actuator and inputs; `follow` sets what depends on the motion.

        Raises:
            TrialError: the model's actuators cannot be used, or a column of theirs is missing.
        """
        self.actuator, channel = joint.actuator, "command"
        if not _lacking(trials, "torque", joint.name):
            self.actuator, channel = Actuator(joint.name), "torque"
        else:
            _refuse_unusable(joint, trials)
        self.inputs, self.shares = list[tuple[Array, Array]](), dict[str, list[tuple[Array, Array]]]()
        self.strengths: dict[str, list[Strength]] = {}
        self.settled_s = [-np.inf] * len(trials)
        if actuator := self.actuator:
            self._commands = [t.channel(channel) for t in trials]
            if actuator.settles_s:
                self.settled_s = [float(each.t_s[0]) + actuator.settles_s for each in self._commands]
            if not actuator.by_motion:
                self.inputs = self._received(actuator.sent)
                self.shares = {name: self._received(share.given) for name, share in actuator.shares.items()}

    def _received(self, signal: Callable[[Callable[[str], Array]], Array]) -> list[tuple[Array, Array]]:
        """Return stamps and integral of a signal made of the commands of each trial, such as `Actuator.sent`."""
        return [held_integral(each, signal(each.__getitem__), MARGIN_S) for each in self._commands]

    def follow(self, motions: Sequence[Motion], bodies: BodyTerms, actuators: Actuators) -> None:
        """Set `lengths` and `sent`, and strengths, by the motion of the joint and of all others in each trial."""
        self._motions, self.lengths = motions, list[tuple[Array, Array]]()
        if self.actuator is not None and self.actuator.by_motion:
            self._activate(self.actuator.shares, bodies, actuators)
        around = bodies.around
        pairs = zip(self.inputs, motions if self.inputs else (), strict=True)
        self.sent = [
            held_means(i, m.grid.t_s[0] - 0.5 * m.grid.step_s, m.grid.step_s, len(m.grid.t_s)) for i, m in pairs
        ]
        actuator = self.actuator
        if actuator is None or not actuator.others or not (actuator.kp or actuator.kd):
            return
        names, ratios = [*actuator.others], np.array([*actuator.others.values()])
        self.lengths = [(ratios @ [each[n][0] for n in names], ratios @ [each[n][1] for n in names]) for each in around]
        kp, kd = (each / (actuator.gear * actuator.scale) for each in (actuator.kp, actuator.kd))
        both = zip(self.sent, self.lengths, strict=True)
        self.sent = [command - kp * length - kd * speed for command, (length, speed) in both]

    def _activate(self, shares: Mapping[str, Actuator], bodies: BodyTerms, actuators: Actuators) -> None:
        """Set the inputs of actuators whose strengths change with the motion."""
        self.shares, self.strengths = {name: [] for name in shares}, {name: [] for name in shares}
        for commands, m, course in zip(self._commands, self._motions, bodies.courses, strict=True):
            t_s, step_s = m.grid.t_s, m.grid.step_s
            around = Series(t_s - 0.5 * step_s, {})  # values hold half a step to either side of their sample
            total = np.zeros_like(t_s)
            strengths = actuators.strengths(shares, course.centre)
            for (name, each), strength in zip(shares.items(), strengths, strict=True):
                sent = np.clip(commands[name], each.command_low, each.command_high)
                stamps, summed = held_integral(commands, sent, MARGIN_S)
                signal = stamps + each.delay_s, summed
                if each.settles_s:  # the commands before a sample make its activation
                    before = held_means(signal, t_s[0] - step_s, step_s, len(t_s))
                    signal = held_integral(around, actuators.activation(name, before, step_s), MARGIN_S)
                total += strength.active * held_means(signal, around.t_s[0], step_s, len(t_s)) + strength.passive
                self.shares[name].append(signal)
                self.strengths[name].append(strength)
            self.inputs.append(held_integral(around, total, MARGIN_S))

    def acting(self) -> list[Array]:
        """Return each trial's command after the lag of the actuator, [T]."""
        if self.actuator is None or not self.actuator.lag_s:
            return [*self.sent]
        found = [np.empty_like(command) for command in self.sent]
        for command, m, out in zip(self.sent, self._motions, found, strict=True):
            laws.follow(command, np.inf, self.actuator.lag_s, m.grid.step_s, out)
        return found

    def lost(self, needed: Array) -> float:
        """Return the mean torque of a motor along the motion beyond the needed one; 0 for a position loop.

        needed: torque that the motion of all trials needs without friction, [M].
        """
        actuator, motions = self.actuator, self._motions
        if actuator is None or actuator.kp > 0:
            return 0.0
        given = [actuator.torque(command, m.position, m.speed) for command, m in zip(self.sent, motions, strict=True)]
        along = np.sign(np.concatenate([m.speed for m in motions]))
        return max(float(np.mean((np.concatenate(given) - needed) * along)), 0.0)


def _refuse_unusable(joint: Joint, trials: Sequence[Trial]) -> None:
    """Raise TrialError if the model's actuators cannot be used, or a column of theirs is missing."""
    actuator = joint.actuator
    if joint.problem:
        raise TrialError(joint.problem)
    if actuator is None:
        return
    missing = [(t, each) for each in actuator.shares or (actuator.name,) for t in _lacking(trials, "command", each)]
    if missing:
        trial, name = missing[0]
        raise TrialError(
            f"{trial.source}: joint {joint.name} is moved by the actuator {name}, whose command is "
            f"missing; add a column {name} to `command`, or {joint.name} to `torque`"
        )
    if unseen := sorted(actuator.others.keys() - set().union(*columns(trials))):
        raise TrialError(
            f"{trials[0].source}: {actuator.name} moves {joint.name} and {', '.join(unseen)}, which no column "
            "measures; add it to `measured` or `base`"
        )


def _lacking(trials: Sequence[Trial], channel: str, column: str) -> list[Trial]:
    """Return the trials without a column."""
    return [t for t in trials if channel not in t.channels or column not in t.channels[channel].columns]
