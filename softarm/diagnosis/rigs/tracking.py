"""View of an actuator that follows a command: a servo, a regulator, an axis in velocity mode.

The nominal model follows at once and exactly, unless the stage.yaml gives it a lag, a delay or limits.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from softarm.common.quantity import PURE
from softarm.diagnosis.data.trials import Series, TableStage, Trial, stage_of
from softarm.diagnosis.engine.view import Array, Point
from softarm.diagnosis.rigs.grid import Grid, grid, held_integral, held_means, resolution, time_since_change
from softarm.diagnosis.rigs.laws import tracking as law
from softarm.diagnosis.rigs.scales import TrackingScales, repeatability, scales, stretch, white_noise
from softarm.diagnosis.rigs.tracking_effects import tracking_effects
from softarm.diagnosis.rigs.views import RigView, common_column, given_values, neutral_values

# Columns that can follow the command -> their default unit. The first one that a table has is used.
MEASURED = {"position": "rad", "pressure": "kPa", "velocity": "m/s", "value": PURE}
# Integration steps per sample of a stage with at most FEW samples; with more samples, one step each.
SUBSTEPS, FEW = 2, 12_000
# The start of a trial is skipped, because earlier commands still show: at most this share of the trial, and at most
# this multiple of the delay.
SKIPPED, SETTLED = 0.03, 5.0
# Share of the signal's RMS that averaging a fast source may lose.
RESOLVED = 3e-3
# Least number of samples that remain of a trial, and largest number of samples that are averaged into one.
LEAST, BINS_MOST = 500, 1024
# Accuracy of stamps, in samples.
DELAY_TOLERANCE = 0.2
# Errors of a good nominal model, as shares of its lag and of the range.
LAG_TOLERANCE, ZERO_TOLERANCE = 0.06, 0.001
# Weights that extrapolate the straight line through three readings to the first one.
_FIRST = np.array((5, 2, -1)) / 6
_LAW = (
    ("gain.scale", law.SCALE),
    ("gain.offset", law.OFFSET),
    ("deadband.width", law.WIDTH),
    ("lag.rise", law.RISE),
    ("lag.fall", law.FALL),
    ("rate_limit.rate", law.RATE),
    ("rate_limit.fall", law.DOWN),
    ("acceleration_limit.acceleration", law.ACCELERATION),
    ("second_order.damping", law.DAMPING),
    ("second_order.coupling", law.COUPLING),
    ("backlash.gap", law.GAP),
    ("hysteresis.strength", law.STRENGTH),
    ("hysteresis.width", law.LOOP),
    ("sensor_bias.bias", law.BIAS),
    ("coulomb_friction.loss", law.DRY),
)
# Key of a stage.yaml's model -> the parameters that it sets.
_MODEL = {
    "lag_s": ("lag.rise", "lag.fall"),
    "delay_s": ("dead_time.delay",),
    "rate_limit": ("rate_limit.rate", "rate_limit.fall"),
    "acceleration_limit": ("acceleration_limit.acceleration",),
}


class TrackingView(RigView):
    """View from the command to the measured channel, all trials of one stage."""

    def __init__(self, trials: Sequence[Trial]) -> None:
        """Prepare the trials of one tracking stage; raise TrialError if one lacks a column."""
        about = stage_of(trials)
        stage = about.name
        column = common_column(trials, "measured", MEASURED)
        unit = about.unit("measured", column) or MEASURED[column]
        rate = max(resolving_hz(t.channel("measured"), column) for t in trials)
        grids = [grid(t.channel("measured"), rate) for t in trials]
        commands = [_mean_command(t.channel("command"), about) for t in trials]
        seen = [g.columns[column] for g in grids]
        means = [held_means(c, g.t_s[0], g.step_s, len(g.t_s)) for g, c in zip(grids, commands, strict=True)]
        self.scales = scales([g.t_s for g in grids], means, seen)
        shown = [
            np.where(g.t_s - g.t_s[0] < _skipped(g, self.scales.late_s), np.nan, s)[:, None]
            for g, s in zip(grids, seen, strict=True)
        ]
        step = resolution([t.channel("measured")[column] for t in trials])
        signals = [_signals(g, m, s, self.scales) for g, m, s in zip(grids, means, seen, strict=True)]
        found = tracking_effects(stage, unit, self.scales, velocity=column == "velocity")
        super().__init__(stage, unit, (column,), found, [g.t_s for g in grids], shown, step, signals)
        self.floor = np.maximum(self.floor, max(self.scales.noise, repeatability(means, seen)))
        self.block_s = stretch([g.t_s for g in grids], seen, self.scales.late_s)
        neutral = neutral_values(found)
        self._no_ceiling = neutral.get("ceiling.limit", np.inf)
        self._known = neutral | {path: about.number(key, 0.0) for key in about.model for path in _MODEL.get(key, ())}
        self._known |= given_values(about, found)
        self._grids, self._commands = grids, commands
        self._starts = [float(_FIRST @ s[np.isfinite(s)][:3]) for s in seen]
        changes = [_between_changes(t.channel("command")) for t in trials]
        self._changes_s = float(np.median(np.concatenate([*changes, [self.scales.longest_s]])))
        self._each = SUBSTEPS if len(self.t_s) <= FEW else 1
        self._delayed = lru_cache(64 * len(trials))(self._command)
        # In recordings at one level a wrong zero may be many times the motion.
        mean = float(np.nanmean(self.gap([{}])))
        self.gap_starts = {"sensor_bias": (mean,), "gain": (0.0, mean)}

    @property
    def regimes(self) -> Mapping[str, NDArray[np.bool_]]:
        """Parts of the data by how the command moves and on which side the error is."""
        rate, error = self.features["command rate"], self.features["error"]
        fast = float(np.quantile(np.abs(rate), 0.9)) or float(np.abs(rate).max())
        still = np.abs(rate) < 0.02 * max(fast, 1e-12)
        return {
            "command standing": still,
            "command moving slowly": ~still & (np.abs(rate) < 0.3 * fast),
            "command moving fast": ~still & (np.abs(rate) >= 0.3 * fast),
            "command rising": rate > 0.02 * fast,
            "command falling": rate < -0.02 * fast,
            "behind from below": error > 0,
            "behind from above": error < 0,
            "after a reversal": self.features["time since reversal"] < 4 * self.scales.late_s,
        }

    @property
    def tolerances(self) -> Mapping[str, float]:
        """Errors that a good nominal model may have, by 'effect.parameter'."""
        delay = DELAY_TOLERANCE * self.scales.step_s
        zero = max(float(self.floor.max()), ZERO_TOLERANCE * self.scales.reach)
        lags = {path: LAG_TOLERANCE * self.nominal(path) for path in _MODEL["lag_s"] if self.nominal(path) > 0}
        return lags | {
            "dead_time.delay": delay, "latency.delay": delay, "gain.offset": zero, "sensor_bias.bias": zero
        }  # fmt: skip

    def unresolved(self, point: Point) -> Mapping[str, float]:
        """Return half-widths of delays that change no sample: without a lag, half the time between commands."""
        lag_s = max(self.value(point, path) for path in _MODEL["lag_s"])
        if np.isfinite(self.value(point, "second_order.frequency")) or lag_s > self.scales.step_s:
            return {}
        return dict.fromkeys(("dead_time.delay", "latency.delay"), 0.5 * min(self.scales.step_s, self._changes_s))

    @property
    def model_uncertainty(self) -> Mapping[str, float]:
        """Uncertainty of a lag or of a delay next to it: the nominal lag's own tolerance.

        How cascaded loops divide their total delay into lag and dead time depends on the form of the law.
        """
        lags = {path: LAG_TOLERANCE * self.nominal(path) for path in _MODEL["lag_s"] if path in self._known}
        return lags | dict.fromkeys(("dead_time.delay", "latency.delay"), max(lags.values(), default=0.0))

    def _gap(self, point: Point) -> Array:
        numbers = np.zeros(law.COLUMNS)
        for path, at in _LAW:
            numbers[at] = self.value(point, path)
        numbers[law.PERIOD] = 1 / (2 * np.pi * self.value(point, "second_order.frequency"))
        ceiling = self.value(point, "ceiling.limit", np.inf)
        numbers[law.CEILING] = ceiling if ceiling < self._no_ceiling else np.inf
        # The law is the same: only the sum shows.
        delay = self.value(point, "dead_time.delay") + self.value(point, "latency.delay")
        parts = []
        for k, g in enumerate(self._grids):
            out = np.empty(len(g.t_s))
            law.follow(*self._delayed(k, delay), self._starts[k], numbers, g.step_s / self._each, self._each, out)
            parts.append(out)
        return np.asarray(self.measured - np.concatenate(parts)[:, None])

    def _command(self, k: int, delay_s: float) -> tuple[Array, Array]:
        """Delayed command of trial k: its mean over every substep, and its value just before each substep's edge."""
        g, (t, summed) = self._grids[k], self._commands[k]
        h = g.step_s / self._each
        edges = g.t_s[0] - delay_s + h * np.arange(len(g.t_s) * self._each + 1)
        held = np.diff(summed) / np.diff(t)
        last = np.clip(np.searchsorted(t, edges) - 1, 0, len(held) - 1)
        return np.diff(np.interp(edges, t, summed)) / h, held[last]


