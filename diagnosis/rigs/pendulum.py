"""A chain of pendulums, on a base that stands still or moves. Where a trial starts is fitted at every point."""

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from softarm.diagnosis.data.trials import TableStage, Trial, TrialError
from softarm.diagnosis.engine.view import Array, Point
from softarm.diagnosis.rigs import kernels
from softarm.diagnosis.rigs.grid import Grid, grid, smallest_step, windows
from softarm.diagnosis.rigs.views import RigView
from softarm.diagnosis.rigs.vocabulary import effects

RATE_HZ = 100.0  # ten times the fastest swing of a laboratory's pendulum
SUBSTEP_S = 0.0105
WINDOW_S = 3.0  # trials are cut to this: over longer ones an inexact model dephases, and what is lost tells nothing
ROUNDS_FIRST, ROUNDS = 6, 2
ANGLE_SIGMA_RAD, RATE_SIGMA_RAD_S = 0.05, 0.5  # how well a start is known before it is fitted
STILL_RAD_S = 0.02
_NEEDED = ("mass_kg", "centre_m", "inertia_kg_m2")
_LAW = (
    ("stiffening.cubic", kernels.CUBIC),
    ("coulomb_friction.torque", kernels.TORQUE),
    ("coulomb_friction.give", kernels.GIVE),
    ("drag.coefficient", kernels.DRAG),
)


class PendulumView(RigView):
    """Angles of all links, absolute, zero hanging down. A trial is one shot: cut long ones with `grid.windows`."""

    fits_starts = True

    def __init__(self, trials: Sequence[Trial]) -> None:
        """Raises TrialError for trials of no pendulum, or of a model that lacks what a pendulum needs."""
        stage = _stage(trials)
        self._link = links(stage)
        n = self._link.shape[1]
        names = tuple(f"angle{i}" for i in range(1, n + 1))
        grids = [grid(t.channel("measured"), RATE_HZ) for t in trials]
        shown = [np.stack([g.columns[name] for name in names], axis=1) for g in grids]
        step = smallest_step([t.channel("measured")[name] for t in trials for name in names])
        pushes = [_push(t, g) for t, g in zip(trials, grids, strict=True)]
        signals = [_signals(seen, g, push) for seen, g, push in zip(shown, grids, pushes, strict=True)]
        self._gravity = float(np.ravel(stage.model.get("gravity_m_s2", 9.81))[0])
        found = effects("pendulum", stage.name, "rad", moment_nm=self._gravity * float(self._link[0].sum()))
        super().__init__(stage.name, "rad", names, found, [g.t_s for g in grids], shown, step, signals)
        self._grids, self._seen, self._pushes = grids, [np.nan_to_num(s) for s in shown], pushes
        self._known = {f"{e.name.rpartition('.')[2]}.{m.name}": m.neutral for e in found for m in e.parameters}
        self._known["damping.scale"] = 0.0  # the model's own

    @classmethod
    def shots(cls, trial: Trial) -> tuple[Trial, ...]:
        """See RigView."""
        return windows(trial, WINDOW_S)

    @property
    def regimes(self) -> Mapping[str, NDArray[np.bool_]]:
        """See View."""
        size = self.features["swing of the trial"]
        return {
            "swings above 1 rad": size > 1.0,
            "swings of 0.3 to 1 rad": (size > 0.3) & (size <= 1.0),
            "swings below 0.3 rad": size <= 0.3,
            "near a reversal": np.abs(self.features["rate 1"]) < 0.2 * np.max(np.abs(self.features["rate 1"])),
            "at the bottom": np.abs(self.features["angle 1"]) < 0.2 * size,
        }

    def nominal(self, path: str) -> float:
        """See RigView."""
        return self._known[path]

    def _law(self, point: Sequence[Point]) -> Array:
        law = np.zeros(6)
        for path, column in _LAW:
            law[column] = self.values(point, path)[0]
        law[kernels.GRAVITY] = self._gravity * (1 + self.values(point, "stiffness.scale")[0])
        law[kernels.DAMPING] = 1 + self.values(point, "damping.scale")[0]
        return law

    @cached_property
    def _starts(self) -> list[tuple[Array, Array]]:
        """Of every trial: where the nominal model starts at best, and which way each joint turns there."""
        found = []
        for k, (seen, g) in enumerate(zip(self._seen, self._grids, strict=True)):
            first = min(len(seen), 15)
            fit = np.polynomial.polynomial.polyfit(g.t_s[:first] - g.t_s[0], seen[:first], 3)
            start = np.concatenate((fit[0], fit[1]))
            joints = np.diff(fit[1], prepend=0.0)
            moving = np.where(np.abs(joints) > STILL_RAD_S, np.sign(joints), 0.0)
            out = np.empty_like(seen)
            self._shoot(k, start, moving, self._law([{}]), 0.0, ROUNDS_FIRST, out)
            found.append((start, moving))
        return found

    def _shoot(self, k: int, start: Array, moving: Array, law: Array, bias: float, rounds: int, out: Array) -> None:
        g, n = self._grids[k], self._link.shape[1]
        each = max(1, int(np.ceil(g.step_s / SUBSTEP_S)))
        sigma = np.repeat((ANGLE_SIGMA_RAD, RATE_SIGMA_RAD_S), n)
        kernels.shot(
            self._seen[k],
            start,
            moving,
            self._pushes[k],
            self._link,
            law,
            bias,
            g.step_s,
            each,
            rounds,
            (float(self.floor.mean()) / sigma) ** 2,
            out,
        )

    def _gap(self, points: Sequence[Point], i: int) -> Array:
        point = points[i : i + 1]
        law, bias = self._law(point), float(self.values(point, "sensor_bias.bias")[0])
        parts = []
        for k, (start, moving) in enumerate(self._starts):
            out = np.empty_like(self._seen[k])
            self._shoot(k, start.copy(), moving, law, bias, ROUNDS, out)
            parts.append(out)
        return np.where(np.isfinite(self.measured), np.concatenate(parts), np.nan)


