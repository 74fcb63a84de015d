"""Simulation-error fitting: the diagnosis's own descent and intervals, on the joints' parameters of the arm alone.

The engine sees one view, whose residual is in units of the noise; the motions' starts are fitted beside the parameters.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine.candidates import Candidate, FittedParameter
from softarm.diagnosis.engine.fits import FitProblem
from softarm.diagnosis.engine.noise import Whitener
from softarm.diagnosis.engine.view import Array, Point
from softarm.diagnosis.engine.whitened import BLOCK_S, Gaps, WhitenedResidual, blocks_of
from softarm.diagnosis.identify.bench import Bench, names, to_columns
from softarm.diagnosis.identify.motion import Motion
from softarm.schemas.model import Arm

PRESSURE_SPAN_KPA = 1.0  # smallest span that shows the muscle
PASSES = 4  # each starts where the last one ended
ROUNDS = 8  # Gauss-Newton rounds of a pass
CONVERGED, FINE = 0.02, 1e-4  # largest step of the last pass, in half intervals and in usual sizes
START_NUDGES = (0.01, 0.1)  # rad, rad/s
START_SHARE = 0.02  # smallest useful direction of a start, relative to the largest
UNITS = ("N m/rad", "N m s/rad", "N m/kPa", "N m")


@dataclass(frozen=True, slots=True)
class Refinement:
    """Parameters of the best simulation of the measurements."""

    column: Array  # [4 n] in bench.PARAMETERS order
    low: Array  # [4 n] 95 % interval, jackknife over blocks
    high: Array
    rmse_before_m: float  # error of the link ends before the refinement
    rmse_m: float
    rounds: int
    converged: bool


class MotionsView:
    """View of the compared frames of all motions; satisfies `engine.view.View`.

    A point's paths are `bench.names`.
    """

    stage, unit = "arm", "noise"
    own_nuisances: Mapping[str, float] = {}

    def __init__(self, arm: Arm, motions: Sequence[Motion], column: Array, starts: Sequence[Array]) -> None:
        self._arm, self._motions, self._column, self._starts = arm, tuple(motions), column, tuple(starts)
        self._names = names(arm.links)
        self.acts = frozenset(self._names)
        self.t_s: Array = np.concatenate([m.t_s[m.compared] for m in motions])
        self.trial = np.repeat(np.arange(len(motions)), [int(m.compared.sum()) for m in motions])
        self.measured: Array = np.concatenate([m.signals[m.compared] / m.noise for m in motions])
        self.channels = tuple(f"link {i} {part}" for part in ("y", "z", "angle") for i in range(1, arm.links + 1))
        self.floor = np.ones(len(self.channels))
        self.noise = np.zeros(len(self.channels))
        self.regimes: Mapping[str, NDArray[np.bool_]] = {}
        self.features: Mapping[str, Array] = {}
        self.echoes: frozenset[str] = frozenset()

    def gap(self, points: Sequence[Point]) -> NDArray[np.float32]:
        """Return measured minus simulated at each point, in noise standard deviations, [P, M, 3 n]."""
        columns = np.tile(self._column, (len(points), 1))
        for row, point in zip(columns, points, strict=True):
            row[:] = [point.get(name, x) for name, x in zip(self._names, row, strict=True)]
        pairs = zip(self._motions, self._starts, strict=True)
        return np.concatenate([_gap(self._arm, motion, columns, start) for motion, start in pairs], axis=1)

    def own_directions(self) -> NDArray[np.float32]:
        """Return one zero direction, since the engine needs one."""
        return np.zeros((1, *self.measured.shape), np.float32)

    def start_directions(self) -> NDArray[np.float32]:
        """Return the changes of the gap with each motion's initial angles and rates, [2 n, M, 3 n]."""
        pairs = zip(self._motions, self._starts, strict=True)
        return np.concatenate([_directions(self._arm, m, self._column, start)[1] for m, start in pairs], axis=1)


