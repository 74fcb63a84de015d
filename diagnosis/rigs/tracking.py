"""What follows a command: a servo, a regulator, an axis in velocity mode. The nominal follows at once and exactly."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from softarm.common.quantity import PURE
from softarm.diagnosis.data.trials import Series, Trial, TrialError
from softarm.diagnosis.engine.view import Array, Point
from softarm.diagnosis.rigs.grid import Grid, grid, resolution
from softarm.diagnosis.rigs.laws import tracking as law
from softarm.diagnosis.rigs.scales import Scales, repeatability, scales, stretch, tracking_spans, white_noise
from softarm.diagnosis.rigs.views import RigView
from softarm.diagnosis.rigs.vocabulary import effects
from softarm.schemas.stage_model import ModelValue

# What is measured -> its unit, if nobody says another; the first that a table has is what follows the command.
MEASURED = {"position": "rad", "pressure": "kPa", "velocity": "m/s", "value": PURE}
SUBSTEPS, FEW = 2, 12_000  # of a sample, where a stage has few; of many a step is one
SKIPPED, SETTLED = (
    0.03,
    5.0,
)  # of a trial at its start, at most; and of the rig's lateness: what went before still shows
SLOPE_TOLERANCE = 0.3  # a velocity further from its position's slope than this share is in another unit
RESOLVED = 3e-3  # of the signal's RMS: what may be lost where a fast source is averaged
LEAST, BINS_MOST = 500, 1024  # samples of a trial that stay, and of a source that become one
DELAY_TOLERANCE = 0.2  # of a sample: stamps are no better
LAG_TOLERANCE, ZERO_TOLERANCE = 0.06, 0.001  # of the nominal lag, of the range
_FIRST = np.array((5, 2, -1)) / 6  # of three readings: their straight line at the first
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
_MODEL = {  # of a stage.yaml's model
    "lag_s": ("lag.rise", "lag.fall"),
    "delay_s": ("dead_time.delay",),
    "rate_limit": ("rate_limit.rate", "rate_limit.fall"),
    "acceleration_limit": ("acceleration_limit.acceleration",),
}


class TrackingView(RigView):
    """Command to what is measured of the follower, all trials of one stage."""

    def __init__(self, trials: Sequence[Trial], unit: str | None = None) -> None:
        """Raises TrialError for trials of no tracking stage. unit: of what is measured, if it is not the usual one."""
        stage = _stage(trials)
        column = _measured(stage, trials)
        told = trials[0].stage.unit("measured", column) if trials[0].stage is not None else ""
        unit = unit or told or MEASURED[column]
        rate = max(resolving_hz(t.channel("measured"), column) for t in trials)
        grids = [grid(t.channel("measured"), rate) for t in trials]
        given = _given(trials)
        commands = [_mean_command(t.channel("command"), given) for t in trials]
        seen = [g.columns[column] for g in grids]
        means = [_held(g, c) for g, c in zip(grids, commands, strict=True)]
        self.scales = scales([g.t_s for g in grids], means, seen)
        shown = [
            np.where(g.t_s - g.t_s[0] < _skipped(g, self.scales.late_s), np.nan, s)[:, None]
            for g, s in zip(grids, seen, strict=True)
        ]
        step = resolution([t.channel("measured")[column] for t in trials])
        signals = [_signals(g, m, s, self.scales) for g, m, s in zip(grids, means, seen, strict=True)]
        found = effects("tracking", stage, unit, spans=tracking_spans(self.scales, column == "velocity"))
        super().__init__(stage, unit, (column,), found, [g.t_s for g in grids], shown, step, signals)
        self.floor = np.maximum(self.floor, max(self.scales.noise, repeatability(means, seen)))
        self.block_s = stretch([g.t_s for g in grids], seen, self.scales.late_s)
        self._known = {f"{e.name.rpartition('.')[2]}.{n.name}": n.neutral for e in found for n in e.parameters}
        self._known |= {path: float(np.ravel(given[key])[0]) for key in given for path in _MODEL.get(key, ())}
        self._grids, self._commands = grids, commands
        self._starts = [float(_FIRST @ s[np.isfinite(s)][:3]) for s in seen]
        sent = [t.channel("command") for t in trials]
        self._changes_s = float(
            np.median(np.concatenate([*(_between_changes(s) for s in sent), [self.scales.longest_s]]))
        )
        self._each = SUBSTEPS if len(self.t_s) <= FEW else 1
        self._late: dict[tuple[int, float], tuple[Array, Array]] = {}

    @property
    def regimes(self) -> Mapping[str, NDArray[np.bool_]]:
        """See View."""
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
    def twins(self) -> Mapping[str, tuple[str, ...]]:
        """See RigView: from command to reading only the sum of the two delays shows."""
        return {f"{self.stage}.dead_time": (f"{self.stage}.latency",)}

    @property
    def tolerances(self) -> Mapping[str, float]:
        """See RigView; a delay in samples of this recording."""
        delay = DELAY_TOLERANCE * self.scales.step_s
        zero = max(float(self.floor.max()), ZERO_TOLERANCE * self.scales.reach)
        lags = {path: LAG_TOLERANCE * self.nominal(path) for path in _MODEL["lag_s"] if self.nominal(path) > 0}
        return lags | {
            "dead_time.delay": delay, "latency.delay": delay, "gain.offset": zero, "sensor_bias.bias": zero
        }  # fmt: skip

    def known_to(self, point: Point) -> Mapping[str, float]:
        """See RigView: of what follows a held command at once a sample says only that it has changed since the last."""
        inert = ("lag.rise", "lag.fall") if np.isinf(self._value([point], "second_order.frequency")) else ()
        if not inert or max(self._value([point], path) for path in inert) > self.scales.step_s:
            return {}
        return dict.fromkeys(("dead_time.delay", "latency.delay"), 0.5 * min(self.scales.step_s, self._changes_s))

    @property
    def forms(self) -> Mapping[str, float]:
        """See RigView: of a loop within a loop a lag and a delay share what is late as the laws' form will have it.

        What a nominal lag may be off by is nobody's gap; a delay beside it is known no better.
        """
        late = max((LAG_TOLERANCE * self.nominal(path) for path in _MODEL["lag_s"] if path in self._known), default=0.0)
        return dict.fromkeys(("dead_time.delay", "latency.delay"), late)

    def nominal(self, path: str) -> float:
        """See RigView."""
        return self._known[path]

    def _value(self, point: Sequence[Point], path: str, absent: float = 0.0) -> float:
        """A parameter at a point; of an effect that this rig cannot show its neutral value."""
        return float(self.values(point, path)[0]) if path in self._known else absent

    def _gap(self, points: Sequence[Point], i: int) -> Array:
        point = points[i : i + 1]
        numbers = np.zeros(law.COLUMNS)
        for path, at in _LAW:
            numbers[at] = self._value(point, path)
        numbers[law.PERIOD] = 1 / (2 * np.pi * self._value(point, "second_order.frequency"))
        ceiling = self._value(point, "ceiling.limit", np.inf)
        numbers[law.CEILING] = ceiling if ceiling < self._known.get("ceiling.limit", np.inf) else np.inf
        # Nobody can say from command to reading which of the two is late: the law is the same.
        delay = self._value(point, "dead_time.delay") + self._value(point, "latency.delay")
        parts = []
        for k, g in enumerate(self._grids):
            out = np.empty(len(g.t_s))
            law.follow(*self._command(k, delay), self._starts[k], numbers, g.step_s / self._each, self._each, out)
            parts.append(out)
        return np.asarray(self.measured - np.concatenate(parts)[:, None])

    def _command(self, k: int, delay_s: float) -> tuple[Array, Array]:
        """Mean of the held command over every substep, delayed: a delay acts by any part of a sample; and just before
        the substeps' ends.
        """
        key = (k, delay_s)
        if key not in self._late:
            if len(self._late) > 64 * len(self._grids):
                self._late.clear()
            g, (t, summed) = self._grids[k], self._commands[k]
            h = g.step_s / self._each
            edges = g.t_s[0] - delay_s + h * np.arange(len(g.t_s) * self._each + 1)
            held = np.diff(summed) / np.diff(t)
            last = np.clip(np.searchsorted(t, edges) - 1, 0, len(held) - 1)
            self._late[key] = np.diff(np.interp(edges, t, summed)) / h, held[last]
        return self._late[key]


def velocity_warnings(trials: Sequence[Trial]) -> list[str]:
    """Say of stages whose measured velocity is not the slope of their position."""
    slopes: dict[str, list[float]] = {}
    for trial in trials:
        measured = trial.channel("measured")
        if {"position", "velocity"} <= measured.columns.keys() and trial.stage is not None:
            x, t, v = measured["position"], measured.t_s, measured["velocity"]
            slope = (x[6:] - x[:-6]) / (t[6:] - t[:-6])
            if slope @ slope > 0:
                slopes.setdefault(trial.stage.name, []).append(float(slope @ v[3:-3] / (slope @ slope)))
    return [
        f"{stage}: the measured velocity is {np.median(found):.2g} times the slope of its position; one of the two has "
        "another unit or scale. Only the position is used here; correct `unit` in the stage.yaml"
        for stage, found in slopes.items()
        if abs(np.median(found) - 1) > SLOPE_TOLERANCE
    ]


def _stage(trials: Sequence[Trial]) -> str:
    names = {t.stage.name for t in trials if t.stage is not None and t.stage.kind == "tracking"}
    if len(names) != 1 or any(t.stage is None for t in trials):
        raise TrialError(f"one tracking stage at a time: these trials have {', '.join(sorted(names)) or 'none'}")
    return names.pop()


def _measured(stage: str, trials: Sequence[Trial]) -> str:
    """The column that follows the command."""
    columns = [t.channel("measured").columns for t in trials]
    for name in MEASURED:
        if all(name in each for each in columns):
            return name
    raise TrialError(f"{stage}: no column {' or '.join(MEASURED)} in every trial's measured channel; add it")


def _given(trials: Sequence[Trial]) -> Mapping[str, ModelValue]:
    return trials[0].stage.model if trials[0].stage is not None else {}


def _mean_command(series: Series, model: Mapping[str, ModelValue]) -> tuple[Array, Array]:
    """Stamps and the integral of what the nominal ends at under the command held between them, with room around."""
    t, c = series.t_s, _nominal_end(series["command"], model)
    room = float(t[-1] - t[0]) + 1.0
    t = np.concatenate(([t[0] - room], t, [t[-1] + room]))
    held = np.concatenate(([c[0]], c))
    return t, np.concatenate(([0.0], np.cumsum(held * np.diff(t))))


def _nominal_end(command: Array, model: Mapping[str, ModelValue]) -> Array:
    """What the nominal reaches in the end: `map`, straight on beyond its ends, or `gain` and `offset`."""
    if "map" not in model:
        gain, offset = (float(np.ravel(model.get(key, other))[0]) for key, other in (("gain", 1.0), ("offset", 0.0)))
        return np.asarray(command * gain + offset)
    at, reached = np.asarray(model["map"], dtype=float).T
    slopes = np.diff(reached) / np.diff(at)
    below, above = np.minimum(command - at[0], 0.0), np.maximum(command - at[-1], 0.0)
    return np.asarray(np.interp(command, at, reached) + slopes[0] * below + slopes[-1] * above)


def resolving_hz(series: Series, column: str) -> float:
    """The rate at which nothing of a measured column is lost but noise; at most as fast as its source."""
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
    """Seconds for which a command stood each time."""
    return np.asarray(np.diff(command.t_s[np.flatnonzero(np.diff(command["command"], prepend=np.nan))]))


def _skipped(g: Grid, late_s: float) -> float:
    """Seconds at a trial's start."""
    return min(SKIPPED * float(g.t_s[-1] - g.t_s[0]), SETTLED * late_s)


