"""Least-squares problem of a set of views: folds, blocks, nuisance columns and weights."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine.candidates import Nuisance
from softarm.diagnosis.engine.fits import Fit, FitProblem
from softarm.diagnosis.engine.noise import Whitener, scaled, unfiltered, whitener
from softarm.diagnosis.engine.result import HeldOut
from softarm.diagnosis.engine.view import View
from softarm.diagnosis.engine.whitened import BLOCK_S, Gaps, WhitenedResidual, blocks_of

# Weighted squares per block of a view: neighbouring samples and channels are not independent.
BLOCK_LOSS = 6.0
TRIALS_MOST = 6  # largest number of folds of whole trials; neighbouring trials share a fold
STRETCHES = 5  # folds of a single trial
FAR = 0.2  # share of its box by which a nuisance is moved before its slope is taken up to there


@dataclass(frozen=True, slots=True)
class Directions:
    """Changes of a view's gap with the nuisances, to the edges of their boxes, and with the trials' starts."""

    nuisances: NDArray[np.float32]  # [q, M, S]
    starts: NDArray[np.float32] | None


class Setup:
    """Views, nuisances, blocks and folds of a diagnosis, for any weighting."""

    def __init__(
        self,
        views: Sequence[View],
        nuisances: Sequence[Nuisance],
        kinds: Sequence[str],
        origins: Sequence[int] | None = None,
        block_s: float = BLOCK_S,
        around: Fit | None = None,
    ) -> None:
        """Prepare the problem.

        Args:
            views: stages to compare.
            nuisances: parameters that are fitted within their boxes in every fit.
            kinds: excitation of each trial of the views.
            origins: recording that each trial was cut from; by default each trial is one recording.
            block_s: length of a block that counts as independent, in the views' own time.
            around: fit around whose effects the nuisances act linearly, by default the nominal model. Those that it has
                moved far have the slope up to there; damping that vanishes acts otherwise than damping that grows.
        """
        self.block_s = block_s
        self.views, self.nuisances, self.kinds = tuple(views), tuple(nuisances), tuple(kinds)
        self.gaps = tuple(Gaps(view) for view in views)
        self._own = {name: share for view in views for name, share in view.own_nuisances.items()}
        self.directions = tuple(self._directions(g, around) for g in self.gaps)
        self.blocks = tuple(dict.fromkeys(name for view in views for name, *_ in blocks_of(view, block_s)))
        self.origins = tuple(range(len(kinds)) if origins is None else origins)
        self.fold, self.held_out = folds(self.blocks, kinds, self.origins), held_out(kinds, self.origins)
        edges = [(n.low - n.nominal, n.high - n.nominal, n.edge - n.nominal) for n in self.nuisances]
        boxes = [sorted((low / edge, high / edge)) if edge else [0.0, 0.0] for low, high, edge in edges]
        self._low = np.array([b[0] for b in boxes] + [-1.0] * len(self._own))
        self._high = np.array([b[1] for b in boxes] + [1.0] * len(self._own))
        self._paths = (*(n.path for n in self.nuisances), *self._own)

    def beside(self, fit: Fit) -> "Setup":
        """Return the problem with nuisances that act linearly around the effects of a fit."""
        return Setup(self.views, self.nuisances, self.kinds, self.origins, self.block_s, fit)

    def search_folds(self, by: Literal["held_out", "trial", "block"]) -> NDArray[np.int64]:
        """Return the folds [B] of a search: those of the verdict, whole recordings, or every fifth block."""
        if by == "block":
            return interleaved(self.blocks)
        return self.fold if by == "held_out" else folds(self.blocks, ("any",) * len(self.origins), self.origins)

    def by_sample(self, view: View, folds: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the fold of each sample of a view, [M], from those of the blocks, [B]."""
        fold = dict(zip(self.blocks, folds, strict=True))
        own = np.empty(len(view.trial), dtype=np.int64)
        for name, a, b in blocks_of(view, self.block_s):
            own[a:b] = fold[name]
        return own

    def weighed(self, residuals: Sequence[NDArray[np.floating]] | None = None) -> FitProblem:
        """Return the problem whitened by these residuals (by view, [M, S]), or scaled by the nominal gap."""
        filters = []
        for i, view in enumerate(self.views):
            if residuals is None:
                filters.append(scaled(view, self.gaps[i].fetch([{}])[()].astype(np.float64)))
            else:
                filters.append(whitener(view, residuals[i].astype(np.float64)))
        return self._problem(filters, BLOCK_LOSS / self.block_s)

    def plain(self) -> FitProblem:
        """Return the problem in units of the noise floors, every sample with weight one."""
        return self._problem([unfiltered(view, view.floor) for view in self.views], None)

    def residuals(self, plain: FitProblem, fit: Fit) -> list[NDArray[np.float32]]:
        """Return the residual of every view after a fit, [M, S], NaN where nothing was measured."""
        found = []
        for view, residual in zip(self.views, plain.whitened, strict=True):
            rows = residual.moments([fit.point])[0].rows + residual.nuisance_rows(fit.nuisance)
            left = rows.reshape(view.measured.shape) * view.floor.astype(np.float32)
            found.append(np.where(np.isfinite(view.measured), left, np.float32(np.nan)))
        return found

    def linearisation_error(self, stage: str, fit: Fit) -> float:
        """Return the energy by which a stage at a fit's nuisances differs from their linear model."""
        i = next(i for i, view in enumerate(self.views) if view.stage == stage)
        gaps, count = self.gaps[i], len(self.nuisances)
        shares = np.where([n.path in fit.point for n in self.nuisances], 0.0, fit.nuisance[:count])
        edges = zip(self.nuisances, shares, strict=True)
        moved = {**fit.point, **{n.path: n.nominal + x * (n.edge - n.nominal) for n, x in edges if x}}
        found = gaps.fetch([fit.point, moved])
        line = np.tensordot(shares, self.directions[i].nuisances[:count], 1)
        off = found[gaps.key(moved)] - found[gaps.key(fit.point)] - line
        return float(np.nanmean((off / gaps.view.floor) ** 2))

    def nuisance_scales(self) -> list[tuple[str, float, float]]:
        """Return path, nominal value and change at the box's edge of every nuisance, of single joints as shares."""
        scales = [(n.path, n.nominal, n.edge - n.nominal) for n in self.nuisances]
        return scales + [(name, 0.0, share) for name, share in self._own.items()]

    def fitted_nuisances(self, fit: Fit) -> dict[str, float]:
        """Return the fitted nuisances of a set in the registry's units, of single joints as shares."""
        own = {p.path for each in fit.effects for p in each.parameters}
        found = zip(self.nuisance_scales(), fit.nuisance, strict=True)
        return {path: nominal + float(x) * edge for (path, nominal, edge), x in found if path not in own}

    def _problem(self, filters: Sequence[Whitener], per_second: float | None) -> FitProblem:
        whitened = []
        for gaps, whiten, directions in zip(self.gaps, filters, self.directions, strict=True):
            kept = float(whiten.keep.sum())
            seconds = kept / whiten.keep.shape[1] * float(np.median(np.diff(gaps.view.t_s)))
            weight = 1.0 if per_second is None else per_second * seconds / max(kept, 1.0)
            whitened.append(
                WhitenedResidual(gaps, whiten, directions.nuisances, directions.starts, weight, self.block_s)
            )
        return FitProblem(tuple(whitened), self._paths, self._low, self._high, self.blocks, self.fold)

    def _directions(self, gaps: Gaps, around: Fit | None) -> Directions:
        view, at, shares = gaps.view, {} if around is None else around.point, np.ones(len(self.nuisances))
        if around is not None:
            fitted = around.nuisance[: len(shares)]
            shares = np.where(np.abs(fitted) > FAR, fitted, shares)
        points = [{**n.at(float(share)), **at} for n, share in zip(self.nuisances, shares, strict=True)]
        found = gaps.fetch([at, *points])
        base = found[gaps.key(at)]
        columns = [(found[gaps.key(p)] - base) / np.float32(x) for p, x in zip(points, shares, strict=True)]
        columns += [np.zeros_like(base)] * len(self._own)
        starts = view.start_directions()
        if view.own_nuisances:
            first = len(self.nuisances) + list(self._own).index(next(iter(view.own_nuisances)))
            columns[first : first + len(view.own_nuisances)] = list(view.own_directions())
        return Directions(np.nan_to_num(np.stack(columns)), None if starts is None else np.nan_to_num(starts))


