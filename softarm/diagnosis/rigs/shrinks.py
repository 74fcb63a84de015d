"""Held-out shrink of a rig's gap."""

from collections.abc import Sequence

import numpy as np

from softarm.diagnosis.answer.assembly import share
from softarm.diagnosis.engine import shrink
from softarm.diagnosis.engine.view import Array
from softarm.schemas.verdict import Interval


def by_recording(losses: Array, blocks: Sequence[tuple[int, int]], origins: Sequence[int]) -> Array:
    """Sum losses of blocks [B] by recording [K]; with only one recording, return them by block.

    Args:
        losses: held-out losses of the blocks.
        blocks: window and number of each block.
        origins: recording that each window was cut from.
    """
    if len(set(origins)) < 2:
        return np.maximum(losses, 0.0)
    squares = np.zeros(max(origins) + 1)
    for (window, _), loss in zip(blocks, losses, strict=True):
        squares[origins[window]] += max(float(loss), 0.0)
    return squares


def shrunk(less: Array, more: Array) -> Interval:
    """Return the share of the RMS that an effect removes, with an interval that also covers other kinds of motion.

    Args:
        less: held-out losses by recording without the effect.
        more: held-out losses by recording with the effect.
    """
    return share(*shrink.interval(less, more))
