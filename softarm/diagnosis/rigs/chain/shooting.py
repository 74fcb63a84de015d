"""Multiple shooting: the start of every window of a recording is fitted again at every point.

A start is guessed from the data, so that a wrong model cannot bias it. Its derivatives are computed at every point,
because a joint that friction holds forgets its start. The last step is taken linearly.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.chain.model import Chain
from softarm.diagnosis.rigs.laws import chain as law

# Gauss-Newton steps of a start, the last one linear.
ROUNDS = 2
# Step of the numerical derivative and largest step of a start, in its uncertainty.
NUDGE = 0.05
FURTHEST = 5.0
# Residual of a simulation that diverged, rad.
FAR = 1e3
# Number of points that are computed together.
AT_ONCE = 32


@dataclass(frozen=True, slots=True)
class Law:
    """Parameters of a chain at one point."""

    rows: Array  # parameters for `laws.chain`, [10 n + 4]
    bias: Array  # error of the encoders' zeros, rad [n]


class Shooting:
    """Residuals of W windows of one length, with the start of each window fitted."""

    def __init__(
        self,
        chain: Chain,
        seen: Sequence[Array],
        push: Array,
        start: Array,
        sigma: Array,
        moving: Array,
        *,
        step_s: float,
        each: int,
        weight: float,
    ) -> None:
        """Prepare W windows of a chain with n links.

        Args:
            chain: nominal model.
            seen: measured angles of each window, [T, n]; NaN where no sample was measured.
            push: acceleration of the base at every step, m/s^2, [W, K].
            start: guessed absolute angles and rates at the starts, [W, 2 n].
            sigma: uncertainty of the guess, [W, 2 n].
            moving: signs of the joints' rates at the starts, [W, n]; 0 at rest.
            step_s: sampling interval.
            each: integration steps per sample.
            weight: weight of the guess against residuals of weight one; the squared noise floor.
        """
        self._chain, self._push, self._h, self._each = chain, push, step_s / each, each
        self._start, self._sigma, self._moving, self._prior = start, sigma, moving, weight / sigma**2
        size = max(len(s) for s in seen)
        self._seen = np.zeros((len(seen), size, chain.n))
        self._counts = np.zeros((len(seen), size, chain.n))
        self.kept: NDArray[np.bool_] = np.zeros((len(seen), size), dtype=bool)
        for k, values in enumerate(seen):
            self.kept[k, : len(values)] = True
            self._counts[k, : len(values)] = np.isfinite(values)
            self._seen[k, : len(values)] = np.nan_to_num(values)

    def residuals(self, laws: Sequence[Law], torque: Array) -> Array:
        """Return measured minus simulated angles at P points, [P, W, T, n], under torques at every step, N m [W, K, n].

        Values beyond a window's end are meaningless.
        """
        return np.concatenate([self._residuals(laws[i : i + AT_ONCE], torque) for i in range(0, len(laws), AT_ONCE)])

    def growth(self, law: Law, torque: Array) -> Array:
        """Return the largest change of an angle in each window over the change of an angle at its start, [W]."""
        n = self._chain.n
        _, slopes = self._differences([law], torque)
        found = np.abs(slopes[:, 0, :n]).reshape(len(self.kept), n, -1, n) * self.kept[:, None, :, None]
        return np.asarray(found.max(axis=(1, 2, 3)))

    def _residuals(self, laws: Sequence[Law], torque: Array) -> Array:
        points, (windows, size) = len(laws), self._start.shape
        left, slopes = self._differences(laws, torque)
        prior, sigma = self._prior[:, None], self._sigma[:, None]
        normal = slopes @ slopes.swapaxes(-1, -2) + prior[..., None] * np.eye(size)
        inverse = np.linalg.inv(normal)
        moved = np.zeros((windows, points, size))
        for k in range(ROUNDS):
            change = (inverse @ ((slopes @ left[..., None])[..., 0] - prior * moved)[..., None])[..., 0]
            if k < ROUNDS - 1:
                moved = moved + np.clip(change, -FURTHEST * sigma, FURTHEST * sigma)
                left = self._left(laws, torque, self._start[:, None] + moved)
        found = left - (change[..., None, :] @ slopes)[..., 0, :]
        return found.swapaxes(0, 1).reshape(points, *self._seen.shape)

    def _differences(self, laws: Sequence[Law], torque: Array) -> tuple[Array, Array]:
        """Residuals from the guessed starts [W, P, T n] and their derivatives by the starts [W, P, 2 n, T n]."""
        points, (windows, size) = len(laws), self._start.shape
        away = NUDGE * self._sigma[:, :, None] * np.eye(size)
        nudges = np.concatenate((np.zeros((windows, 1, size)), away), axis=1)
        starts = np.tile(self._start[:, None] + nudges, (1, points, 1))
        found = self._left([each for each in laws for _ in range(1 + size)], torque, starts)
        found = found.reshape(windows, points, 1 + size, -1)
        return found[:, :, 0], (found[:, :, :1] - found[:, :, 1:]) / (NUDGE * self._sigma[:, None, :, None])

    def _left(self, laws: Sequence[Law], torque: Array, start: Array) -> Array:
        """Measured minus simulated angles from starts [W, L, 2 n], as [W, L, T n]; zero where none was measured."""
        rows, bias = np.stack([each.rows for each in laws]), np.stack([each.bias for each in laws])
        state = np.concatenate((start, self._start_shear(rows, torque[:, None, 0], start)), axis=2)
        left = swing(rows, state, torque, self._push, self._h, self._each)
        with np.errstate(invalid="ignore"):  # implausible parameters may diverge
            if self._chain.relative:
                left[..., 1:] -= left[..., :-1].copy()
            np.subtract(self._seen[:, None], left, out=left)
            if bias.any():
                left -= bias[:, None, :]
            left *= self._counts[:, None]
        left[~(np.abs(left) < FAR)] = FAR
        return left.reshape(*left.shape[:2], -1)

    def _start_shear(self, rows: Array, torque: Array, start: Array) -> Array:
        """Shear of the friction at the start [W, L, n]: whole if the joint turns, otherwise what holds it at rest."""
        n = self._chain.n
        table, rest = rows[:, : law.EACH * n].reshape(-1, law.EACH, n), rows[:, law.EACH * n :]
        angle, down, along = start[:, :, :n], rest[:, law.DOWN, None], rest[:, law.ALONG, None]
        lean = table[:, law.MOMENT] * (down * np.sin(angle) + along * np.cos(angle))
        driven = torque * table[:, law.GAIN] + table[:, law.OFFSET]
        needed = driven - np.cumsum(lean[..., ::-1], axis=-1)[..., ::-1]
        still = np.clip(needed / np.maximum(table[:, law.DRY], 1e-12), -1.0, 1.0)
        moving = self._moving[:, None]
        return np.asarray(table[:, law.GIVE] * np.where(moving != 0, moving, still))


def swing(rows: Array, state: Array, torque: Array, push: Array, h: float, each: int) -> Array:
    """Simulate W windows from L starts; return absolute angles, [W, L, T, n].

    Args:
        rows: parameters for `laws.chain`, [L, 10 n + 4].
        state: angles, rates and shears at the starts, [W, L, 3 n].
        torque: motor torques at every step, N m, [W, K, n] with K = T each.
        push: acceleration of the base at every step, m/s^2, [W, K].
        h: length of a step, s.
        each: steps per sample.
    """
    windows, steps, n = torque.shape
    lanes, size = len(rows), steps // each
    blocks = -(-lanes // law.LANES)

    def packed(values: Array) -> Array:
        """Pack [..., L, X] into [..., B, X 32], the last lane repeated."""
        spare = np.repeat(values[..., -1:, :], blocks * law.LANES - lanes, axis=-2)
        full = np.concatenate((values, spare), axis=-2).reshape(*values.shape[:-2], blocks, law.LANES, -1)
        return np.ascontiguousarray(full.swapaxes(-1, -2)).reshape(*values.shape[:-2], blocks, -1)

    out = np.empty((windows, blocks, size * n * law.LANES))
    law.swing(packed(rows), packed(state), np.ascontiguousarray(torque), np.ascontiguousarray(push), h, each, out)
    swung = out.reshape(windows, blocks, size * n, law.LANES).swapaxes(2, 3)
    return np.ascontiguousarray(swung).reshape(windows, blocks * law.LANES, size, n)[:, :lanes]