def _mean_command(series: Series, stage: TableStage) -> tuple[Array, Array]:
    """Stamps, and the integral of the nominal final value under the held command; extended at both ends."""
    margin = float(series.t_s[-1] - series.t_s[0]) + 1.0
    return held_integral(series, stage.reached(series["command"]), margin)


def resolving_hz(series: Series, column: str) -> float:
    """Return the lowest rate, Hz, at which averaging a measured column loses only noise; at most its source's rate."""
    t, x = series.t_s, series[column]
    usual = float(np.median(np.diff(t)))
    noise, bins = white_noise([x]), 1
    lost = (RESOLVED * float(np.std(x))) ** 2
    while 2 * bins <= BINS_MOST and len(x) // (2 * bins) > LEAST:
        wide = 2 * bins
        whole = x[: len(x) // wide * wide].reshape(-1, wide)
        place = np.arange(whole.size)
        left = whole.ravel() - np.interp(place, place[::wide] + 0.5 * (wide - 1), whole.mean(axis=1))
        if float(np.mean(left**2)) > 1.1 * noise**2 * (1 + 1 / wide) + lost:
            break
        bins = wide
    return 1 / (usual * bins)


def _between_changes(command: Series) -> Array:
    """Times between changes of the command, s."""
    return np.asarray(np.diff(command.t_s[np.flatnonzero(np.diff(command["command"], prepend=np.nan))]))


def _skipped(g: Grid, late_s: float) -> float:
    """Time that is skipped at a trial's start, s."""
    return min(SKIPPED * float(g.t_s[-1] - g.t_s[0]), SETTLED * late_s)


def _signals(g: Grid, u: Array, seen: Array, scale: TrackingScales) -> dict[str, Array]:
    """Features for a flexible model of the residual."""
    seen = np.interp(g.t_s, g.t_s[np.isfinite(seen)], seen[np.isfinite(seen)])
    rate = np.gradient(u, g.step_s)
    moving = np.abs(rate) > 1e-9 * scale.reach / scale.step_s
    direction = np.sign(rate)[np.maximum.accumulate(np.where(moving, np.arange(len(u)), 0))]
    signals = {
        "command": u,
        "command rate": rate,
        "error": u - seen,
        "time since reversal": time_since_change(g.t_s, direction),
    }
    if "effort" in g.columns:
        signals["effort"] = np.nan_to_num(g.columns["effort"])
    for name, times in (("a little", 1), ("some time", 3)):
        back = min(max(1, round(times * scale.late_s / g.step_s)), len(u) - 1)
        signals[f"command {name} before"] = np.concatenate((np.full(back, u[0]), u[:-back]))
    return signals
