"""Simulation of one joint's recordings at many points of a fit, each window from its own start."""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.grid import held_means
from softarm.diagnosis.rigs.laws import joint as laws
from softarm.diagnosis.rigs.mjcf.body_terms import BodyChange, BodyTerms, Place
from softarm.diagnosis.rigs.mjcf.drive import Drive
from softarm.diagnosis.rigs.mjcf.effects import GAIN_OF, MASS
from softarm.diagnosis.rigs.mjcf.links import PLACE
from softarm.diagnosis.rigs.mjcf.mechanism import Joint
from softarm.diagnosis.rigs.mjcf.stepping import Stepping
from softarm.diagnosis.rigs.motion import Motion, directions

# Drives that are kept, and commands before them; each is as long as all recordings, in integration steps.
KEPT = 20
# Step of the numerical derivative by a window's start, in its uncertainty.
NUDGED = 0.05
# Shares of the linear correction of a window's start that are tried as another start. A start is used if the squared
# errors of the window and of its first EARLY samples shrink to the share IMPROVED.
CORRECTED, EARLY, IMPROVED = (1.0, 0.5), 16, 0.3
# Whether dry friction lets the joint creep, as MuJoCo's does, 0 or 1.
CREEP = "coulomb_friction.creep"
# Whether the recordings come from a simulation with the model's own steps, 0 or 1.
STEPPED = "simulation.stepped"
# Parameters that are columns of the law.
_COLUMNS = {
    "coulomb_friction.torque": laws.DRY,
    "coulomb_friction.give": laws.GIVE,
    "stiction.torque": laws.STICTION,
    "stiction.speed": laws.SPEED,
    "load_friction.share": laws.LOADED,
    "load_friction.from_load": laws.FROM_LOAD,
    "load_friction.speed": laws.LOAD_SPEED,
    "damping.viscous": laws.VISCOUS,
    "drag.coefficient": laws.DRAG,
    "spring.stiffness": laws.SPRING,
    "torque_offset.torque": laws.OFFSET,
    "sensor_bias.bias": laws.BIAS,
    "deadband.width": laws.WIDTH,
    "backlash.gap": laws.GAP,
}
# Values of all parameters at one point, by 'effect.parameter'.
Values = Mapping[str, float]


