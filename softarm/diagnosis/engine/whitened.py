"""Whitened and weighted residuals of a view as rows of a least-squares problem, without the trials' starts.

Results are cached by the parameters that act on the view, so that a parameter of another stage costs no simulation.
"""

from collections import OrderedDict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine.noise import Whitener
from softarm.diagnosis.engine.view import Array, Point, View

Rows = NDArray[np.float32]
Key = tuple[tuple[str, float], ...]
T = TypeVar("T")
CACHED = 1500
BLOCK_S = 1.5  # block of the robot; a rig's view has its own
START_PRIOR = 1.0  # a trial's start is known to about one unit of its directions


class Cache(Generic[T]):
    """Results by key, computed in batches; of more than CACHED, those used least recently are dropped."""

    def __init__(self, compute: Callable[[list[Key]], Iterable[T]]) -> None:
        self._compute = compute
        self._found: OrderedDict[Key, T] = OrderedDict()

    def fetch(self, keys: Sequence[Key]) -> list[T]:
        """Return the result of each key; missing ones are computed in one batch."""
        missing = [key for key in dict.fromkeys(keys) if key not in self._found]
        if missing:
            self._found.update(zip(missing, self._compute(missing), strict=True))
        result = [self._found[key] for key in keys]
        for key in keys:
            self._found.move_to_end(key)
        while len(self._found) > max(CACHED, len(keys)):
            self._found.popitem(last=False)
        return result


class Gaps:
    """Cache of a view's raw gaps."""

    def __init__(self, view: View) -> None:
        self.view = view
        self.on_rollouts: Callable[[int], None] = lambda rollouts: None  # called with the number of new simulations
        self._cache = Cache(self._simulate)

    def _simulate(self, keys: list[Key]) -> NDArray[np.float32]:
        found = self.view.gap([dict(key) for key in keys])
        self.on_rollouts(len(keys))
        return found

    def key(self, point: Point) -> Key:
        """Return the part of a point that acts on the view."""
        return tuple(sorted((path, float(x)) for path, x in point.items() if path in self.view.acts))

    def fetch(self, points: Sequence[Point]) -> dict[Key, NDArray[np.float32]]:
        """Return the gaps [M, S] of all points by key; missing ones are simulated in one batch."""
        keys = list(dict.fromkeys(self.key(point) for point in points))
        return dict(zip(keys, self._cache.fetch(keys), strict=True))


@dataclass(frozen=True, slots=True)
class Moments:
    """Products of one point's rows r [N] with the nuisance columns G [q, N]."""

    rows: Rows  # [N]
    rr: float
    gr: Array  # [q]


