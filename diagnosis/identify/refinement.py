"""Simulation-error fitting: Gauss-Newton on the batch simulator, and intervals by leaving blocks out.

A Jacobian is one batch whose robots differ in one parameter each; a line search is another.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine.jackknife import half_width
from softarm.diagnosis.identify.bench import Bench, to_columns
from softarm.diagnosis.identify.motion import Motion
from softarm.schemas.model import Arm

Array = NDArray[np.float64]

ROUNDS_MAX = 12
NUDGE = 0.01  # of a parameter's scale, for a column of the Jacobian
STRIDES = (1.0, 0.5, 0.25, 0.1, 0.02)
CONVERGED = 2e-4  # a step smaller than this share of every scale ends the fit
BLOCK_S = 1.0  # residuals of one block are left out together: they are not independent
START_NUDGES = (0.01, 0.1)  # rad, rad/s
START_SHARE = 0.02  # a direction of the start that moves the signals less than this share of the best is left alone


@dataclass(frozen=True, slots=True)
class Refinement:
    """The parameters under which the simulation follows the measurement best."""

    column: Array  # [4 n] in bench.PARAMETERS order
    low: Array  # [4 n] 95 % interval: blocks left out one at a time
    high: Array
    rmse_before_m: float  # link ends, all links and frames compared, at the start
    rmse_m: float
    rounds: int
    converged: bool


@dataclass(frozen=True, slots=True)
class _Local:
    """One motion, linearised about parameters and start; the start is projected out of residual and Jacobian."""

    rmse_m: float  # link ends
    residual: Array  # [F 3 n] in units of the noise, frame by frame
    projected: Array  # [F 3 n] what no change of the start explains
    jacobian: Array  # [F 3 n, 4 n] per scale, projected
    raw: Array  # [F 3 n, 4 n] not projected
    solve_start: Array  # [2 n, F 3 n]: change of the start per residual


def fit(
    arm: Arm, motions: Sequence[Motion], start: Array, on_round: Callable[[int, float], None] | None = None
) -> Refinement:
    """Least squares over link ends and angles of every motion, in units of their noise, from a start column [4 n].

    Each motion's start (angles and rates) is a nuisance, eliminated by projection. `on_round(number, rmse_m)` is
    called after each Jacobian. Deterministic.
    """
    scale, low = _scales(arm, start)
    column = np.maximum(start, low)
    starts = [motion.start for motion in motions]
    rmse_first = 0.0
    converged = False
    for number in range(1, ROUNDS_MAX + 1):
        locals_ = [_linearise(arm, m, column, s, scale) for m, s in zip(motions, starts, strict=True)]
        rmse = _mean_rmse(motions, locals_)
        rmse_first = rmse_first or rmse
        if on_round is not None:
            on_round(number, rmse)
        jacobian = np.concatenate([item.jacobian for item in locals_])
        relative = np.linalg.lstsq(jacobian, np.concatenate([item.projected for item in locals_]), rcond=1e-8)[0]
        relative = np.clip(relative, -0.5, 0.5)
        moves = [item.solve_start @ (item.residual - item.raw @ relative) for item in locals_]
        columns = np.maximum(column + np.outer(STRIDES, relative * scale), low)
        costs = sum(
            _costs(arm, motion, columns, old + np.outer(STRIDES, move))
            for motion, old, move in zip(motions, starts, moves, strict=True)
        )
        best = int(np.argmin(costs))
        if not np.asarray(costs)[best] < sum(float(item.residual @ item.residual) for item in locals_):
            converged = True  # no stride helps: this is the bottom, to the simulator's rounding
            break
        column = columns[best]
        starts = [old + STRIDES[best] * move for old, move in zip(starts, moves, strict=True)]
        if np.all(np.abs(STRIDES[best] * relative) < CONVERGED):
            converged = True
            break
    locals_ = [_linearise(arm, m, column, s, scale) for m, s in zip(motions, starts, strict=True)]
    lows, highs = _interval(motions, locals_, column, scale)
    return Refinement(column, lows, highs, rmse_first, _mean_rmse(motions, locals_), number, converged)


def follow(arm: Arm, motion: Motion) -> NDArray[np.float32]:
    """What a given arm would have shown under a motion's inputs, [N, 3 n]; only the start is fitted."""
    column = to_columns(arm)
    scale, _ = _scales(arm, column)
    start = motion.start
    for _ in range(2):
        local = _linearise(arm, motion, column, start, scale)
        start = start + local.solve_start @ local.residual
    return np.asarray(Bench(arm, column[None]).replay(motion, start)[0])


