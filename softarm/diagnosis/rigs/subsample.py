"""Stretches of long recordings that hold the most information, so that a diagnosis keeps its budget.

The budget is in seconds of processor time of the computer on which each view's `step_cost_s` was measured, and the
plan counts rollouts: the same data and budget give the same stretches, and the same answer, on any machine.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.data.trials import Trial
from softarm.diagnosis.engine import work
from softarm.diagnosis.engine.candidates import Candidate, EffectSet, parameters_of, point_of
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.engine.whitened import slices
from softarm.diagnosis.rigs.candidates import candidates, nuisances
from softarm.diagnosis.rigs.grid import windows
from softarm.diagnosis.rigs.views import RigView

# Largest number of stretches that a recording is cut into, for stretches of four blocks.
PIECES_MOST = 8
# Share of the budget that a search uses by plan.
PLANNED = 0.75
# Shortest stretch, in blocks: one of the two windows that a block has at least.
LEAST_BLOCKS = 0.5
# Stretches of each kind of excitation that are used at least.
KIND_LEAST = 2
# Share of the information in the poorer half of the recordings from which stretches of both halves are kept.
HALF_LEAST = 0.2


@dataclass(frozen=True, slots=True)
class Stretches:
    """Stretches of a stage's recordings, and the recording that each was cut from."""

    trials: tuple[Trial, ...]
    origins: tuple[int, ...]

    @property
    def kinds(self) -> list[str]:
        """Return the excitation of each stretch."""
        return [trial.kind for trial in self.trials]

    def cut_into(self, parts: Iterable[tuple[Trial, ...]]) -> "Stretches":
        """Return the parts of every stretch as stretches."""
        pairs = [(part, k) for k, mine in zip(self.origins, parts, strict=True) for part in mine]
        return Stretches(tuple(part for part, _ in pairs), tuple(k for _, k in pairs))

    def part(self, kept: Sequence[int]) -> "Stretches":
        """Return some of the stretches, in their order."""
        return Stretches(tuple(self.trials[i] for i in kept), tuple(self.origins[i] for i in kept))


def within(budget_s: float, view: RigView, stretches: Stretches) -> tuple[Stretches, str] | None:
    """Return the most informative stretches of a view's trials, and a note about them; None if all fit the budget."""
    whole_s = planned_s(view, candidates(view))
    share = PLANNED * budget_s / whole_s
    if share >= 1:
        return None
    ((found,), of, used) = together(share, [view], [stretches])
    note = (
        f"{view.stage}: to keep its budget of {budget_s:.3g} s, the search uses the {len(found.trials)} most "
        f"informative of {of} stretches, {used:.0%} of the samples; --budget sets another"
    )
    if used * whole_s > budget_s:
        note += f"; these are the fewest of which some can be held out, and take about {used * whole_s:.2g} s"
    return found, note


def for_sizes(budget_s: float, view: RigView, stretches: Stretches, chosen: EffectSet) -> Stretches:
    """Return the stretches to which chosen effects are fitted after a search on fewer: all that the budget pays for."""
    parameters = len(parameters_of(chosen))
    rollouts = work.full(parameters) + work.reduced(len(chosen), parameters)
    share = budget_s / (rollouts * view.rollout_s)
    return stretches if share >= 1 else together(share, [view], [stretches])[0][0]


def together(
    share: float, views: Sequence[RigView], stretches: Sequence[Stretches]
) -> tuple[list[Stretches], int, float]:
    """Return the stretches that hold the most information about all stages, the same times for each.

    Args:
        share: share of the samples.
        views: a view of each stage, on the same recordings.
        stretches: their stretches.

    Returns:
        The stretches of each stage, how many there were, and their share of the samples.
    """
    lead, found, numbers = views[0], list(stretches), [view.trial for view in views]
    if not lead.fits_starts:
        seconds = lengths_s(lead, stretches[0].trials, share)
        parts = [[windows(t, s) for t, s in zip(each.trials, seconds, strict=True)] for each in stretches]
        numbers = [_pieces_of_samples(view, part) for view, part in zip(views, parts, strict=True)]
        found = [each.cut_into(part) for each, part in zip(stretches, parts, strict=True)]
    sizes = np.bincount(numbers[0], minlength=len(found[0].trials)).astype(float)
    known = np.hstack([information(view, candidates(view), each) for view, each in zip(views, numbers, strict=True)])
    kept = most_informative(_by_half(known, found[0]), sizes, [t.kind for t in found[0].trials], share)
    return [each.part(kept) for each in found], len(sizes), float(sizes[kept].sum() / sizes.sum())


