"""Overlays of a diagnosis, packed for the plot of recordings."""

import math

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine.result import Diagnosis, Overlay
from softarm.reporting import plot

Array = NDArray[np.float64]

CHOICES = ("stage", "trial", "channel")
_AT_ONCE, _WINDOW = 2000, 600  # samples: of a trial that is seen whole, and of the part of a longer one


def traces(diagnosis: Diagnosis) -> list[plot.Traces]:
    """Return measured, nominal and patched curves of every stage, trial and channel, with the noise floor."""
    return [_traces(overlay, diagnosis) for overlay in diagnosis.overlays]


def packed(diagnosis: Diagnosis) -> dict[str, object]:
    """Return the page's plot data, opened at the largest gap."""
    at = first(diagnosis)
    view = window(diagnosis.overlays[at]) if diagnosis.overlays else None
    return plot.packed(CHOICES, traces(diagnosis), at, view)


def first(diagnosis: Diagnosis) -> int:
    """Return the index of the overlay to show first.

    It is the largest gap of the diagnosed stage in noise floors. Without a diagnosed stage it is the signal that moves
    most, since gaps are noise. Without a floor, the channel's own spread replaces it.
    """
    stage, overlays = diagnosis.verdict.where.stage, diagnosis.overlays
    spread: dict[tuple[str, str], float] = {}
    for overlay in overlays:
        key = overlay.stage, overlay.channel
        spread[key] = max(spread.get(key, 0.0), _rms(overlay.measured - _mean(overlay.measured)))

    def rank(index: int) -> tuple[bool, float]:
        overlay = overlays[index]
        shown = overlay.measured - (_mean(overlay.measured) if stage is None else overlay.nominal)
        count = _floor(diagnosis, overlay) or spread[overlay.stage, overlay.channel]
        return overlay.stage == stage, _rms(shown) / count if count > 0 else 0.0

    return max(range(len(overlays)), key=rank, default=0)


def window(overlay: Overlay) -> tuple[float, float] | None:
    """Return the start and end of the largest gap, s, or None if the trial fits the plot."""
    n, gap = len(overlay.t_s), np.nan_to_num(overlay.measured - overlay.nominal) ** 2
    if n <= _AT_ONCE:
        return None
    summed = np.concatenate(([0.0], np.cumsum(gap)))
    start = int(np.argmax(summed[_WINDOW:] - summed[:-_WINDOW]))
    return float(overlay.t_s[start]), float(overlay.t_s[start + _WINDOW - 1])


def _floor(diagnosis: Diagnosis, overlay: Overlay) -> float:
    """Return the stage's noise floor in the overlay's unit, or 0 if unknown."""
    floor = diagnosis.verdict.gap.floor.get(overlay.stage)
    return floor.value if floor is not None and floor.unit == overlay.unit else 0.0


def _traces(overlay: Overlay, diagnosis: Diagnosis) -> plot.Traces:
    curves = {"measured": overlay.measured, "nominal": overlay.nominal}
    if overlay.patched is not None:
        curves["patched"] = overlay.patched
    chosen = (overlay.stage, overlay.trial, overlay.channel)
    return plot.Traces(chosen, overlay.kind, overlay.unit, overlay.t_s, curves, _floor(diagnosis, overlay))


def _mean(values: Array) -> float:
    seen = values[np.isfinite(values)]
    return float(seen.mean()) if len(seen) else 0.0


def _rms(values: Array) -> float:
    return math.sqrt(_mean(values**2))
