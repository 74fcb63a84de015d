"""View of one joint of a MuJoCo model: its actuator moves it while the other joints follow their measured motion."""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.answer.evidence import rms
from softarm.diagnosis.data.trials import Trial, TrialError, stage_of
from softarm.diagnosis.engine.view import Array, Point
from softarm.diagnosis.engine.whitened import slices
from softarm.diagnosis.rigs.grid import fastest_change, resolution, usual_step
from softarm.diagnosis.rigs.laws import joint as laws
from softarm.diagnosis.rigs.mjcf import checks
from softarm.diagnosis.rigs.mjcf.body_terms import LENGTH_SHARES, BodyTerms, Torques, features, split
from softarm.diagnosis.rigs.mjcf.descriptions import misread, right_description
from softarm.diagnosis.rigs.mjcf.drive import Drive, columns
from softarm.diagnosis.rigs.mjcf.effects import (
    GAIN_OF,
    MASS,
    JointScales,
    adds_mass,
    common_effects,
    joint_effects,
    of_actuator,
)
from softarm.diagnosis.rigs.mjcf.mechanism import mechanism
from softarm.diagnosis.rigs.mjcf.noise import averaged, combined, samples_averaged
from softarm.diagnosis.rigs.mjcf.simulation import CREEP, STEPPED, JointSimulation
from softarm.diagnosis.rigs.mjcf.zeros import Zeros
from softarm.diagnosis.rigs.motion import (
    SAMPLES_LEAST,
    SLOW,
    WINDOW_PERIODS,
    Motion,
    cut_edges,
    largest_acceleration,
    motions,
    period,
    regimes,
    time_uncertainty,
    widened,
    window_edges,
    window_lengths,
    within_windows,
)
from softarm.diagnosis.rigs.scales import SIGMAS, white_noise
from softarm.diagnosis.rigs.views import FLOOR_SHARE, RigView, given_values, neutral_values
from softarm.schemas.verdict import Interval

# Growth of an error within a window of a joint that falls, such as an upright arm under torque commands.
GROWN = 10.0
# Samples are averaged down to this rate: accelerations of coupled joints change within 5 ms.
RATE_HZ = 500.0
# Share of a load below which a mass has no effect, and of the floor below which other joints' noise or a simulation's
# steps do not count.
FELT, FELT_NOISE = 1e-4, 0.35
# Longest integration step, s, and the same in inverse frequencies of a position loop; most steps per sample.
STEP_S, STEP_SHARE, SUBSTEPS_MOST = 1e-3, 0.2, 64
# Share of the samples that may be left out because other joints move too fast between samples, and that is reported.
UNSURE_MOST, UNSURE_WARNED = 0.5, 0.1
# Samples without a contact or a limit that a joint needs.
FREE_LEAST = 100
# Errors of a good nominal model: shares of its own values, lengths, the usual torque, and a command's step.
OF_OWN, OF_LENGTH, OF_FORCE, HELD_LATE = 0.025, 0.01, 0.004, 0.5
ZERO_RAD, ZERO_SHARE, LEVEL_RAD = 3e-3, 2e-3, 5e-3
# Smoothing of a free joint's motion, as a share of the usual width: its weight is no linear function of the angle.
NARROW = 0.25
# Relative errors of a gain at which a search may begin: models often have those of another unit or firmware.
FAR_GAINS = -0.7, -0.9, -0.97, -0.985
# Travels over which a model's friction may bend, in its usual value.
GIVES = np.linspace(0.0, 4.0, 9)


