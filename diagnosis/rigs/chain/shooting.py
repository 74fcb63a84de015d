"""Multiple shooting: every window of a recording has a start of its own, fitted at every point that is tried.

A start is guessed from the data, so that no wrong model draws it away. How the angles change with it is worked out at
every point: a joint that its friction holds forgets its start. Then it moves along that, and what is still to go is
taken out of the residual as a straight line.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.chain.model import Chain
from softarm.diagnosis.rigs.laws import chain as law

ROUNDS = 2  # steps of a start, the last along a line
NUDGE = 0.05  # of how well a start is known
FURTHEST = 5.0  # likewise: a step's end
FAR = 1e3  # rad: what stands for a swing that has no number
AT_ONCE = 32  # points


@dataclass(frozen=True, slots=True)
class Law:
    """A chain's law at one point."""

    rows: Array  # [10 n + 4] of `laws.chain`
    bias: Array  # [n] rad, of the encoders


class Shooting:
    """W windows of a recording, cut to one length; what a law leaves of each, its start fitted."""

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
        """seen: by window [T, n] as measured, NaN where nothing was; push: [W, K] of the base, m/s^2 at every step.

        start: [W, 2 n] a guess of absolute angles and rates; sigma: [W, 2 n] how well it is known; moving: [W, n] signs
        of the joints' rates; each: steps a sample; weight: of the prior, against residuals of weight one: floor^2.
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
        """[P, W, T, n] measured minus swung; whatever lies beyond a window's end is of no meaning.

        torque: [W, K, n] N m at every step.
        """
        return np.concatenate([self._residuals(laws[i : i + AT_ONCE], torque) for i in range(0, len(laws), AT_ONCE)])

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
        """What is left from the guessed starts [W, P, T n], and how the swings change with each [W, P, 2 n, T n]."""
        points, (windows, size) = len(laws), self._start.shape
        away = NUDGE * self._sigma[:, :, None] * np.eye(size)
        nudges = np.concatenate((np.zeros((windows, 1, size)), away), axis=1)
        starts = np.tile(self._start[:, None] + nudges, (1, points, 1))
        found = self._left([each for each in laws for _ in range(1 + size)], torque, starts)
        found = found.reshape(windows, points, 1 + size, -1)
        return found[:, :, 0], (found[:, :, :1] - found[:, :, 1:]) / (NUDGE * self._sigma[:, None, :, None])

    def _left(self, laws: Sequence[Law], torque: Array, start: Array) -> Array:
        """[W, L, T n] measured minus swung from these starts [W, L, 2 n]; zero where nothing was measured."""
        rows, bias = np.stack([each.rows for each in laws]), np.stack([each.bias for each in laws])
        state = np.concatenate((start, self._start_shear(rows, torque[:, None, 0], start)), axis=2)
        left = swing(rows, state, torque, self._push, self._h, self._each)
        with np.errstate(invalid="ignore"):  # a law that nobody would believe swings away, and is far off
            if self._chain.relative:
                left[..., 1:] -= left[..., :-1].copy()
            np.subtract(self._seen[:, None], left, out=left)
            if bias.any():
                left -= bias[:, None, :]
            left *= self._counts[:, None]
        left[~(np.abs(left) < FAR)] = FAR
        return left.reshape(*left.shape[:2], -1)

    def _start_shear(self, rows: Array, torque: Array, start: Array) -> Array:
        """[W, L, n] friction at the start: whole where a joint turns; where none does, what holds the chain still."""
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
    """[W, L, T, n] absolute angles of W windows from L starts, `each` steps of h s a sample, K = T each in all.

    rows: [L, 10 n + 4] of `laws.chain`; state: [W, L, 3 n] angles, rates, shears; torque: [W, K, n]; push: [W, K].
    """
    windows, steps, n = torque.shape
    lanes, size = len(rows), steps // each
    blocks = -(-lanes // law.LANES)

    def packed(values: Array) -> Array:
        """[..., L, X] to [..., B, X 32], the last lane repeated."""
        spare = np.repeat(values[..., -1:, :], blocks * law.LANES - lanes, axis=-2)
        full = np.concatenate((values, spare), axis=-2).reshape(*values.shape[:-2], blocks, law.LANES, -1)
        return np.ascontiguousarray(full.swapaxes(-1, -2)).reshape(*values.shape[:-2], blocks, -1)

    out = np.empty((windows, blocks, size * n * law.LANES))
    law.swing(packed(rows), packed(state), np.ascontiguousarray(torque), np.ascontiguousarray(push), h, each, out)
    swung = out.reshape(windows, blocks, size * n, law.LANES).swapaxes(2, 3)
    return np.ascontiguousarray(swung).reshape(windows, blocks * law.LANES, size, n)[:, :lanes]
