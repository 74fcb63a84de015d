"""View of a chain of links, free or driven, on a base that is fixed or moves."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from softarm.diagnosis.answer.evidence import rms
from softarm.diagnosis.data.trials import Series, Trial, stage_of
from softarm.diagnosis.engine.view import Array, Point
from softarm.diagnosis.engine.whitened import slices
from softarm.diagnosis.rigs.chain.effects import (
    INERTIA_SHARE,
    MASS_SHARE,
    ChainScales,
    chain_effects,
    of_joints,
    tolerances,
)
from softarm.diagnosis.rigs.chain.model import Chain, absolute, chain_of, joints, measured, periods_seen
from softarm.diagnosis.rigs.chain.shooting import Law, Shooting
from softarm.diagnosis.rigs.grid import Grid, grid, resolution, windows
from softarm.diagnosis.rigs.laws import chain as law
from softarm.diagnosis.rigs.views import RigView, given_values, neutral_values

# Samples and integration steps per period of the fastest swing.
SAMPLES_PER_PERIOD, STEPS_PER_PERIOD = 75, 60
RATE_LEAST_HZ, RATE_MOST_HZ = 10.0, 200.0
# Length of a window in periods of the slowest swing, for a single free link and for any other chain. Over longer
# windows an inexact model loses its phase, and an unstable chain forgets its start.
WINDOW_PERIODS_FREE, WINDOW_PERIODS = 4.0, 1.0
# Torque and base motion that are kept before and after a window, in periods.
MARGIN_PERIODS = 0.5
# Data from which a start is guessed, in periods and at least in samples; a cubic may leave so many noise floors of it.
GUESS_PERIODS = 0.2
GUESS_SAMPLES, GUESS_FLOORS = 5, 2.0
# A window is unstable if the edge of a tolerance moves it by this share of its swing and by this many noise floors.
UNSTABLE_SHARE, UNSTABLE_FLOORS = 0.3, 20.0
# A window in which an error of its start grows by more than this factor is halved. Errors grow 1.0 to 3.1 times in a
# swing below the horizontal, and up to 240 times over the top.
GROWTH_MOST = 4.0
# Share of a joint's usual rate below which it counts as at rest.
STILL_SHARE = 0.04
# Uncertainty of a guessed start, as shares of the usual angle and rate.
ANGLE_SHARE, RATE_SHARE = 0.1, 0.15
# A row of the torque is missing if the next one comes after this many usual steps.
LOST_STEPS = 1.5
# Effects whose tolerances are tried for unstable windows; a constant effect would move a link at rest as much.
_TRIED = ("stiffness", "inertia", "gain")
# Processor time of a search per rollout, step and link, s.
LINK_COST_S = 0.6e-6
_Side = Literal["before", "after"]
# Largest turn of a held joint's spring in one step, rad.
RESOLVED = 1.0


class ChainView(RigView):
    """View of the measured angles of all links; each trial is one window."""

    fits_starts = True
    restarts_few_effects = True

    def __init__(self, trials: Sequence[Trial]) -> None:
        """Prepare the windows of one chain; raise TrialError if its model has the wrong number of values."""
        stage = stage_of(trials)
        self._chain = chain = chain_of(stage)
        self.step_cost_s = LINK_COST_S * chain.n
        names = tuple(f"angle{i}" for i in range(1, chain.n + 1))
        fastest, _ = _periods(chain, trials)
        self._fastest_s = fastest
        rate_hz = min(max(SAMPLES_PER_PERIOD / fastest, RATE_LEAST_HZ), RATE_MOST_HZ)
        grids = [grid(t.channel("measured"), rate_hz) for t in trials]
        shown = [measured(chain, _joined(g.columns, "angle", chain.n)) for g in grids]
        raw = [measured(chain, _joined(t.channel("measured").columns, "angle", chain.n)) for t in trials]
        joints_own = [resolution([np.round(each[:, i], 9) for each in raw]) for i in range(chain.n)]
        step = min((each for each in joints_own if each > 0), default=0.0)
        self._step_s = float(np.median([g.step_s for g in grids]))
        self._each = max(1, int(np.ceil(self._step_s / (fastest / STEPS_PER_PERIOD))))
        self._trials, self._grids = trials, grids
        self._pushes = [_push(t, g, self._each) for t, g in zip(trials, grids, strict=True)]
        self.scales = self._measure(shown)
        found = chain_effects(stage.name, chain, self.scales)
        torques = [self._torque(k, 0.0)[:: self._each] for k in range(len(trials))]
        every = zip(shown, grids, self._pushes, torques, strict=True)
        signals = [_signals(chain, seen, g, push[:: self._each], torque) for seen, g, push, torque in every]
        super().__init__(stage.name, "rad", names, found, [g.t_s for g in grids], shown, step, signals)
        self.floor = np.maximum(self.floor, _noise(shown))
        self._known = neutral_values(found)
        self._known |= {f"damping.{name}": 0.0 for name in of_joints("scale", chain.n)}
        for i, name in enumerate(of_joints("torque", chain.n)):
            self._known[f"coulomb_friction.{name}"] = float(chain.dry[i])
        for i, name in enumerate(of_joints("viscous", chain.n)):
            self._known[f"damping.{name}"] = float(chain.viscous[i])
        self._known |= given_values(stage, found)
        self._delayed = lru_cache(64)(self._torques)
        self._shooting = self._begin(shown)
        self._lost = self._without_lost()
        self._unstable = self._without_unstable()

    @classmethod
    def windows(cls, trial: Trial) -> tuple[Trial, ...]:
        """Cut a trial into windows of a few swings, each with a margin of torque and base motion."""
        chain = chain_of(stage_of([trial]))
        _, slowest = _periods(chain, [trial])
        free = chain.n == 1 and "torque" not in trial.channels
        return _cut(trial, (WINDOW_PERIODS_FREE if free else WINDOW_PERIODS) * slowest, MARGIN_PERIODS * slowest)

    def warnings(self, point: Point) -> tuple[str, ...]:
        """Return warnings about windows that are left out."""
        reasons = {
            "rows are missing where the torque changes, which moves the swing; log every row": self._lost,
            "small errors of the model change the swing by much; drive it with less torque": self._unstable,
        }
        return tuple(
            f"{self.stage}: {len(out)} of {len(self._trials)} windows are left out (the first: "
            f"{self._trials[out[0]].name}): {reason}"
            for reason, out in reasons.items()
            if out
        )

    def _without_lost(self) -> tuple[int, ...]:
        """Take out windows in which a missing torque changes the swing, and return their indices.

        The torque of the row before and of the row after are compared: at a jump the swing differs by hundreds of noise
        floors, otherwise by a few.
        """
        before, after = self._torques(0.0, "before"), self._torques(0.0, "after")
        if np.array_equal(before, after):
            return ()
        held, given = (self._shooting.residuals([self._law({})], torque)[0] for torque in (before, after))
        kept = self._shooting.kept
        moved = [rms((g - h)[keep] / self.floor) for g, h, keep in zip(given, held, kept, strict=True)]
        return self._left_out([k for k, floors in enumerate(moved) if floors > UNSTABLE_FLOORS])

    def _left_out(self, windows: Sequence[int]) -> tuple[int, ...]:
        """Take windows out and return them, or keep all if they are the majority."""
        if len(windows) > len(self._trials) // 2:
            return ()
        for k in windows:
            self.measured[self.trial == k] = np.nan
        return tuple(windows)

    def _without_unstable(self) -> tuple[int, ...]:
        """Take out windows in which even a good model is wrong by a part of the usual swing; return their indices.

        A link that goes over the top amplifies small errors, and one such window would outweigh all others.
        """
        widths = {path: x for path, x in self.tolerances.items() if path.startswith(_TRIED)}
        points = [{}, *({f"{self.stage}.{path}": self._known[path] + x} for path, x in widths.items())]
        found = self.gap(points)
        off = np.concatenate((found[1:] - found[0], self.own_directions()))
        swung = (self.measured - np.nanmedian(self.measured, axis=0)) ** 2
        parts = {k: mine for k, mine in enumerate(slices(self.trial)) if k not in self._lost}
        swing = np.sqrt(np.nanmedian([np.nanmean(swung[mine]) for mine in parts.values()]))
        unstable = []
        for k, mine in parts.items():
            moved = np.sqrt(np.nanmean(off[:, mine] ** 2, axis=(1, 2)))
            if moved.max() > max(UNSTABLE_SHARE * swing, UNSTABLE_FLOORS * float(self.floor.mean())):
                unstable.append(k)
        return self._left_out(unstable)

    @property
    def growth(self) -> Array:
        """Factor by which an error of an angle at a window's start grows at most within the window, [W]."""
        return self._shooting.growth(self._law({}), self._delayed(0.0))

    @property
    def growing(self) -> frozenset[int]:
        """Windows in which small errors grow too much."""
        return frozenset(np.flatnonzero(self.growth > GROWTH_MOST).tolist())

    def halves(self, number: int, times: int) -> tuple[Trial, ...]:
        """Return a window cut into halves, the margins around them shorter each time."""
        trial = self._trials[number]
        t = trial.channels["measured"].t_s
        _, slowest = _periods(self._chain, self._trials)
        return _cut(trial, float(t[-1] - t[0]) / 2, MARGIN_PERIODS * slowest / 2**times)

    @property
    def tolerances(self) -> Mapping[str, float]:
        """Errors that a good nominal model may have, by 'effect.parameter'."""
        return {
            f"{name}{place}": float(width)
            for name, widths in tolerances(self._chain, self.scales).items()
            for place, width in zip(of_joints("", len(widths)), widths, strict=True)
        }

    @property
    def model_uncertainty(self) -> Mapping[str, float]:
        """Uncertainty of a delay, and of a weight that only shows next to the inertia.

        Motors may hold a torque until the next one; the law has it change in between.
        """
        found = {"dead_time.delay": 0.5 * self.scales.sample_s}
        return found if "inertia.scale" in self.tolerances else found | {"stiffness.scale": MASS_SHARE}

    @property
    def regimes(self) -> Mapping[str, NDArray[np.bool_]]:
        """Parts of the data by the size of the swing and the place within it."""
        size = self.features["swing of the trial"]
        return {
            "swings above 1 rad": size > 1.0,
            "swings of 0.3 to 1 rad": (size > 0.3) & (size <= 1.0),
            "swings below 0.3 rad": size <= 0.3,
            "near a reversal": np.abs(self.features["rate 1"]) < 0.2 * np.max(np.abs(self.features["rate 1"])),
            "at the bottom": np.abs(self.features["angle 1"]) < 0.2 * size,
        }

    @property
    def own_nuisances(self) -> Mapping[str, float]:
        """Mass and inertia of each link, if there are several: name -> share of its value."""
        if self._chain.n == 1:
            return {}
        shares = {"mass": MASS_SHARE, "inertia": INERTIA_SHARE}
        return {f"{self.stage}.{of}{i + 1}": share for of, share in shares.items() for i in range(self._chain.n)}

    def own_directions(self) -> NDArray[np.float32]:
        """Return how the gap changes with each link's mass and inertia, [q, M, S]."""
        if self._chain.n == 1:
            return super().own_directions()
        each = np.eye(self._chain.n)
        chains = [self._chain, *(self._chain.reweighed(MASS_SHARE * one, 0 * one) for one in each)]
        chains += [self._chain.reweighed(0 * one, INERTIA_SHARE * one) for one in each]
        left = self._shooting.residuals([self._law({}, chain) for chain in chains], self._delayed(0.0))
        found = left[:, self._shooting.kept].astype(np.float32)
        found[:, ~np.isfinite(self.measured)] = np.nan
        return np.asarray(found[1:] - found[0])

    def gap(self, points: Sequence[Point]) -> NDArray[np.float32]:
        """Return measured minus predicted angles at each of P points, [P, M, S]; NaN where none was measured."""
        found = np.empty((len(points), *self.measured.shape), np.float32)
        delays = np.array([self.value(point, "dead_time.delay") for point in points])
        for delay in np.unique(delays):
            mine = np.flatnonzero(delays == delay)
            left = self._shooting.residuals([self._law(points[int(i)]) for i in mine], self._delayed(float(delay)))
            found[mine] = left[:, self._shooting.kept]
        found[:, ~np.isfinite(self.measured)] = np.nan
        return found

    def _values(self, point: Point, path: str) -> Array:
        """Values of a parameter that each joint has, [n]."""
        return np.array([self.value(point, name) for name in of_joints(path, self._chain.n)])

    def _law(self, point: Point, base: Chain | None = None) -> Law:
        base, n = base or self._chain, self._chain.n
        chain = base.loaded(self.value(point, "payload.mass"))
        rows = chain.rows()
        table, rest = rows[: law.EACH * n].reshape(law.EACH, n), rows[law.EACH * n :]
        table[law.INERTIA] += self.value(point, "inertia.scale") * base.own
        table[law.DRY] = self._values(point, "coulomb_friction.torque")
        share, viscous = self._values(point, "damping.scale"), self._values(point, "damping.viscous")
        table[law.VISCOUS] = (1 + share) * viscous
        # The friction's spring must not be stiffer than a step resolves.
        least = table[law.DRY] * (self._step_s / self._each / RESOLVED) ** 2 / base.joint_inertia
        table[law.GIVE] = np.maximum(self.value(point, "coulomb_friction.give") or 1.0, least)
        gravity, tilt = chain.gravity * (1 + self.value(point, "stiffness.scale")), self.value(point, "tilt.angle")
        rest[law.DOWN], rest[law.ALONG] = gravity * np.cos(tilt), -gravity * np.sin(tilt)
        rest[law.CUBIC] = self.value(point, "stiffening.cubic")
        rest[law.DRAG] = self.value(point, "drag.coefficient")
        table[law.GAIN] = 1 + self._values(point, "gain.scale")
        table[law.OFFSET] = self._values(point, "torque_offset.torque")
        return Law(rows, self._values(point, "sensor_bias.bias"))

    def _torques(self, delay_s: float, lost: _Side | None = None) -> Array:
        """Delayed torques of all windows at every step, [W, K, n]; missing rows take the values of side `lost`."""
        return self._stacked([self._torque(k, delay_s, lost) for k in range(len(self._grids))])

    def _stacked(self, parts: Sequence[Array]) -> Array:
        """Stack values at every step of each window, [W, K, ...]; shorter windows repeat their last row."""
        steps = max(len(g.t_s) for g in self._grids) * self._each
        return np.stack([np.concatenate((x, np.repeat(x[-1:], steps - len(x), axis=0))) for x in parts])

    def _torque(self, k: int, delay_s: float, lost: _Side | None = None) -> Array:
        """Means of a window's torques over every step, [T each, n]; missing rows take the values of side `lost`."""
        g, n = self._grids[k], self._chain.n
        edges = g.t_s[0] - delay_s + self._step_s / self._each * np.arange(len(g.t_s) * self._each + 1)
        if "torque" not in self._trials[k].channels:
            return np.zeros((len(edges) - 1, n))
        series = self._trials[k].channels["torque"]
        if lost is not None:
            series = _one_sided(series, lost)
        names = [f"torque{i}" for i in range(1, n + 1)]
        found = [_means(series, c, edges) if c in series.columns else np.zeros(len(edges) - 1) for c in names]
        return np.stack(found, axis=1)

    def _measure(self, shown: Sequence[Array]) -> ChainScales:
        chain, driven = self._chain, any("torque" in t.channels for t in self._trials)
        torque = np.concatenate([self._torque(k, 0.0) for k in range(len(self._trials))])
        turned = np.concatenate([joints(absolute(chain, s)) for s in shown])
        rates = np.concatenate([_rates(chain, s, g) for s, g in zip(shown, self._grids, strict=True)])
        sample = [float(np.median(np.diff(t.channels["torque"].t_s))) for t in self._trials if "torque" in t.channels]
        return ChainScales(
            torque_nm=np.sqrt(np.mean(torque**2, axis=0)),
            top_nm=np.max(np.abs(torque), axis=0),
            reach_rad=max(float(np.nanmax(np.abs(absolute(chain, s)))) for s in shown),
            swing_rad=np.nanstd(turned, axis=0),
            rate_rad_s=np.sqrt(np.nanmean(joints(rates) ** 2, axis=0)),
            period_s=_periods(chain, self._trials)[1],
            sample_s=min(sample, default=0.0),
            driven=driven,
            carried=any("base" in t.channels for t in self._trials),
        )

    def _begin(self, shown: Sequence[Array]) -> Shooting:
        chain, floor = self._chain, float(self.floor.mean())
        push = self._stacked(self._pushes)
        guess, misfit = (np.stack(each) for each in zip(*map(self._guess, range(len(shown)), shown), strict=True))
        rates = joints(guess[:, chain.n :])
        moving = np.where(np.abs(rates) > STILL_SHARE * self.scales.rate_rad_s, np.sign(rates), 0.0)
        off = 3 * (floor + misfit)
        angle = np.cumsum(ANGLE_SHARE * self.scales.swing_rad + off, axis=1)
        rate = np.cumsum(RATE_SHARE * self.scales.rate_rad_s + off / (GUESS_PERIODS * self.scales.period_s), axis=1)
        sigma = np.concatenate((angle, rate), axis=1)
        step_s, each = self._step_s, self._each
        return Shooting(chain, shown, push, guess, sigma, moving, step_s=step_s, each=each, weight=floor**2)

    def _guess(self, k: int, seen: Array) -> tuple[Array, Array]:
        """Absolute angles and rates at a window's start [2 n], and the RMS residual of the fitted cubics [n].

        A motor may move a link faster than its weight, so fewer samples are used while the residual is large.
        """
        columns, chain, rates = self._grids[k].columns, self._chain, None
        if all(f"rate{i + 1}" in columns for i in range(chain.n)):
            rates = measured(chain, _joined(columns, "rate", chain.n))
        first = min(len(seen), max(8, round(GUESS_PERIODS * self._fastest_s / self._step_s)))
        parts = []
        for i in range(chain.n):
            size, speeds = first, None if rates is None else rates[:, i]
            part = _cubic(seen[:, i], speeds, size, self._step_s)
            while part[2] > GUESS_FLOORS * self.floor[i] and size > GUESS_SAMPLES:
                size = max(GUESS_SAMPLES, size // 2)
                part = _cubic(seen[:, i], speeds, size, self._step_s)
            parts.append(part)
        found = np.array(parts)
        return absolute(chain, found[:, :2].T).ravel(), found[:, 2]


def _joined(columns: Mapping[str, Array], name: str, n: int) -> Array:
    """Columns of n joints side by side, [T, n]."""
    return np.stack([columns[f"{name}{i}"] for i in range(1, n + 1)], axis=1)


def _cubic(seen: Array, rates: Array | None, size: int, step_s: float) -> tuple[float, float, float]:
    """Value and rate at the start of a cubic fitted to the first samples, and its RMS residual."""
    late = np.arange(size) / size
    powers = late[:, None] ** np.arange(4)
    rows, goals = [powers], [seen[:size]]
    if rates is not None:
        rows.append(np.arange(4) * late[:, None] ** np.maximum(np.arange(4) - 1, 0))
        goals.append(rates[:size] * step_s * size)
    basis, goal = np.concatenate(rows), np.concatenate(goals)
    good = np.isfinite(goal)
    if good.sum() < 4:
        return 0.0, 0.0, 0.0
    fit, *_ = np.linalg.lstsq(basis[good], goal[good], rcond=None)
    left = np.nan_to_num(seen[:size] - powers @ fit)
    return float(fit[0]), float(fit[1]) / (step_s * size), float(np.sqrt(np.mean(left**2)))


def _periods(chain: Chain, trials: Sequence[Trial]) -> tuple[float, float]:
    """Periods of the fastest and the slowest swing, s: by the model, or from the data without gravity."""
    if len(own := chain.periods_s):
        return float(own[-1]), float(own[0])
    found = []
    for trial in trials:
        g = grid(trial.channel("measured"), RATE_MOST_HZ)
        seen = _joined(g.columns, "angle", chain.n)
        found.append(periods_seen(seen, np.gradient(np.nan_to_num(seen), g.step_s, axis=0)))
    usual = float(np.median(found))
    return usual, usual


def _cut(trial: Trial, seconds: float, margin_s: float) -> tuple[Trial, ...]:
    """Cut a trial into windows of about a length, with the torque and base motion of a margin around each."""
    found = []
    for part in windows(trial, seconds):
        seen = part.channels["measured"]
        low, high = seen.t_s[0] - margin_s, seen.t_s[-1] + margin_s
        around = {name: s.kept((s.t_s >= low) & (s.t_s <= high)) for name, s in trial.channels.items()}
        found.append(replace(part, channels={**around, "measured": seen}))
    return tuple(found)


def _one_sided(series: Series, side: _Side) -> Series:
    """Fill gaps of a channel with the value before or after each gap."""
    t, apart = series.t_s, np.diff(series.t_s)
    lost = np.flatnonzero(apart > LOST_STEPS * np.median(apart))
    near = 1e-6 * float(np.median(apart))
    at, row = (t[lost + 1] - near, lost) if side == "before" else (t[lost] + near, lost + 1)
    return Series(np.insert(t, lost + 1, at), {c: np.insert(x, lost + 1, x[row]) for c, x in series.columns.items()})


def _means(series: Series, column: str, edges: Array) -> Array:
    """Means of a column between edges; beyond its ends the column keeps its first or last value."""
    t, x = series.t_s, series[column]
    summed = np.concatenate(([0.0], np.cumsum(0.5 * (x[1:] + x[:-1]) * np.diff(t))))
    far = max(edges[-1] - t[-1], t[0] - edges[0], 0.0) + 1.0
    t = np.concatenate(([t[0] - far], t, [t[-1] + far]))
    summed = np.concatenate(([-far * x[0]], summed, [summed[-1] + far * x[-1]]))
    return np.asarray(np.diff(np.interp(edges, t, summed)) / np.diff(edges))


def _noise(shown: Sequence[Array]) -> Array:
    """RMS of the white noise in the angles [S], from fourth differences, in which a swing vanishes."""
    fourth = np.concatenate([np.diff(s, 4, axis=0) for s in shown])
    return np.asarray(1.4826 * np.nanmedian(np.abs(fourth), axis=0) / np.sqrt(70))


def _push(trial: Trial, g: Grid, each: int) -> Array:
    """Acceleration of the base at every step, m/s^2; zero for a fixed base."""
    steps = len(g.t_s) * each
    if "base" not in trial.channels:
        return np.zeros(steps)
    h, pad = g.step_s / each, 8
    edges = g.t_s[0] + h * np.arange(-pad, steps + pad + 1)
    position = _means(trial.channels["base"], "position", edges)
    found = savgol_filter(position, 7, 4, deriv=2, delta=h)
    return np.asarray(found[pad : pad + steps])


def _rates(chain: Chain, seen: Array, g: Grid) -> Array:
    """Absolute rates from differences, [T, n]."""
    return absolute(chain, np.gradient(np.nan_to_num(seen), g.step_s, axis=0))


def _signals(chain: Chain, seen: Array, g: Grid, push: Array, torque: Array) -> dict[str, Array]:
    """Features for a flexible model of the residual."""
    signals = {"base acceleration": push}
    clean, rates = np.nan_to_num(seen), joints(_rates(chain, seen, g))
    for i in range(seen.shape[1]):
        signals[f"angle {i + 1}"] = clean[:, i]
        signals[f"rate {i + 1}"] = rates[:, i]
        signals[f"torque {i + 1}"] = torque[:, i]
    signals["swing of the trial"] = np.full(len(seen), float(np.max(np.abs(clean[:, -1]))))
    return signals