def _scales(arm: Arm, start: Array) -> tuple[Array, Array]:
    """A usual size of each parameter, and its physical lower bound."""
    parts = np.split(start, 4)
    sizes = [np.full(arm.links, max(float(np.mean(np.abs(part))), 1e-4)) for part in parts]
    scale = np.concatenate([np.maximum(np.abs(part), 0.1 * size) for part, size in zip(parts, sizes, strict=True)])
    low = np.full(len(start), -np.inf)
    low[: 2 * arm.links] = 0.02 * scale[: 2 * arm.links]
    return scale, low


def _residuals(motion: Motion, signals: Array) -> Array:
    """Measured less simulated where it is compared, over the noise, [R, F 3 n]."""
    gap = (motion.signals[motion.compared] - signals[:, motion.compared]) / motion.noise
    return np.asarray(gap.reshape(len(signals), -1))


def _linearise(arm: Arm, motion: Motion, column: Array, start: Array, scale: Array) -> _Local:
    """Simulate a motion once for each parameter and each part of its start, all in one batch."""
    n, parameters = arm.links, len(column)
    columns = np.tile(column, (1 + parameters + 2 * n, 1))
    columns[1 : 1 + parameters] += np.diag(NUDGE * scale)
    nudges = np.repeat(START_NUDGES, n)
    starts = np.tile(start, (len(columns), 1))
    starts[1 + parameters :] += np.diag(nudges)
    residuals = _residuals(motion, Bench(arm, columns).replay(motion, starts))
    residual = residuals[0]
    changes = (residual - residuals[1:]).T
    raw, by_start = changes[:, :parameters] / NUDGE, changes[:, parameters:] / nudges
    left, strength, right = np.linalg.svd(by_start, full_matrices=False)
    felt = strength > START_SHARE * strength[0]
    left = left[:, felt]
    solve_start = (right[felt].T / strength[felt]) @ left.T
    ends = residual.reshape(-1, 3 * n)[:, : 2 * n] * motion.noise[: 2 * n]
    return _Local(
        float(np.sqrt(np.mean(ends**2))),
        residual,
        residual - left @ (left.T @ residual),
        raw - left @ (left.T @ raw),
        raw,
        solve_start,
    )


def _costs(arm: Arm, motion: Motion, columns: Array, starts: Array) -> Array:
    """Sum of squared residuals of each row of parameters and start; infinite where the simulation fails."""
    residuals = _residuals(motion, Bench(arm, columns).replay(motion, starts))
    costs = np.einsum("ij,ij->i", residuals, residuals)
    return np.where(np.isfinite(costs), costs, np.inf)


def _mean_rmse(motions: Sequence[Motion], locals_: Sequence[_Local]) -> float:
    frames = np.array([motion.compared.sum() for motion in motions])
    return float(np.sqrt(np.average([item.rmse_m**2 for item in locals_], weights=frames)))


def _interval(motions: Sequence[Motion], locals_: Sequence[_Local], column: Array, scale: Array) -> tuple[Array, Array]:
    """95 % interval of the linearised fit, whole seconds left out one at a time."""
    normals, slopes = [], []
    for motion, item in zip(motions, locals_, strict=True):
        t = motion.t_s[motion.compared]
        block = np.repeat(((t - t[0]) // BLOCK_S).astype(int), 3 * motion.links)
        for index in np.unique(block):
            part = item.jacobian[block == index]
            normals.append(part.T @ part)
            slopes.append(part.T @ item.projected[block == index])
    normal, slope = np.array(normals), np.array(slopes)
    step = np.linalg.lstsq(normal.sum(axis=0), slope.sum(axis=0), rcond=1e-10)[0]
    half = half_width(normal, -slope, step) * scale
    return column - half, column + half