def held_out(kinds: Sequence[str], origins: Sequence[int]) -> HeldOut:
    """Return the largest unit that can be held out.

    Args:
        kinds: excitation of each trial of a view.
        origins: recording that each trial was cut from.
    """
    if len(set(kinds)) > 1:
        return "kind"
    return "trial" if len(set(origins)) > 1 else "block"


def folds(blocks: Sequence[tuple[int, int]], kinds: Sequence[str], origins: Sequence[int]) -> NDArray[np.int64]:
    """Return the fold of each block (trial, number), [B]: a kind, a recording, or a fifth of the only one."""
    how = held_out(kinds, origins)
    if how == "kind":
        place = {kind: i for i, kind in enumerate(sorted(set(kinds)))}
        return np.array([place[kinds[trial]] for trial, _ in blocks])
    if how == "trial":
        names = sorted({origins[trial] for trial, _ in blocks})
        count = min(len(names), TRIALS_MOST)
        return np.array([names.index(origins[trial]) * count // len(names) for trial, _ in blocks])
    return np.array([i * STRETCHES // len(blocks) for i in range(len(blocks))])


def interleaved(blocks: Sequence[tuple[int, int]]) -> NDArray[np.int64]:
    """Return folds of every fifth block of each trial, [B]; a weaker test than `folds`, without extrapolation."""
    return np.array([(trial + number) % STRETCHES for trial, number in blocks])