class JointView(RigView):
    """View from a joint's command, or its measured torque, to its position."""

    ignored = 2.0  # the floor is known better than other rigs'
    step_cost_s = 0.06e-6  # of an arm with many gaps, which takes three times its plan
    blocks_each = 2
    shared = frozenset(("mass", "length", "payload", "tilt"))
    whole = frozenset(("payload", "tilt"))
    only_together = frozenset(("payload.y", "payload.z"))
    far_starts = dict.fromkeys(("gain", "position_gain"), FAR_GAINS)

    def __init__(self, trials: Sequence[Trial]) -> None:
        """Prepare the trials of one joint; raise TrialError if model and columns do not fit each other."""
        stage = stage_of(trials)
        self._mechanism = mechanism(Path(str(stage.model["mjcf"])), *columns(trials))
        self._joint = joint = self._mechanism.joint(stage.name)
        self._refuse_follower(trials)
        self._end = f"end {self._mechanism.last_link(joint).body}"
        self._drive = Drive(joint, trials)
        self._actuator = self._drive.actuator
        step = resolution([t.channel("measured")[joint.name] for t in trials])
        limit = largest_acceleration(trials, joint.name, step)
        self._motions = motions(trials, joint.name, step, limit, rate_hz=RATE_HZ)
        self._bodies = BodyTerms(self._mechanism, joint, trials, self._motions)
        self._drive.follow(self._motions, self._bodies, self._mechanism.actuators)
        self._torques = Torques(self._bodies, self._motions)
        self._held = [self._mechanism.held(joint, course) for course in self._bodies.courses]
        measured = trials[0].channel("measured").columns.keys() & self._mechanism.joints.keys()
        self.driven_by = self._mechanism.coupled(joint, measured)
        still = checks.assumptions(self._mechanism, joint, self._bodies.around[0])
        self.assumptions = (*still, *self._stuck(), *self._refuse_mistakes(trials))
        self._scales = scales = self._measure(step)
        own = joint_effects(stage.name, scales)
        parts = [part for part in joint.parts if "." not in part] if scales.mass else []
        names = [effect.name.rpartition(".")[2] for effect in own]
        common = [name for name in names if of_actuator(name)] if self._actuator and self._actuator.others else []
        self.shared = self.shared.union(common)
        self.together = common_effects(stage.name, parts, scales)
        self.whole = self.whole.union(common, (MASS + part for part in parts))
        like = f"{stage.name}.{self._torques.like_tilt(scales.tilts, scales.follows)}"
        self._like_tilt = like if like in {effect.name for effect in own} else ""
        given = given_values(stage, [*own, *self.together])
        self._known = neutral_values([*own, *self.together]) | self._nominal() | given | {CREEP: 0.0, STEPPED: 0.0}
        bends = self._known["coulomb_friction.torque"] > 0 and "coulomb_friction.give" not in given
        self.curved = self._bends = {"coulomb_friction.give": GIVES * scales.give} if bends else {}
        (friction,) = (effect for effect in own if effect.name == f"{stage.name}.coulomb_friction")
        self._frictions = friction, replace(friction, parameters=friction.parameters[:1])  # which bends, which creeps
        # Time in which an error of a window's start grows by GROWN.
        unstable_s = float(np.log(GROWN) / np.sqrt(pushed)) if (pushed := self._pushed()) > 0 else np.inf
        longest_s = min(scales.period_s, unstable_s / WINDOW_PERIODS)
        window_s, self.block_s = window_lengths(longest_s, scales.step_s, self._motions)
        self._each = self._substeps()
        out = [self._out(k) for k in range(len(trials))]
        self._edges = [cut_edges(window_edges(m.grid, window_s), o) for m, o in zip(self._motions, out, strict=True)]
        sent: Sequence[Array | None] = self._drive.sent or [None] * len(trials)
        terms = split(self._bodies.base, self._motions)
        signals = [features(*each, scales.speed) for each in zip(self._motions, self._edges, terms, sent, strict=True)]
        seen = [self._compared(k, out[k]) for k in range(len(trials))]
        if any(each.any() for each in out):
            self._refuse_touching(seen, trials)
        t_s = [m.grid.t_s for m in self._motions]
        super().__init__(stage.name, scales.length, (joint.name,), own, t_s, [s[:, None] for s in seen], step, signals)
        self._seen, swing = self.measured[:, 0].copy(), within_windows(self._motions, self._edges)
        least, white = float(max(FLOOR_SHARE * swing, step / np.sqrt(12), 1e-12)), white_noise(seen)
        self._samples = samples_averaged(white / swing, scales.period_s, scales.step_s)
        self._noise, self._own_floor = max(least, white), max(least, white / float(np.sqrt(self._samples)))
        self._simulation = self._simulated(self._edges)
        self._free = np.isfinite(self.measured[:, 0])
        self._unsure = np.zeros_like(self._free)
        self.measure_noise()
        self.measured = averaged(self.measured.T, slices(self.trial), self._samples).T
        self._zeros = self._zeros_of(trials)
        simulated = ((1.0, 0.0), (1.0, 1.0)) if self._feels_steps() else ((1.0, 0.0),)
        self.laws = [{CREEP: creeps, STEPPED: stepped} for creeps, stepped in ((0.0, 0.0), *simulated)]

    def _simulated(self, edges: Sequence[NDArray[np.int64]]) -> JointSimulation:
        """Return the simulation of windows with these edges, by trial."""
        stepping = self._mechanism.stepping
        found = JointSimulation(self._joint, self._drive, self._bodies, stepping, self._motions, self._each)
        (nominal,), slow = self._values([{}]), SLOW * 0.3 * self._scales.speed
        found.start(self._seen, edges, slow, nominal, self._noise)
        return found

    def uninterrupted(self) -> Self:
        """Return the view of the same samples with windows as long as recordings, if nothing makes errors grow."""
        if self._pushed() >= 0:
            return self
        ends = [(np.array([0, len(m.seen)]), self._out(k)) for k, m in enumerate(self._motions)]
        found = copy(self)
        found._simulation = self._simulated([cut_edges(*each) for each in ends])
        return found

    def assume(self, path: str, value: float) -> None:
        """Set 'effect.parameter' of the nominal model.

        The starts of windows are found again for another law of a simulation; friction that creeps does not bend.
        """
        changed = path in (CREEP, STEPPED) and value != self._known[path]
        super().assume(path, value)
        if changed:
            self._simulation.assume(path, value)
        if path == CREEP:
            self.curved = {} if value else self._bends
            friction = self._frictions[bool(value)]
            self.effects = tuple(friction if effect.name == friction.name else effect for effect in self.effects)

    def hold(self, effect: str, sizes: Mapping[str, Interval]) -> None:
        """Put an effect into the nominal model; beside a payload or a heavier body, all masses together correct it."""
        super().hold(effect, sizes)
        if sizes and adds_mass(effect):
            self.corrects = frozenset(("mass",))

    def measure_noise(self) -> None:
        """Measure the noise floor, and leave out samples that depend on motion of the other joints between samples.

        Noise of the other joints' readings raises the floor if it is not small: a light joint, such as a wrist, follows
        the accelerations of the joints that carry it. Friction that creeps yields to their peaks, which do not average
        out then. A sample depends on motion between samples if it moves by more than the floor when these accelerations
        are smoothed, and by more than their noise alone explains. If the majority does, all are kept.
        """
        if not any(self._bodies.around):
            self.floor = np.array([self._own_floor])
            return
        raw = self._raw_gaps([{}])[0]

        def moved(*, noisy: bool, smooth: bool) -> Array:
            return np.asarray(self._raw_gaps([{}], self._bodies.disturbed(noisy, smooth))[0] - raw)

        noise, smooth = moved(noisy=True, smooth=False), moved(noisy=False, smooth=True)
        self.floor = self._raised_floor(noise)
        large = np.abs(smooth) > self.floor[0]
        if large.any():
            large &= np.abs(smooth) > SIGMAS * rms(moved(noisy=True, smooth=True) - noise - smooth)
            self._leave_out(large)
            self.floor = self._raised_floor(noise, np.isfinite(self.measured[:, 0]))

    def _raised_floor(self, noise: Array, kept: NDArray[np.bool_] | slice = slice(None)) -> Array:
        """Return the noise floor, [1].

        Noise that the joint's own readings share with that of the others may cancel.

        Args:
            noise: change of the gap with noise of the other joints, which the gap has, [M].
            kept: samples that count, by default all.
        """
        own, felt = self._own_floor, min(rms(noise[kept]), rms(self._raw_gaps([{}])))
        if felt <= FELT_NOISE * own:
            return np.array([own])
        shared = averaged(self._bodies.shared_noise[None], slices(self.trial), self._samples)[0]
        return np.array([combined(own, felt, float(np.nanmean((noise * shared)[kept])))])

    def _feels_steps(self) -> bool:
        """Return whether the steps of a simulation with the model would move the joint by more than noise."""
        other, usual = self._raw_gaps([{f"{self.stage}.{STEPPED}": 1.0}, {}])
        return bool(rms(other - usual) > FELT_NOISE * self.floor[0])

    def part(self, effect: str) -> str:
        """Return the part of the mechanism that has an effect of the whole."""
        if of_actuator(effect) and self._actuator is not None:
            return f"actuator {effect.removeprefix(GAIN_OF) if effect.startswith(GAIN_OF) else self._actuator.name}"
        return effect.removeprefix(MASS) if effect.startswith(MASS) else self._end if effect == "payload" else "base"

    def _pushed(self) -> float:
        """Return the acceleration by an error of the position, 1/s^2; negative if a loop or a spring reduces it."""
        held = self._joint.spring + (self._actuator.kp if self._actuator is not None else 0.0)
        base = self._bodies.base
        return float(np.quantile(-(base[laws.BY_POSITION] + held) / base[laws.INERTIA], 0.9))

    def _leave_out(self, large: NDArray[np.bool_]) -> None:
        """Leave out samples [M] with a margin, unless these are the majority."""
        trials = zip(slices(self.trial), self._motions, strict=True)
        self._unsure |= np.concatenate([widened(large[part], m.grid.step_s) for part, m in trials])
        if self._unsure_share <= UNSURE_MOST:
            self.measured[self._unsure] = self._seen[self._unsure] = np.nan
            self._simulation.leave_out(self._unsure)

    @property
    def _unsure_share(self) -> float:
        """Share of the samples that depend on motion of the other joints between samples."""
        return float(self._unsure[self._free].mean())

    @property
    def _zero(self) -> float:
        """Error of a good zero, rad or m."""
        return ZERO_RAD if self._joint.turns else ZERO_SHARE * self._scales.travel

    def _zeros_of(self, trials: Sequence[Trial]) -> Zeros:
        moved, raw = self._raw_gaps([{f"{self.stage}.sensor_bias.bias": self._zero}, {}])
        change = (moved - raw) / self._zero
        return Zeros.of([t.recording or t.name for t in trials], self.trial, change, self._zero)

    def _substeps(self) -> int:
        """Return the integration steps per sample: no longer than the model's own, and fine enough for its loop."""
        stiff = self._actuator.kp / self._scales.inertia if self._actuator is not None else 0.0
        longest = min(self._mechanism.step_s, STEP_S, STEP_SHARE / max(np.sqrt(stiff), 1e-9))
        return int(min(np.ceil(self._scales.step_s / longest), SUBSTEPS_MOST))

    def _refuse_follower(self, trials: Sequence[Trial]) -> None:
        """Raise TrialError for a joint whose motion that of another determines."""
        joint = self._joint
        if leader := self._mechanism.leader(joint):
            raise TrialError(
                f"{trials[0].source}: joint {joint.name} follows {leader} by an equality of the model and has no gap "
                "of its own; move its column from `measured` to `base`"
            )

    def _refuse_touching(self, seen: Sequence[Array], trials: Sequence[Trial]) -> None:
        """Raise TrialError for a joint that is hardly ever free; seen: its measured values, NaN where it is not."""
        if (free := sum(int(np.isfinite(each).sum()) for each in seen)) >= FREE_LEAST:
            return
        course = self._bodies.courses[0]
        pair = self._mechanism.touching(self._joint, course)
        touch = f": {pair[0]} touches {pair[1]} in {pair[2]} of {len(course.centre.position)}" if pair else ""
        remedy = ", exclude this pair in the model if the robot's bodies do not touch" if pair else ""
        raise TrialError(
            f"{trials[0].source}: {self._joint.name} is free of contacts and limits in {free} samples; needed are "
            f"{FREE_LEAST}{touch}; record it in free motion{remedy}, or move its column from `measured` to `base`"
        )

    def _refuse_mistakes(self, trials: Sequence[Trial]) -> list[str]:
        """Raise TrialError if units, signs or gears of a trial certainly differ from the model's; return warnings.

        Stretches of a recording are too short to be judged; the whole was.
        """
        free = [~held for held in self._held]
        if sum(int(each.sum()) for each in free) < FREE_LEAST or any(trial.recording for trial in trials):
            return []
        joint, where = replace(self._joint, actuator=self._actuator), str(trials[0].source)
        seen = np.concatenate([m.position[used] for m, used in zip(self._motions, free, strict=True)])
        if found := [*checks.out_of_range(joint, where, seen)]:
            raise TrialError("\n".join(found))
        if not self._drive.sent:
            smooth = checks.smoother(self._motions, [m.speed for m in self._motions], free, NARROW)
            if wrong := misread(self._mechanism, joint, self._bodies.smoothed(smooth)):
                raise TrialError(f"{where}: {wrong}")
            return []
        sent = self._drive.acting()
        smooth = checks.smoother(self._motions, sent, free)
        signals = checks.compared(joint, self._motions, sent, smooth, self._terms_along)
        if found := [*checks.mistakes(joint, where, signals)]:
            raise TrialError("\n".join(found))

        def right() -> str:
            return right_description(self._mechanism, joint, self._bodies.smoothed(smooth), signals.command)

        return [*checks.unlike(joint, signals, right)]

    def _terms_along(self, along: Sequence[Motion]) -> list[Array]:
        """Return the rigid-body terms of each trial along a motion of the joint, [ROWS, T]."""
        own = along is self._motions
        return split(self._bodies.base, along) if own else self._bodies.terms_along(along)

    def _stuck(self) -> list[str]:
        if self._actuator is None or not self._actuator.kp > 0:
            return []
        seen = np.concatenate([m.position for m in self._motions])
        return [*checks.stuck(replace(self._joint, actuator=self._actuator), seen, np.concatenate(self._drive.sent))]

    def _measure(self, step: float) -> JointScales:
        joint, actuator, found = self._joint, self._actuator, self._motions
        speed = float(np.quantile(np.abs(np.concatenate([m.speed for m in found])), 0.99))
        torques, bodies = self._torques, self._bodies
        needed, loads = torques.total(bodies.base), np.abs(torques.load(bodies.base))
        longer = torques.total(bodies.longer(LENGTH_SHARES[-1])) if self._mechanism.carries(joint) else np.zeros(1)
        heavier, felt = torques.total(bodies.heavier), FELT * rms(needed)
        inertia = float(np.mean(bodies.base[laws.INERTIA]))
        floor = joint.viscous * speed + joint.friction  # a model without bodies needs this much at least
        return JointScales(
            joint=joint,
            driven=actuator is not None,
            follows=actuator is not None and actuator.kp > 0,
            actuators=tuple(self._drive.shares),
            torque=float(np.quantile(np.abs(needed), 0.995)) + floor,
            usual=float(np.mean(np.abs(needed))) + floor,
            lost=self._drive.lost(needed),
            load=float(np.quantile(loads, 0.995)) * (float(loads.max()) > FELT * float(np.abs(needed).max())),
            mass=float(rms(heavier) > felt),
            payloads_kg=torques.doubling_kg(FELT),
            moving_kg=self._mechanism.moving_kg(joint),
            reach=2 * bodies.reach_m,
            either_side=self._mechanism.last_link(self._joint).is_short,
            carries=rms(longer) > felt,
            tilts=tuple(axis for axis, each in torques.tilted().items() if rms(each) > felt),
            inertia=inertia,
            speed=max(speed, 1e-9),
            travel=max(float(max(np.ptp(m.position) for m in found)), 1e-9),
            resolution=max(step, *(m.noise for m in found)),
            step_s=float(np.median([m.grid.step_s for m in found])),
            period_s=period(found),
            command_rate=fastest_change(self._drive.inputs),
        )

    @property
    def indistinguishable(self) -> Mapping[str, tuple[str, ...]]:
        """Effect -> effects that no recording of such a stage can separate from it."""
        tilt = f"{self.stage}.tilt"
        alike = self._like_tilt and any(effect.name == tilt for effect in self.effects)
        return {**super().indistinguishable, **({self._like_tilt: (tilt,)} if alike else {})}

    def _nominal(self) -> dict[str, float]:
        joint, actuator = self._joint, self._actuator
        found = {
            "coulomb_friction.torque": joint.friction,
            "damping.viscous": joint.viscous,
            "armature.inertia": joint.armature,
            "spring.stiffness": joint.spring,
        }
        if actuator is not None:
            found |= {"dead_time.delay": actuator.delay_s, "lag.time": actuator.lag_s, "ceiling.limit": actuator.high}
        return found

    @property
    def tolerances(self) -> Mapping[str, float]:
        """Errors that a good nominal model may have, by 'effect.parameter'."""
        s, give = self._scales, self._known["coulomb_friction.give"]
        own = {
            "spring.stiffness": OF_OWN * self._joint.spring,
            "coulomb_friction.torque": max(OF_OWN * self._joint.friction, OF_FORCE * s.usual),
            "coulomb_friction.give": max(give, GIVES[-1] * s.give - give),
            "damping.viscous": max(OF_OWN * self._joint.viscous, OF_FORCE * s.usual / s.speed),
            "armature.inertia": max(OF_OWN * self._joint.armature, OF_FORCE * s.inertia),
            "sensor_bias.bias": self._zero,
            "mass.scale": OF_OWN,
            "length.scale": OF_LENGTH,
            "gain.scale": OF_OWN,
            "position_gain.scale": OF_OWN,
            **{f"{GAIN_OF}{name}.scale": OF_OWN for name in self._drive.shares},
        }
        if inputs := self._drive.inputs:
            own["dead_time.delay"] = HELD_LATE * usual_step(inputs)
            own["torque_offset.torque"] = OF_FORCE * s.usual
            own["command_bias.bias"] = self._zero
        return own if self._like_tilt else own | {f"tilt.{axis}": LEVEL_RAD for axis in self._scales.tilts}

    def warnings(self, point: Point) -> tuple[str, ...]:
        """Return warnings about motion of other joints between samples, and about zeros that differ."""
        found = [*self.assumptions]
        if self._known[STEPPED]:
            found.append(
                f"{self.stage}: the motion has the errors of a simulation with the model's own step of "
                f"{self._mechanism.step_s:g} s, which are taken into account: the recordings may come from a simulation"
            )
        if self._known[CREEP] and self.value(point, "coulomb_friction.torque"):
            found.append(
                f"{self.stage}: the dry friction creeps as MuJoCo's soft friction does, where real friction holds: "
                "the recordings may come from a simulation"
            )
        if (unsure := self._unsure_share) > UNSURE_WARNED:
            left_out = unsure <= UNSURE_MOST
            share, done = (UNSURE_WARNED, "left out") if left_out else (UNSURE_MOST, "kept, and sizes are less certain")
            found.append(
                f"{self.stage}: more than {share:.0%} of the samples depend on motion of other joints between two "
                f"samples and are {done}; record at a higher rate, or move fewer joints at once"
            )
        if apart := self._zeros.apart(self._raw_gaps([point])):
            found.append(
                f"{self.stage}: its zero differs between recordings by {apart:.2g} {self.unit}; no effect explains it, "
                "and the gap leaves out; set the zero against a stop at each start, not in a pose that friction holds"
            )
        return tuple(found)

    @property
    def model_uncertainty(self) -> Mapping[str, float]:
        """Uncertainty of times: 'effect.parameter' -> half-width."""
        inputs = self._drive.inputs
        return time_uncertainty(usual_step(inputs)) if inputs else {}

    @property
    def own_nuisances(self) -> Mapping[str, float]:
        """Errors of a good model that are no effect: name -> share of a body's mass; of an only body it is `mass`."""
        return {effect.name: OF_OWN for effect in self.together} if len(self._joint.parts) > 1 else {}

    def own_directions(self) -> NDArray[np.float32]:
        """Return how the gap changes with each of these errors, [q, M, 1]."""
        found = self._gaps([{f"{effect.name}.scale": OF_OWN} for effect in self.together]) - self._gaps([{}])
        return found.astype(np.float32).reshape(len(self.together), *self.measured.shape)

    @property
    def regimes(self) -> Mapping[str, NDArray[np.bool_]]:
        """Parts of the data by speed and direction."""
        return regimes(self.features, self._scales.speed, self._scales.period_s)

    def gap(self, points: Sequence[Point]) -> NDArray[np.float32]:
        """Return measured minus predicted values at each of P points, [P, M, 1]; NaN where no sample was measured."""
        return self._gaps(points).astype(np.float32)

    def _gaps(self, points: Sequence[Point]) -> Array:
        """Return the gaps [P, M, 1]."""
        return self._zeros.without(self._raw_gaps(points))[..., None]

    def _raw_gaps(self, points: Sequence[Point], terms: Array | None = None) -> Array:
        """Return the gaps [P, M] with one zero for all recordings."""
        left = self._simulation.residuals(self._values(points), terms)
        self._simulation.free_starts(left)
        return averaged(left, slices(self.trial), self._samples)

    def _values(self, points: Sequence[Point]) -> list[dict[str, float]]:
        """Return every parameter of each point, by 'effect.parameter'."""
        return [{path: self.value(point, path) for path in self._known} for point in points]

    def _out(self, k: int) -> NDArray[np.bool_]:
        """Return whether a trial's sample is near a joint limit or a contact, or its actuator's state unknown, [T]."""
        m, (low, high) = self._motions[k], self._joint.range
        touching = widened(self._held[k] | (m.position <= low) | (m.position >= high), m.grid.step_s)
        return np.asarray(touching | (m.grid.t_s < self._drive.settled_s[k]))

    def _compared(self, k: int, out: NDArray[np.bool_]) -> Array:
        """Return a trial's measured values, [T]; NaN where samples are left out, and in short windows between these."""
        seen = np.where(out, np.nan, self._motions[k].seen)
        for first, end in pairwise(self._edges[k]):
            if end - first < SAMPLES_LEAST and out[[max(first - 1, 0), min(end, len(out) - 1)]].any():
                seen[first:end] = np.nan
        return seen
