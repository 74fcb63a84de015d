"""View of a mass that a force, a torque or a motor's current moves: a cart on a rail, a motor's axis, a linear stage.

The model is simulated in short windows whose starts are fitted at every point, and its motion is compared with the
measured one. No acceleration is needed, so an encoder suffices, and an inexact model does not diverge.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.data.trials import Trial, TrialError, stage_of
from softarm.diagnosis.engine.view import Array, Point
from softarm.diagnosis.rigs.driven_mass_effects import DrivenMassScales, driven_mass_effects
from softarm.diagnosis.rigs.grid import held_integral, held_means, resolution, time_since_change, usual_step
from softarm.diagnosis.rigs.laws import driven_mass as laws
from softarm.diagnosis.rigs.motion import (
    STILL,
    Motion,
    directions,
    motions,
    period,
    regimes,
    summed_twice,
    time_uncertainty,
    window_edges,
    window_lengths,
    within_windows,
)
from softarm.diagnosis.rigs.views import FLOOR_SHARE, RigView, common_column, given_values, neutral_values
from softarm.simulator.effects import Effect

# Columns that can drive the mass -> their unit, in the order in which they are looked for.
DRIVEN_BY = {"force": "N", "current": "A", "voltage": "V"}
STEPS_PER_PERIOD, SUBSTEPS_MOST = 60, 8
# Number of spring frequencies that are tried, with this load share.
TRIED, NUDGED = 20, 0.05
# Iterations of the fit of a window's start.
ROUNDS = 3
# Uncertainty of the input's stamps, in steps: the input may be held or sampled.
HELD_LATE = 0.5
# Errors of a good nominal model: shares of its gain, of its own values, and of the usual force.
OF_GAIN, OF_OWN, OF_FORCE = 0.01, 0.02, 0.004
# Uncertainty of the travel over which friction bends, as a multiple.
GIVE_TIMES = 3.0
# Share of the largest force from which a force is large.
STRONG = 0.6
_MODEL = {
    "viscous": "damping.viscous",
    "coulomb": "coulomb_friction.force",
    "offset": "force_offset.force",
    "delay_s": "dead_time.delay",
}
_INPUT = ("dead_time.delay", "latency.delay", "deadband.width", "ceiling.limit", "lag.time", "gain.scale")


class DrivenMassView(RigView):
    """View from the input to the position, or to the velocity if no position was recorded; all trials of one stage."""

    step_cost_s = 1.0e-6  # 0.4e-6 unless friction bends

    def __init__(self, trials: Sequence[Trial]) -> None:
        """Prepare the trials of one driven mass; raise TrialError if one lacks a column, or nothing drives it."""
        stage = stage_of(trials)
        rotary = "inertia_kg_m2" in stage.model
        self._mass = stage.number("inertia_kg_m2" if rotary else "mass_kg", 1.0)
        self._gain = stage.number("gain", 1.0)
        column = common_column(trials, "measured", ("position", "velocity"))
        self._speed_alone = column == "velocity"
        driver = common_column(trials, "force", DRIVEN_BY)
        step = resolution([t.channel("measured")[column] for t in trials])
        sent = [t.channel("force")[driver] for t in trials]
        self._inputs = [held_integral(t.channel("force"), u, 10.0) for t, u in zip(trials, sent, strict=True)]
        limit = abs(self._gain) * _largest(sent) / self._mass
        self._motions = motions(trials, column, step, limit, speed_alone=self._speed_alone)
        length = stage.unit("measured", column).removesuffix("/s") or ("rad" if rotary else "m")
        force = "N m" if rotary else "N"
        units = length, force, force if driver == "force" else DRIVEN_BY[driver]
        self._scales = scales = self._measure(units, sent, limit, step)
        own = driven_mass_effects(stage.name, scales, self._speed_alone)
        self._known = neutral_values(own) | {path: stage.number(key, 0.0) for key, path in _MODEL.items()}
        self._known |= given_values(stage, own)
        window_s, self.block_s = window_lengths(scales.period_s, scales.step_s, self._motions)
        self._edges = [window_edges(m.grid, window_s) for m in self._motions]
        self._each = int(min(max(np.ceil(scales.step_s * STEPS_PER_PERIOD / scales.period_s), 1), SUBSTEPS_MOST))
        self._delayed = lru_cache(64 * len(trials))(self._held)
        self._forces = lru_cache(16)(self._driven)
        signals = [self._signals(k) for k in range(len(trials))]
        unit = scales.speed_unit if self._speed_alone else scales.length
        t_s, seen = [m.grid.t_s for m in self._motions], [m.seen[:, None] for m in self._motions]
        super().__init__(stage.name, unit, (column,), own, t_s, seen, step, signals)
        swing = within_windows(self._motions, self._edges)
        self.floor = np.array([max(FLOOR_SHARE * swing, step, *(m.noise for m in self._motions), 1e-12)])
        self._windows = [self._starts(m, e) for m, e in zip(self._motions, self._edges, strict=True)]
        self._fit = laws.Fit(float(self.floor[0]), scales.step_s, self._each, ROUNDS, self._speed_alone)
        if "compliance" not in stage.effects:
            self.effects = tuple(self._tuned(e) if e.name.endswith(".compliance") else e for e in self.effects)

    def _tuned(self, effect: Effect) -> Effect:
        """Start a spring's frequency where it explains most, because a search finds a resonance only from nearby."""
        share, frequency, ratio = effect.parameters
        tried, gain = np.geomspace(frequency.low, frequency.high, TRIED), []
        base = np.nan_to_num(self._gap({})[:, 0])
        for hz in tried:
            point = {f"{effect.name}.share": NUDGED, f"{effect.name}.frequency": hz}
            change = np.nan_to_num(self._gap(point)[:, 0]) - base
            gain.append(float(change @ base) ** 2 / max(float(change @ change), 1e-300))
        best = float(tried[int(np.argmax(gain))])
        self._known["compliance.frequency"] = best
        return replace(effect, parameters=(share, replace(frequency, neutral=best, default=best, exemplar=best), ratio))

    @property
    def tolerances(self) -> Mapping[str, float]:
        """Errors that a good nominal model may have, by 'effect.parameter'."""
        s = self._scales
        own = {path: max(OF_OWN * abs(self.nominal(path)), OF_FORCE * s.usual) for path in _MODEL.values()}
        return own | {
            "coulomb_friction.give": GIVE_TIMES * self.nominal("coulomb_friction.give"),
            "gain.scale": OF_GAIN,
            "dead_time.delay": HELD_LATE * usual_step(self._inputs),
            "damping.viscous": max(OF_OWN * self.nominal("damping.viscous"), OF_FORCE * s.usual / s.speed),
        }

    @property
    def model_uncertainty(self) -> Mapping[str, float]:
        """Uncertainty of times: 'effect.parameter' -> half-width."""
        return time_uncertainty(usual_step(self._inputs))

    @property
    def regimes(self) -> Mapping[str, NDArray[np.bool_]]:
        """Parts of the data by speed, direction and force."""
        force, s = np.abs(self.features["force"]), self._scales
        found = regimes(self.features, s.speed, s.period_s)
        coasting = ~found["at rest"] & (force < 0.05 * s.force)
        return found | {"under a large force": force > STRONG * s.force, "coasting": coasting}

    def _gap(self, point: Point) -> Array:
        point = {path: self.value(point, path) for path in self._known}
        law, parts = self._law(point), []
        forces = self._forces(*(point[path] for path in _INPUT))
        for m, windows, force in zip(self._motions, self._windows, forces, strict=True):
            out = np.empty(len(m.seen))
            laws.residuals(windows, force, law, self._fit._replace(step_s=m.grid.step_s), out)
            parts.append(out)
        return np.concatenate(parts)[:, None]

    def _law(self, point: Point) -> Array:
        law = np.zeros(laws.COLUMNS)
        dry, more = point["coulomb_friction.force"], point["friction_asymmetry.force"]
        law[laws.FORWARD], law[laws.BACKWARD] = max(dry + more, 0.0), max(dry - more, 0.0)
        law[laws.MASS] = self._mass * (1 + point["mass.scale"])
        for path, column in (
            ("coulomb_friction.give", laws.GIVE),
            ("stiction.force", laws.STICTION),
            ("stiction.speed", laws.SPEED),
            ("damping.viscous", laws.VISCOUS),
            ("drag.coefficient", laws.DRAG),
            ("force_offset.force", laws.OFFSET),
        ):
            law[column] = point[path]
        if self._speed_alone:
            law[laws.BIAS] = point["sensor_bias.bias"]
        else:
            law[laws.GAP], share = point["backlash.gap"], point["compliance.share"]
            law[laws.SHARE], law[laws.RATIO] = share, point["compliance.ratio"]
            law[laws.OMEGA] = 2 * np.pi * point["compliance.frequency"] if share != 0.0 else 0.0
        return law

    def _driven(
        self, dead_s: float, late_s: float, width: float, limit: float, lag_s: float, scale: float
    ) -> list[Array]:
        """Forces of all trials, [T each], by the parameters of `_INPUT`."""
        law, found = np.zeros(laws.COLUMNS), []
        law[laws.WIDTH], law[laws.LIMIT], law[laws.LAG] = width, limit, lag_s
        law[laws.GAIN] = self._gain * (1 + scale)
        for k, m in enumerate(self._motions):
            held = self._delayed(k, dead_s + late_s)
            out = np.empty_like(held)
            laws.drive(held, law, m.grid.step_s / self._each, out)
            found.append(out)
        return found

    def _held(self, k: int, delay_s: float) -> Array:
        """Mean of the delayed input over every step; a delay may be any fraction of a sample."""
        g = self._motions[k].grid
        return held_means(self._inputs[k], g.t_s[0] - delay_s, g.step_s / self._each, len(g.t_s) * self._each)

    def _measure(
        self, units: tuple[str, str, str], sent: Sequence[Array], limit: float, step: float
    ) -> DrivenMassScales:
        """Scales of the recordings; units: of position, force and input."""
        found, gain, largest = self._motions, abs(self._gain), _largest(sent)
        speed = float(np.quantile(np.abs(np.concatenate([m.speed for m in found])), 0.99))
        return DrivenMassScales(
            *units,
            input=largest,
            force=gain * largest,
            usual=gain * float(np.mean([np.mean(np.abs(u)) for u in sent])),
            speed=max(speed, 1e-9),
            travel=max(float(max(np.ptp(m.position) for m in found)), 1e-9),
            resolution=max(step, *(m.noise for m in found)),
            step_s=float(np.median([m.grid.step_s for m in found])),
            period_s=period(found, limit, speed_alone=self._speed_alone),
        )

    def _starts(self, m: Motion, edges: NDArray[np.int64]) -> laws.Windows:
        """Windows of a trial with the measured state at the start of each."""
        first = edges[:-1]
        moving, sides = directions(m, edges, 0.05 * self._scales.speed)
        position = np.zeros(len(first)) if self._speed_alone else m.position[first]
        starts = np.ascontiguousarray(np.stack((position, m.speed[first]), axis=1))
        return laws.Windows(m.seen, edges, starts, m.spread, sides, moving)

    def _signals(self, k: int) -> dict[str, Array]:
        """Features for a flexible model of the residual; sums over a window, because a push shows long after."""
        m, edges = self._motions[k], self._edges[k]
        t, v = m.grid.t_s, m.speed
        force = self._gain * self._delayed(k, self.nominal("dead_time.delay")).reshape(len(t), -1).mean(axis=1)
        direction = np.sign(np.where(np.abs(v) > STILL * self._scales.speed, v, 0.0))
        signals = {"force": force, "speed": v, "direction": direction}
        signals |= {"time since reversal": time_since_change(t, np.sign(v)), "position": m.position}
        begun = np.repeat(edges[:-1], np.diff(edges))
        signals["time in the window"] = t - t[begun]
        sums = {
            "force": force,
            "direction": direction,
            "speed": v,
            "drag": v * np.abs(v),
            "position": m.position - m.position.mean(),
        }
        for name, values in sums.items():
            signals[f"{name}, summed"] = summed_twice(values, edges, m.grid.step_s, once=self._speed_alone)
        return signals


def _largest(signals: Sequence[Array]) -> float:
    """Largest value of the signals without a few outliers; raises TrialError if all values are zero."""
    largest = float(np.quantile(np.abs(np.concatenate(signals)), 0.995))
    if not largest > 0:
        raise TrialError(
            "the force is zero in every trial, so nothing drives the mass; check `source` in the stage.yaml"
        )
    return largest