def _held(g: Grid, command: tuple[Array, Array]) -> Array:
    """Mean of the command over every sample."""
    t, summed = command
    return np.asarray((np.interp(g.t_s + g.step_s, t, summed) - np.interp(g.t_s, t, summed)) / g.step_s)


def _signals(g: Grid, u: Array, seen: Array, scale: Scales) -> dict[str, Array]:
    """What a flexible model may look at; times back in the rig's own."""
    seen = np.interp(g.t_s, g.t_s[np.isfinite(seen)], seen[np.isfinite(seen)])
    rate = np.gradient(u, g.step_s)
    moving = np.abs(rate) > 1e-9 * scale.reach / scale.step_s
    way = np.sign(rate)[np.maximum.accumulate(np.where(moving, np.arange(len(u)), 0))]  # as it moved last
    turned = np.concatenate(([0], np.flatnonzero(np.diff(way)) + 1))
    since = g.t_s - g.t_s[turned[np.searchsorted(turned, np.arange(len(u)), side="right") - 1]]
    signals = {"command": u, "command rate": rate, "error": u - seen, "time since reversal": since}
    if "effort" in g.columns:
        signals["effort"] = np.nan_to_num(g.columns["effort"])
    for name, times in (("a little", 1), ("some time", 3)):
        back = min(max(1, round(times * scale.late_s / g.step_s)), len(u) - 1)
        signals[f"command {name} before"] = np.concatenate((np.full(back, u[0]), u[:-back]))
    return signals