def planned_s(view: RigView, known: Sequence[Candidate]) -> float:
    """Return the planned processor time of a search on a view, s."""
    parameters = sum(len(each.parameters) for each in known)
    return work.backward(len(known), parameters) * view.rollout_s


def lengths_s(view: RigView, trials: Sequence[Trial], share: float) -> list[float]:
    """Return the length of each recording's stretches, s: a few blocks, or less so that `KIND_LEAST` of a kind fit."""
    wholes_s = [float(t[-1] - t[0]) for t in (trial.channels["measured"].t_s for trial in trials)]
    each_s = share * sum(wholes_s) / (KIND_LEAST * len({trial.kind for trial in trials}))
    least_s = max(each_s, LEAST_BLOCKS * view.block_s)
    usual_s = (max(view.blocks_each * view.block_s, view.blocks_each / 4 * s / PIECES_MOST) for s in wholes_s)
    return [min(usual, least_s) for usual in usual_s]


def _pieces_of_samples(view: RigView, parts: Sequence[Sequence[Trial]]) -> NDArray[np.int64]:
    """Return the number of the stretch of each of a view's samples, [M]; parts: stretches of each trial."""
    found, first = np.empty(len(view.trial), dtype=np.int64), 0
    for span, mine in zip(slices(view.trial), parts, strict=True):
        later = [part.channels["measured"].t_s[0] for part in mine[1:]]
        found[span] = first + np.searchsorted(later, view.t_s[span], side="right")
        first += len(mine)
    return found


def _by_half(found: Array, stretches: Stretches) -> Array:
    """Return information [W, p], or that of each half of the recordings [W, 2 p] where both hold a good share.

    A slow change, such as a motor that tires, shows only in stretches of both halves.
    """
    origins = np.array(stretches.origins)
    middles = np.array([trial.channels["measured"].t_s[[0, -1]].mean() for trial in stretches.trials])
    late = middles > [middles[origins == origin].mean() + 1e-9 for origin in stretches.origins]
    halves = found * ~late[:, None], found * late[:, None]
    least = np.minimum(*(half.sum(axis=0) for half in halves)) / np.maximum(found.sum(axis=0), 1e-12)
    return np.hstack(halves) if np.median(least) > HALF_LEAST else found


def information(view: RigView, known: Sequence[Candidate], number: NDArray[np.int64]) -> Array:
    """Return the information of each stretch about effects and nuisances, [W, p]; number: stretch of each sample [M].

    It is the diagonal of the normal matrix of usual changes, in squares of the noise floor.
    """
    points = [point_of((each,), (each.starts[0],)) for each in known if each.starts]
    points += [dict(each.at(1.0)) for each in nuisances(view)]
    base, found = view.gap([{}])[0], []
    for point in points:
        squares = (np.nan_to_num(view.gap([point])[0] - base) / view.floor) ** 2
        found.append(np.bincount(number, squares.sum(axis=1)).astype(float))
    return np.array(found).T


def most_informative(found: Array, sizes: Array, kinds: Sequence[str], share: float) -> list[int]:
    """Return stretches with a share of all samples that hold the most information, `KIND_LEAST` of each kind at least.

    Each next stretch adds most to the logarithms of the summed information [W, p], per sample [W]; for such a sum the
    greedy choice is close to the best (Nemhauser 1978).
    """
    kept: list[int] = []
    summed, left = np.ones(found.shape[1]), set(range(len(found)))
    while left:
        room = share * sizes.sum() - sizes[kept].sum()
        counts = Counter(kinds[i] for i in kept)
        rare = [i for i in sorted(left) if counts[kinds[i]] < KIND_LEAST]
        fits = rare or [i for i in sorted(left) if sizes[i] <= room]
        if not fits:
            break
        gains = [float(np.log1p(found[i] / summed).sum()) / sizes[i] for i in fits]
        best = fits[int(np.argmax(gains))]
        kept.append(best)
        left.remove(best)
        summed += found[best]
    return sorted(kept)