class JointSimulation:
    """Windows of all trials of a joint, with M samples."""

    def __init__(
        self,
        joint: Joint,
        drive: Drive,
        body_terms: BodyTerms,
        steps: Stepping,
        motions: Sequence[Motion],
        each: int,
    ) -> None:
        """Prepare the inputs.

        Args:
            joint: the joint.
            drive: its actuator, with the commands of all trials.
            body_terms: rigid-body terms of all trials, and their changes.
            steps: the model's own integration.
            motions: measured motion of each trial.
            each: integration steps per sample.
        """
        self._joint, self._actuator, self._motions = joint, drive.actuator, motions
        self._inputs, self._each = {"": drive.inputs, **drive.shares}, each
        self._body_terms, self._steps = body_terms, steps
        self._along = tuple(map(self._stepped, zip(*drive.lengths, strict=True))) if drive.lengths else (0.0, 0.0)
        self._parts = [(f"{MASS}{part}.scale", part) for part in joint.parts]
        self._gains = [(f"{GAIN_OF}{name}.scale", name) for name in drive.shares]
        self._strengths = {
            name: [*map(self._stepped, zip(*each, strict=True))] for name, each in drive.strengths.items()
        }
        kept = lru_cache(KEPT)
        self._drives, self._followed, self._held = kept(self._driven), kept(self._follow), kept(self._hold)

    def start(self, seen: Array, edges: Sequence[NDArray[np.int64]], slow: float, at: Values, floor: float) -> None:
        """Guess the starts of the windows.

        Args:
            seen: measured position; NaN where no sample was measured [M].
            edges: first samples of the windows in each trial, and its end.
            slow: speed below which the joint counts as at rest.
            at: values of the nominal model.
            floor: noise floor.
        """
        ends, starts, sides, steps = [np.zeros(1, np.int64)], [], [], []
        for m, own in zip(self._motions, edges, strict=True):
            ends.append(own[1:] + ends[-1][-1])
            starts.append(np.stack((m.position[own[:-1]], m.speed[own[:-1]]), axis=1))
            sides.append(directions(m, own, slow)[1])
            steps.append(np.full(len(own) - 1, m.grid.step_s))
        spreads = [np.tile(m.spread, (len(s), 1)) for m, s in zip(self._motions, steps, strict=True)]
        whole = (np.concatenate(each) for each in (ends, starts, sides, steps))
        self._windows = laws.Windows(seen.copy(), *whole)
        self._spread, self._floor, self._guesses = np.concatenate(spreads), floor, self._windows.starts
        steps_before = [np.diff(m.seen, prepend=np.nan)[own[:-1]] for m, own in zip(self._motions, edges, strict=True)]
        self._speeds_before = np.nan_to_num(np.concatenate(steps_before) / self._windows.step_s)
        self._nominal = at
        self._find_starts()

    def assume(self, path: str, value: float) -> None:
        """Set 'effect.parameter' of the nominal model at which the starts are found, and find them again."""
        self._nominal = {**self._nominal, path: value}
        self._find_starts()

    def _find_starts(self) -> None:
        """Start each window at the guess, or at another start with which the nominal model fits it far better.

        Smoothing blurs the speed of an abrupt start. A correction by the start is not linear where dry friction then
        stops the joint. So the speed before the window, or rest at a recording's start, and corrected starts are tried.
        """
        self._windows = self._windows._replace(starts=self._guesses)
        left, self._freed = self._by_start()
        left = self._try(np.stack((self._guesses[:, 0], self._speeds_before), axis=1), left)
        for share in CORRECTED:
            known, first = np.nan_to_num(left), self._windows.edges[:-1]
            moves = np.stack([np.add.reduceat(solve * known, first) for solve in self._freed[1]], axis=1)
            left = self._try(self._windows.starts - share * moves * self._spread, left)

    def _try(self, starts: Array, left: Array) -> Array:
        """Use other starts [W, 2] of the windows that the nominal model then fits better, and return its errors, [M].

        left: errors from the present starts, [M].
        """
        windows, freed, usual = self._windows, self._freed, self._squares(left)
        self._windows = windows._replace(starts=starts)
        other, self._freed = self._by_start()
        better = np.asarray(np.all(self._squares(other) < IMPROVED * usual, axis=0))
        samples = np.repeat(better, np.diff(windows.edges))
        self._windows = windows._replace(starts=np.where(better[:, None], starts, windows.starts))
        one, two = (np.where(samples, new, old) for new, old in zip(self._freed, freed, strict=True))
        self._freed = one, two
        return np.where(samples, other, left)

    def _squares(self, left: Array) -> Array:
        """Return the squared error of each window, and that of its first samples without a correction, [2, W]."""
        edges, whole = self._windows.edges, left[None].copy()
        self.free_starts(whole)
        early = np.arange(edges[-1]) - np.repeat(edges[:-1], np.diff(edges)) < EARLY
        return np.add.reduceat(np.nan_to_num([whole[0], np.where(early, left, 0.0)]) ** 2, edges[:-1], axis=1)

    def leave_out(self, samples: NDArray[np.bool_]) -> None:
        """Leave samples [M] out."""
        self._windows.seen[samples] = np.nan
        _, self._freed = self._by_start()

    def residuals(self, values: Sequence[Values], terms: Array | None = None, moved: Array | float = 0.0) -> Array:
        """Return measured minus predicted values from the windows' starts at P points, [P, M].

        Args:
            values: values at each point.
            terms: rigid-body terms to start from, [ROWS, M], by default the own.
            moved: change of the windows' starts, [W, 2].
        """
        bodies = [self._body(at) for at in values]
        paths = {body: self._body_terms.at(body, terms) for body in dict.fromkeys(bodies)}
        inputs = laws.Inputs.of([self._drive(at) for at in values], [paths[body] for body in bodies])
        windows = self._windows._replace(starts=self._windows.starts + moved)
        return laws.residuals(windows, inputs, np.array([self._law(at) for at in values]), self._each)

    def free_starts(self, left: Array) -> None:
        """Remove from values left [P, M] what a change of each window's start explains."""
        laws.free_starts(left, self._windows.edges, *self._freed)

    def _by_start(self) -> tuple[Array, tuple[Array, Array]]:
        """Return the errors of the nominal model [M], how they change with their window's start, and the fit of it.

        The change per unit of a start's uncertainty, and its least-squares fit, are [2, M].
        """
        at = self._nominal
        base = self.residuals([at])[0]
        nudges = [NUDGED * self._spread * axis for axis in np.eye(2)]
        changed = [(self.residuals([at], moved=nudge)[0] - base) / NUDGED for nudge in nudges]
        both = np.nan_to_num(np.stack(changed))
        solve = np.empty_like(both)
        for a, b in pairwise(self._windows.edges):
            change = both[:, a:b]
            normal = change @ change.T + self._floor**2 * np.eye(2)
            solve[:, a:b] = np.linalg.solve(normal, change)
        return base, (both, solve)

    def _law(self, at: Values) -> Array:
        law, joint, actuator = np.zeros(laws.COLUMNS), self._joint, self._actuator
        law[laws.REST] = joint.rest
        law[laws.LOW], law[laws.HIGH] = -np.inf, np.inf
        if actuator is not None:
            factor, limit = 1 + at.get("gain.scale", 0.0), at["ceiling.limit"]
            stiff = factor * (1 + at.get("position_gain.scale", 0.0))
            law[laws.KP], law[laws.KD] = stiff * actuator.kp, factor * actuator.kd
            law[laws.LOW], law[laws.HIGH] = actuator.low, actuator.high
            if limit != actuator.high:
                law[laws.LOW], law[laws.HIGH] = -limit, limit
        for path, column in _COLUMNS.items():
            law[column] = at.get(path, 0.0)
        law[laws.ARMATURE] = at["armature.inertia"] - joint.armature
        law[laws.BACK_EMF] = joint.back_emf
        if at[STEPPED]:
            law[laws.AHEAD], law[laws.LOOP_AHEAD] = self._steps.damping_s, self._steps.loop_s
        if at[CREEP]:
            law[laws.SOFT], law[laws.YIELDS], law[laws.GIVE] = joint.softness, joint.yields_per_s, 0.0
        return law

    def _drive(self, at: Values) -> Array:
        """Return the drive at every integration step, [M each]."""
        early_s = self._steps.half_s * at[STEPPED]
        delay_s = at.get("dead_time.delay", 0.0) + at.get("latency.delay", 0.0) - early_s
        factor = 1 + at.get("gain.scale", 0.0)
        stiff = factor * (1 + at.get("position_gain.scale", 0.0))
        rate, bias = at.get("rate_limit.rate", np.inf), at.get("command_bias.bias", 0.0)
        lag_s = at.get("lag.time", 0.0)
        drive = self._drives(delay_s, lag_s, rate, bias, factor, stiff)
        gains = [(name, at[path]) for path, name in self._gains if at.get(path)]
        return np.asarray(drive + sum(gain * self._followed(name, delay_s, lag_s, rate) for name, gain in gains))

    def _driven(self, delay_s: float, lag_s: float, rate: float, bias: float, factor: float, stiff: float) -> Array:
        actuator = self._actuator
        if actuator is None:
            return np.zeros(sum(len(m.seen) for m in self._motions) * self._each)
        (length, speed), sent = self._along, self._followed("", delay_s, lag_s, rate) + bias
        loop = actuator.scale * sent + actuator.offset - actuator.kp / actuator.gear * length
        return np.asarray(stiff * loop - factor * actuator.kd / actuator.gear * speed)

    def _stepped(self, signals: Sequence[Array]) -> Array:
        """Return signals [T] of all trials at every integration step, [M each]."""
        places = (np.arange(len(signal) * self._each) / self._each for signal in signals)
        pairs = zip(places, signals, strict=True)
        return np.concatenate([np.interp(place, np.arange(len(signal)), signal) for place, signal in pairs])

    def _follow(self, share: str, delay_s: float, lag_s: float, rate: float) -> Array:
        """Return the command that reaches the actuator, or one of several, at every integration step, [M each].

        Of actuators whose strengths change with the motion it is their torque, or that of one of them.
        """
        if self._strengths and not share:
            return np.asarray(sum(self._followed(name, delay_s, lag_s, rate) for name in self._strengths))
        held = self._held(share, delay_s)
        found = [np.empty_like(each) for each in held]
        for m, command, out in zip(self._motions, held, found, strict=True):
            laws.follow(command, rate, lag_s, m.grid.step_s / self._each, out)
        followed = np.concatenate(found)
        if share not in self._strengths:
            return followed
        active, passive = self._strengths[share]
        return np.asarray(active * followed + passive)

    def _hold(self, share: str, delay_s: float) -> list[Array]:
        """Return each trial's delayed command at its integration steps."""
        found = []
        for m, integral in zip(self._motions, self._inputs[share], strict=True):
            h = m.grid.step_s / self._each
            # A step begins with its kick and ends with its motion, so the mean of the drive is that around its start.
            found.append(held_means(integral, m.grid.t_s[0] - delay_s - 0.5 * h, h, len(m.seen) * self._each))
        return found

    def _body(self, at: Values) -> BodyChange:
        """Return the change of the rigid-body terms in some values."""
        return BodyChange(
            mass_share=at.get("mass.scale", 0.0),
            payload_kg=at.get("payload.mass", 0.0),
            payload_m=_place(at) if at.get("payload.mass") else (0.0, 0.0, 0.0),
            length_share=at.get("length.scale", 0.0),
            part_shares=tuple((part, at[path]) for path, part in self._parts if at.get(path)),
            tilts_rad=tuple((axis, at[f"tilt.{axis}"]) for axis in "xyz" if at.get(f"tilt.{axis}")),
            late_s=self._steps.half_s * at[STEPPED],
        )


def _place(at: Values) -> Place:
    """Return the place of the payload."""
    x, y, z = (at.get(f"payload.{axis}", 0.0) for axis in PLACE)
    return x, y, z