def fit(
    arm: Arm, motions: Sequence[Motion], start: Array, on_round: Callable[[int, float], None] | None = None
) -> Refinement:
    """Fit the joints' parameters to the link ends and angles of every motion, weighted by their noise.

    Each motion's start (angles and rates) is eliminated by projection. The result is deterministic.

    Args:
        arm: arm that supplies the other parameters.
        motions: measured motions.
        start: initial column, [4 n].
        on_round: called before each pass with its number and the error of the link ends, m.
    """
    parameters = _parameters(arm, start, max(float(np.ptp(m.pressure_kpa)) for m in motions) < PRESSURE_SPAN_KPA)
    least, most, sizes = (np.array([getattr(p, what) for p in parameters]) for what in ("low", "high", "size"))
    column = np.clip(start, least, most)
    starts = [motion.start for motion in motions]
    rmse_first, number, converged = 0.0, 0, False
    half = np.zeros(len(column))
    while number < PASSES and not converged:
        number += 1
        starts = [_start(arm, m, column, s) for m, s in zip(motions, starts, strict=True)]
        rmse = _rmse_m(arm, motions, column, starts)
        rmse_first = rmse_first or rmse
        if on_round is not None:
            on_round(number, rmse)
        problem = _problem(MotionsView(arm, motions, column, starts))
        found = problem.fit([((Candidate("arm", "arm", parameters, ()),), (tuple(column),))], ROUNDS)[0]
        low, high = problem.interval(found)
        half, at = (high - low) / 2, np.array(found.u[0])
        # Only a step within the interval is taken; an invisible parameter has none and stays.
        stepped = np.clip(np.where(np.abs(low + half - at) <= half, low + half, at), least, most)
        converged = bool(np.all(np.abs(stepped - column) <= np.maximum(CONVERGED * half, FINE * sizes)))
        column = stepped
    starts = [_start(arm, m, column, s) for m, s in zip(motions, starts, strict=True)]
    return Refinement(
        column, column - half, column + half, rmse_first, _rmse_m(arm, motions, column, starts), number, converged
    )


def follow(arm: Arm, motion: Motion) -> NDArray[np.float32]:
    """Return the signals of a given arm under a motion's inputs, [N, 3 n]; only the start is fitted."""
    column, start = to_columns(arm), motion.start
    for _ in range(2):
        start = _start(arm, motion, column, start)
    return np.asarray(Bench(arm, column[None]).replay(motion, start)[0])


def _parameters(arm: Arm, start: Array, muscle_rests: bool) -> tuple[FittedParameter, ...]:
    """Return the joints' parameters with their sizes and bounds; the gain of a resting muscle is fixed."""
    parts = np.split(start, 4)
    sizes = [np.full(arm.links, max(float(np.mean(np.abs(part))), 1e-4)) for part in parts]
    scale = np.concatenate([np.maximum(np.abs(part), 0.1 * size) for part, size in zip(parts, sizes, strict=True)])
    low, high = np.full(len(start), -math.inf), np.full(len(start), math.inf)
    low[: 2 * arm.links] = 0.02 * scale[: 2 * arm.links]
    if muscle_rests:
        gain = slice(2 * arm.links, 3 * arm.links)
        low[gain] = high[gain] = start[gain]
    units = np.repeat(UNITS, arm.links)
    return tuple(
        FittedParameter(name, str(unit), max(x, least), least, most, size, math.nan)
        for name, unit, x, least, most, size in zip(names(arm.links), units, start, low, high, scale, strict=True)
    )


def _problem(view: MotionsView) -> FitProblem:
    taps = np.ones((len(view.channels), 1), np.float32)
    whiten = Whitener(taps, np.ones(view.measured.shape, np.float32))
    residual = WhitenedResidual(Gaps(view), whiten, view.own_directions(), view.start_directions(), 1.0)
    blocks = tuple(name for name, *_ in blocks_of(view, BLOCK_S))
    none = np.zeros(1)
    return FitProblem((residual,), ("none",), none, none, blocks, np.zeros(len(blocks), dtype=np.int64))


def _gap(arm: Arm, motion: Motion, columns: Array, starts: Array) -> NDArray[np.float32]:
    """Return measured minus simulated of the compared frames over the noise, [R, F, 3 n]."""
    seen = Bench(arm, columns).replay(motion, starts)
    return np.asarray((motion.signals[motion.compared] - seen[:, motion.compared]) / motion.noise, dtype=np.float32)


def _directions(arm: Arm, motion: Motion, column: Array, start: Array) -> tuple[NDArray[np.float32], ...]:
    """Return a motion's gap [F, 3 n] and its changes with the start, [2 n, F, 3 n]."""
    nudges = np.repeat(START_NUDGES, arm.links)
    starts = np.vstack((start, start + np.diag(nudges)))
    gaps = _gap(arm, motion, np.tile(column, (len(starts), 1)), starts)
    return gaps[0], gaps[1:] - gaps[0]


def _start(arm: Arm, motion: Motion, column: Array, start: Array) -> Array:
    """Return a start improved by one step, along the directions that the signals show."""
    gap, directions = _directions(arm, motion, column, start)
    rows = directions.reshape(len(directions), -1).T.astype(np.float64)
    step = np.linalg.lstsq(rows, -gap.ravel().astype(np.float64), rcond=START_SHARE)[0]
    return np.asarray(start + step * np.repeat(START_NUDGES, arm.links))


def _rmse_m(arm: Arm, motions: Sequence[Motion], column: Array, starts: Sequence[Array]) -> float:
    """Return the RMS error of the link ends, m."""
    ends = slice(0, 2 * arm.links)
    pairs = zip(motions, starts, strict=True)
    squares = [(_gap(arm, m, column[None], s)[0, :, ends] * m.noise[ends]) ** 2 for m, s in pairs]
    return float(np.sqrt(np.concatenate(squares).mean()))
