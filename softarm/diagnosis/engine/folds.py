"""Folds of held-out data: kinds of excitation, else trials, else stretches of one trial."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine.result import HeldOut

TRIALS_MOST = 6  # largest number of folds of whole trials; neighbouring trials share a fold
STRETCHES = 5  # folds of a single trial


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
