"""Stretches of long recordings that hold the most information, so that a diagnosis keeps its budget.

The budget is in seconds of processor time of the computer on which each view's `step_cost_s` was measured, and the
plan counts rollouts: the same data and budget give the same stretches, and the same answer, on any machine.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from softarm.diagnosis.data.trials import Trial
from softarm.diagnosis.engine import work
from softarm.diagnosis.engine.candidates import Candidate, point_of
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.engine.whitened import slices
from softarm.diagnosis.rigs.candidates import candidates, nuisances
from softarm.diagnosis.rigs.grid import windows
from softarm.diagnosis.rigs.views import RigView

# Largest number of stretches that a recording is cut into, for stretches of four blocks.
PIECES_MOST = 8
# Share of the budget that a search uses by plan; searches took 0.7 to 1.3 times their plan.
PLANNED = 0.75
# Stretches of each kind of excitation that are used at least.
KIND_LEAST = 2


@dataclass(frozen=True, slots=True)
class Stretches:
    """Stretches of a stage's recordings, and the recording that each was cut from."""

    trials: tuple[Trial, ...]
    origins: tuple[int, ...]

    def cut_into(self, parts: Iterable[tuple[Trial, ...]]) -> "Stretches":
        """Return the parts of every stretch as stretches."""
        pairs = [(part, k) for k, mine in zip(self.origins, parts, strict=True) for part in mine]
        return Stretches(tuple(part for part, _ in pairs), tuple(k for _, k in pairs))

    def part(self, kept: Sequence[int]) -> "Stretches":
        """Return some of the stretches, in their order."""
        return Stretches(tuple(self.trials[i] for i in kept), tuple(self.origins[i] for i in kept))


def within(
    budget_s: float, view: RigView, stretches: Stretches, build: Callable[[Sequence[Trial]], RigView]
) -> tuple[Stretches, str] | None:
    """Return the most informative stretches of a view's trials, and a note about them; None if all fit the budget."""
    known = candidates(view)
    share = PLANNED * budget_s / planned_s(view, known)
    if share >= 1:
        return None
    if not view.fits_starts:
        stretches = stretches.cut_into(cut(trial, view.block_s, view.blocks_each) for trial in stretches.trials)
        view = build(stretches.trials)
    sizes = np.bincount(view.trial, minlength=len(stretches.trials)).astype(float)
    kept = most_informative(information(view, known), sizes, [trial.kind for trial in stretches.trials], share)
    note = (
        f"{view.stage}: to keep its budget of {budget_s:.3g} s, the diagnosis uses the {len(kept)} most informative of "
        f"{len(sizes)} stretches, {sizes[kept].sum() / sizes.sum():.0%} of the samples; --budget sets another"
    )
    return stretches.part(kept), note


def planned_s(view: RigView, known: Sequence[Candidate]) -> float:
    """Return the planned processor time of a search on a view, s."""
    parameters = sum(len(each.parameters) for each in known)
    return work.backward(len(known), parameters) * view.rollout_s


def cut(trial: Trial, block_s: float, blocks: int) -> tuple[Trial, ...]:
    """Cut a recording into stretches of a few blocks; each keeps the whole input, whose past acts on it."""
    t = trial.channels["measured"].t_s
    parts = windows(trial, max(blocks * block_s, blocks / 4 * float(t[-1] - t[0]) / PIECES_MOST))
    return tuple(replace(part, channels={**trial.channels, "measured": part.channels["measured"]}) for part in parts)


def information(view: RigView, known: Sequence[Candidate]) -> Array:
    """Return the information of each of a view's trials about effects and nuisances, [W, p].

    It is the diagonal of the normal matrix of usual changes, in squares of the noise floor.
    """
    points = [point_of((each,), (each.starts[0],)) for each in known if each.starts]
    points += [dict(each.point) for each in nuisances(view)]
    base, parts, found = view.gap([{}])[0], slices(view.trial), []
    for point in points:
        squares = (np.nan_to_num(view.gap([point])[0] - base) / view.floor) ** 2
        found.append([float(squares[part].sum()) for part in parts])
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