def links(stage: TableStage) -> Array:
    """[5, n] rows of `kernels.accelerations` from a stage's model. Raises TrialError for what it lacks."""
    lacking = [name for name in _NEEDED if name not in stage.model]
    if lacking:
        raise TrialError(f"{stage.name}: model lacks {', '.join(lacking)}; a pendulum needs {', '.join(_NEEDED)}")
    mass, centre, inertia = (np.ravel(np.asarray(stage.model[name], dtype=float)) for name in _NEEDED)
    n = len(mass)
    length = np.zeros(n)
    given = np.ravel(np.asarray(stage.model.get("length_m", ()), dtype=float))
    if len(given) < n - 1:
        raise TrialError(f"{stage.name}: model.length_m has {len(given)} numbers, {n} links need {n - 1}; add them")
    length[: min(n, len(given))] = given[:n]
    damping = np.ravel(np.asarray(stage.model.get("damping_nm_s_rad", 0.0), dtype=float))
    beyond = np.concatenate((np.cumsum(mass[::-1])[::-1][1:], [0.0]))  # mass that hangs from each link
    return np.stack(
        (
            mass * centre + length * beyond,
            inertia + mass * centre**2 + length**2 * beyond,
            length,
            centre,
            np.broadcast_to(damping, n),
        )
    )


def _stage(trials: Sequence[Trial]) -> TableStage:
    stages = {t.stage.name: t.stage for t in trials if t.stage is not None and t.stage.kind == "pendulum"}
    if len(stages) != 1:
        raise TrialError(f"one pendulum at a time: these trials have {', '.join(sorted(stages)) or 'none'}")
    return stages.popitem()[1]


def _push(trial: Trial, g: Grid) -> Array:
    """Acceleration of the base, m/s^2 at every step; zero for one that stands still."""
    if "base" not in trial.channels:
        return np.zeros(len(g.t_s))
    base = trial.channels["base"]
    way = np.interp(g.t_s, base.t_s, base["position"])
    return np.asarray(savgol_filter(way, 11, 4, deriv=2, delta=g.step_s))


def _signals(seen: Array, g: Grid, push: Array) -> dict[str, Array]:
    """What a flexible model may look at."""
    signals = {"base acceleration": push}
    clean = np.nan_to_num(seen)
    for i in range(seen.shape[1]):
        signals[f"angle {i + 1}"] = clean[:, i]
        signals[f"rate {i + 1}"] = np.gradient(clean[:, i], g.step_s)
    signals["swing of the trial"] = np.full(len(seen), float(np.max(np.abs(clean[:, -1]))))
    return signals