class WhitenedResidual:
    """Rows of one view under one weighting, with the q nuisance columns of the problem."""

    def __init__(
        self,
        gaps: Gaps,
        whiten: Whitener,
        nuisances: Rows,
        starts: Rows | None,
        weight: float,
        block_s: float = BLOCK_S,
    ) -> None:
        """Whiten the nuisance columns.

        Args:
            gaps: gaps of the view.
            whiten: filter of the residuals.
            nuisances: changes of the gap at the edges of the boxes, [q, M, S].
            starts: changes of the gap with each trial's start, [d, M, S].
            weight: weight of each whitened square.
            block_s: length of a block that counts as independent.
        """
        self.gaps, self._whiten, self._weight = gaps, whiten, np.float32(np.sqrt(weight))
        view = gaps.view
        self._trials = slices(view.trial)
        self._starts = None if starts is None else self._solve_starts(starts)
        self.columns = self._rows(nuisances)  # [q, N]
        self._active = np.flatnonzero(self.columns.any(axis=1))  # nuisances that act on this view
        self._acting = np.ascontiguousarray(self.columns[self._active])
        self.gg = (self.columns @ self.columns.T).astype(np.float64)
        self.kept = float(whiten.keep.sum())
        self._moments = Cache(self._products)
        width = nuisances.shape[2]
        self.blocks = [(name, slice(a * width, b * width)) for name, a, b in blocks_of(view, block_s)]

    @cached_property
    def block_gg(self) -> Array:
        """Return the Gram matrices of the nuisance columns, [blocks, q, q]."""
        columns = (self.columns[:, part] for _, part in self.blocks)
        return np.stack([c @ c.T for c in columns]).astype(np.float64)

    def products(self, rows: Rows) -> Array:
        """Return the products of rows [k, N] with the nuisance columns, [k, q]."""
        found = np.zeros((len(rows), len(self.columns)))
        found[:, self._active] = rows @ self._acting.T
        return found

    def block_products(self, rows: Rows) -> tuple[Array, Array]:
        """Return the products of rows [k, N] in each block: with one another [B, k, k], and as `products` [B, k, q]."""
        mine = self._by_block(rows)
        across = np.zeros((*mine.shape[:2], len(self.columns)))
        across[:, :, self._active] = mine @ self._acting_by_block
        return (mine @ mine.transpose(0, 2, 1)).astype(np.float64), across

    @cached_property
    def _acting_by_block(self) -> Rows:
        return np.ascontiguousarray(self._by_block(self._acting).transpose(0, 2, 1))

    def _by_block(self, rows: Rows) -> Rows:
        """Return rows [k, N] by block [B, k, L], with zeros behind a block that is shorter than the longest."""
        padded = np.concatenate((rows, np.zeros((len(rows), 1), rows.dtype)), axis=1)
        return np.ascontiguousarray(padded[:, self._places].transpose(1, 0, 2))

    @cached_property
    def _places(self) -> NDArray[np.int64]:
        """Indices of each block's samples, [B, L]; behind a short block that of a zero."""
        longest = max(part.stop - part.start for _, part in self.blocks)
        places = np.full((len(self.blocks), longest), self.columns.shape[1])
        for at, (_, part) in zip(places, self.blocks, strict=True):
            at[: part.stop - part.start] = np.arange(part.start, part.stop)
        return places

    def nuisance_rows(self, nuisance: Array) -> Rows:
        """Return the change of the rows with nuisances [q] in units of their edges, [N]."""
        return np.asarray(nuisance[self._active].astype(np.float32) @ self._acting)

    def moments(self, points: Sequence[Point]) -> list[Moments]:
        """Return the moments of each point."""
        return self._moments.fetch([self.gaps.key(point) for point in points])

    def _products(self, keys: Sequence[Key]) -> list[Moments]:
        raw = self.gaps.fetch([dict(key) for key in keys])
        rows = self._rows(np.stack([raw[key] for key in keys]))
        gr = self.products(rows)
        rr = np.einsum("ij,ij->i", rows, rows).astype(np.float64)
        return [Moments(rows[i], float(rr[i]), gr[i]) for i in range(len(keys))]

    def _rows(self, gaps: NDArray[np.floating]) -> Rows:
        """Return whitened, weighted rows [P, M S] of gaps [P, M, S]."""
        white = self._whiten(gaps)
        if self._starts is not None:
            for part, (directions, solve) in zip(self._trials, self._starts, strict=True):
                rows = white[:, part].reshape(len(white), -1)
                rows -= (rows @ directions.T) @ (solve @ directions)
                white[:, part] = rows.reshape(white[:, part].shape)
        return np.ascontiguousarray(white.reshape(len(white), -1) * self._weight)

    def _solve_starts(self, starts: Rows) -> list[tuple[Rows, Rows]]:
        white = self._whiten(starts)
        found = []
        for part in self._trials:
            directions = white[:, part].reshape(len(white), -1)
            normal = directions @ directions.T + START_PRIOR * np.eye(len(directions), dtype=np.float32)
            found.append((directions, np.linalg.inv(normal).astype(np.float32)))
        return found


def slices(trial: NDArray[np.int64]) -> list[slice]:
    """Return the samples of each trial."""
    edges = np.flatnonzero(np.diff(trial, prepend=-1, append=-1))
    return [slice(int(a), int(b)) for a, b in pairwise(edges)]


def samples(view: View, seconds: float) -> int:
    """Return the number of a view's samples in a time, at least one."""
    return max(1, round(seconds / float(np.median(np.diff(view.t_s[slices(view.trial)[0]])))))


def blocks_of(view: View, length_s: float) -> list[tuple[tuple[int, int], int, int]]:
    """Return the name (trial, number) and the range of samples of every block, in order."""
    found = []
    t, trial = view.t_s, view.trial
    for part in slices(trial):
        number = ((t[part] - t[part.start]) / length_s).astype(int)
        edges = np.flatnonzero(np.diff(number, prepend=-1, append=-1))
        found += [
            ((int(trial[part.start]), int(number[a])), part.start + int(a), part.start + int(b))
            for a, b in pairwise(edges)
        ]
    return found
