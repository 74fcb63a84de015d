"""What a fit is judged on: kinds of excitation that it has not seen, else trials, else stretches of the same trials."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine.result import HeldOut

TRIALS_MOST = 6  # folds of whole trials; neighbours go together, they are alike
STRETCHES = 5  # of one trial, where there is nothing else


def unseen(kinds: Sequence[str], origins: Sequence[int]) -> HeldOut:
    """What can be left out whole. Both by trial of a view: its excitation, and which recording it was cut from."""
    if len(set(kinds)) > 1:
        return "kind"
    return "trial" if len(set(origins)) > 1 else "block"


def folds(blocks: Sequence[tuple[int, int]], kinds: Sequence[str], origins: Sequence[int]) -> NDArray[np.int64]:
    """The fold of each block (trial, number), [B]: a kind, a recording, or a fifth of the only one."""
    how = unseen(kinds, origins)
    if how == "kind":
        place = {kind: i for i, kind in enumerate(sorted(set(kinds)))}
        return np.array([place[kinds[trial]] for trial, _ in blocks])
    if how == "trial":
        names = sorted({origins[trial] for trial, _ in blocks})
        count = min(len(names), TRIALS_MOST)
        return np.array([names.index(origins[trial]) * count // len(names) for trial, _ in blocks])
    return np.array([i * STRETCHES // len(blocks) for i in range(len(blocks))])


def interleaved(blocks: Sequence[tuple[int, int]]) -> NDArray[np.int64]:
    """Every fifth block of each trial a fold, [B]: weaker than what `folds` leaves out, and nothing is extrapolated."""
    return np.array([(trial + number) % STRETCHES for trial, number in blocks])
