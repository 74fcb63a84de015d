"""What follows a command: a servo, a regulator, an axis in velocity mode. The nominal follows at once and exactly."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.data.trials import Series, Trial, TrialError
from softarm.diagnosis.engine.view import Array, Point
from softarm.diagnosis.rigs import kernels
from softarm.diagnosis.rigs.grid import Grid, grid, smallest_step
from softarm.diagnosis.rigs.views import RigView
from softarm.diagnosis.rigs.vocabulary import effects
from softarm.schemas.stage_model import ModelValue

# What is measured -> its unit; the first that a table has is what follows the command.
MEASURED = {"position": "rad", "pressure": "kPa", "velocity": "m/s", "value": "-"}
SUBSTEP_S = 0.0105
SKIPPED_S = 0.5  # at the start, where what went before still shows
SLOPE_TOLERANCE = 0.3  # a velocity further from its position's slope than this share is in another unit
_NUMBERS = (
    ("gain.scale", kernels.SCALE),
    ("gain.offset", kernels.OFFSET),
    ("deadband.width", kernels.WIDTH),
    ("lag.time", kernels.LAG),
    ("rate_limit.rate", kernels.RATE),
    ("acceleration_limit.acceleration", kernels.ACCELERATION),
    ("backlash.gap", kernels.GAP),
)
_MODEL = {"lag_s": "lag.time", "delay_s": "dead_time.delay"}  # of a stage.yaml's model


class TrackingView(RigView):
    """Command to what is measured of the follower, all trials of one stage."""

    def __init__(self, trials: Sequence[Trial], unit: str | None = None) -> None:
        """Raises TrialError for trials of no tracking stage. unit: of what is measured, if it is not the usual one."""
        stage = _stage(trials)
        column = next((c for c in MEASURED if all(c in t.channel("measured").columns for t in trials)), None)
        if column is None:
            raise TrialError(f"{stage}: no column {' or '.join(MEASURED)} in every trial's measured channel; add it")
        told = trials[0].stage.unit("measured", column) if trials[0].stage is not None else ""
        unit = unit or told or MEASURED[column]
        grids = [grid(t.channel("measured")) for t in trials]
        commands = [_mean_command(t.channel("command")) for t in trials]
        shown = [np.where(g.t_s - g.t_s[0] < SKIPPED_S, np.nan, g.columns[column])[:, None] for g in grids]
        step = smallest_step([t.channel("measured")[column] for t in trials])
        signals = [_signals(g, c, column) for g, c in zip(grids, commands, strict=True)]
        found = effects("tracking", stage, unit)
        super().__init__(stage, unit, (column,), found, [g.t_s for g in grids], shown, step, signals)
        self._model = {_MODEL[k]: float(np.ravel(v)[0]) for k, v in _given(trials).items() if k in _MODEL}
        self._grids, self._commands = grids, commands
        self._starts = [float(g.columns[column][np.isfinite(g.columns[column])][:3].mean()) for g in grids]
        self._late: dict[tuple[int, float], Array] = {}

    @property
    def regimes(self) -> Mapping[str, NDArray[np.bool_]]:
        """See View."""
        rate, error = self.features["command rate"], self.features["error"]
        fast = np.quantile(np.abs(rate), 0.9)
        still = np.abs(rate) < 0.02 * max(fast, 1e-12)
        return {
            "command standing": still,
            "command moving slowly": ~still & (np.abs(rate) < 0.3 * fast),
            "command moving fast": np.abs(rate) >= 0.3 * fast,
            "command rising": rate > 0.02 * fast,
            "command falling": rate < -0.02 * fast,
            "behind from below": error > 0,
            "after a reversal": self.features["time since reversal"] < 0.2,
        }

    def nominal(self, path: str) -> float:
        """See RigView."""
        known = {f"{e.name.rpartition('.')[2]}.{n.name}": n.neutral for e in self.effects for n in e.parameters}
        return self._model.get(path, known[path])

    def _gap(self, points: Sequence[Point], i: int) -> Array:
        point = points[i : i + 1]
        law = np.array([self.values(point, path)[0] for path, _ in _NUMBERS])
        delay = float(self.values(point, "dead_time.delay")[0])
        parts = []
        for k, g in enumerate(self._grids):
            each = max(1, int(np.ceil(g.step_s / SUBSTEP_S)))
            out = np.empty(len(g.t_s))
            start = self._starts[k]
            kernels.follow(self._command(k, delay, each), start, law, g.step_s / each, each, out)
            parts.append(out)
        return np.asarray(self.measured - np.concatenate(parts)[:, None])

    def _command(self, k: int, delay_s: float, each: int) -> Array:
        """The held command at the middle of every substep, delayed; the mean of one hold about it.

        So a delay acts by any part of a sample, where the bare staircase would be blind to all but whole ones.
        """
        key = (k, delay_s)
        if key not in self._late:
            if len(self._late) > 64 * len(self._grids):
                self._late.clear()
            g, (t, summed) = self._grids[k], self._commands[k]
            h, half = g.step_s / each, 0.5 * float(np.median(np.diff(t)))
            middle = g.t_s[0] - delay_s + h * (np.arange(len(g.t_s) * each) + 0.5)
            self._late[key] = (np.interp(middle + half, t, summed) - np.interp(middle - half, t, summed)) / (2 * half)
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


def _given(trials: Sequence[Trial]) -> Mapping[str, ModelValue]:
    return trials[0].stage.model if trials[0].stage is not None else {}


def _mean_command(series: Series) -> tuple[Array, Array]:
    """Stamps and the integral of the command held between them, with room before and after."""
    t, c = series.t_s, series["command"]
    t = np.concatenate(([t[0] - 10.0], t, [t[-1] + 10.0]))
    held = np.concatenate(([c[0]], c))
    return t, np.concatenate(([0.0], np.cumsum(held * np.diff(t))))


def _signals(g: Grid, command: tuple[Array, Array], column: str) -> dict[str, Array]:
    """What a flexible model may look at."""
    t, summed = command
    held = np.interp(g.t_s + g.step_s, t, summed) - np.interp(g.t_s, t, summed)
    u = held / g.step_s
    seen = g.columns[column]
    seen = np.interp(g.t_s, g.t_s[np.isfinite(seen)], seen[np.isfinite(seen)])
    rate = np.gradient(u, g.step_s)
    turned = np.concatenate(([0], np.flatnonzero(np.diff(np.sign(rate))) + 1))
    since = g.t_s - g.t_s[turned[np.searchsorted(turned, np.arange(len(u)), side="right") - 1]]
    signals = {"command": u, "command rate": rate, "error": u - seen, "time since reversal": since}
    for name in ("effort",):
        if name in g.columns:
            signals[name] = np.nan_to_num(g.columns[name])
    for back_s in (0.1, 0.3):
        back = max(1, round(back_s / g.step_s))
        signals[f"command {back_s:g} s before"] = np.concatenate((np.full(back, u[0]), u[:-back]))
    return signals
