"""Place of the largest gap: the signal and the two seconds that a reader sees first."""

import math

import numpy as np

from softarm.diagnosis.engine.result import Diagnosis, Overlay
from softarm.diagnosis.engine.view import Array

WINDOW_S = 2.0


def worst(diagnosis: Diagnosis) -> int:
    """Return the index of the overlay to show first.

    It is the largest gap of the diagnosed stage in noise floors. Without a diagnosed stage it is the signal that moves
    most, since gaps are noise.
    """
    stage, overlays = diagnosis.verdict.where.stage, diagnosis.overlays

    def rank(index: int) -> tuple[bool, float]:
        overlay = overlays[index]
        shown = overlay.measured - (_mean(overlay.measured) if stage is None else overlay.nominal)
        return overlay.stage == stage, math.sqrt(_mean(shown**2)) / diagnosis.verdict.gap.floor[overlay.stage].value

    return max(range(len(overlays)), key=rank, default=0)


def window(overlay: Overlay) -> tuple[float, float] | None:
    """Return the start and end of the two seconds with the largest gap, s, or None for a shorter trial."""
    t_s, gap = overlay.t_s, np.nan_to_num(overlay.measured - overlay.nominal) ** 2
    if len(t_s) < 2 or t_s[-1] - t_s[0] <= WINDOW_S:
        return None
    summed = np.concatenate(([0.0], np.cumsum(gap)))
    ends = np.searchsorted(t_s, t_s + WINDOW_S, side="right")
    start = int(np.argmax((summed[ends] - summed[:-1]) * (t_s + WINDOW_S <= t_s[-1])))
    return float(t_s[start]), float(t_s[start] + WINDOW_S)


def _mean(values: Array) -> float:
    seen = values[np.isfinite(values)]
    return float(seen.mean()) if len(seen) else 0.0
