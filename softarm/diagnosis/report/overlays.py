"""Overlays of a diagnosis, packed for the plot of recordings."""

import math

import numpy as np

from softarm.diagnosis.engine.result import Diagnosis, Overlay
from softarm.diagnosis.engine.view import Array
from softarm.reporting import plot

CHOICES = ("stage", "trial", "channel")
_WINDOW_S = 2.0


def traces(diagnosis: Diagnosis) -> list[plot.Traces]:
    """Return the measured and simulated curves of every stage, trial and channel, with the noise floor."""
    found = []
    for each in diagnosis.overlays:
        curves = {"measured": each.measured, "nominal": each.nominal}
        curves |= {"patched": each.patched} if each.patched is not None else {}
        curves |= {"calibrated": each.calibrated} if each.calibrated is not None else {}
        chosen, floor = (each.stage, each.trial, each.channel), _floor(diagnosis, each)
        found.append(plot.Traces(chosen, each.kind, each.unit, each.t_s, curves, floor))
    return found


def packed(diagnosis: Diagnosis) -> dict[str, object]:
    """Return the page's plot data, opened at the largest gap."""
    at = first(diagnosis)
    view = window(diagnosis.overlays[at]) if diagnosis.overlays else None
    return plot.packed(CHOICES, traces(diagnosis), at, view)


def first(diagnosis: Diagnosis) -> int:
    """Return the index of the overlay to show first.

    It is the largest gap of the diagnosed stage in noise floors. Without a diagnosed stage it is the signal that moves
    most, since gaps are noise.
    """
    stage, overlays = diagnosis.verdict.where.stage, diagnosis.overlays

    def rank(index: int) -> tuple[bool, float]:
        overlay = overlays[index]
        shown = overlay.measured - (_mean(overlay.measured) if stage is None else overlay.nominal)
        return overlay.stage == stage, _rms(shown) / _floor(diagnosis, overlay)

    return max(range(len(overlays)), key=rank, default=0)


def window(overlay: Overlay) -> tuple[float, float] | None:
    """Return the start and end of the two seconds with the largest gap, s, or None for a shorter trial."""
    t_s, gap = overlay.t_s, np.nan_to_num(overlay.measured - overlay.nominal) ** 2
    if len(t_s) < 2 or t_s[-1] - t_s[0] <= _WINDOW_S:
        return None
    summed = np.concatenate(([0.0], np.cumsum(gap)))
    ends = np.searchsorted(t_s, t_s + _WINDOW_S, side="right")
    start = int(np.argmax((summed[ends] - summed[:-1]) * (t_s + _WINDOW_S <= t_s[-1])))
    return float(t_s[start]), float(t_s[start] + _WINDOW_S)


def _floor(diagnosis: Diagnosis, overlay: Overlay) -> float:
    return diagnosis.verdict.gap.floor[overlay.stage].value


def _mean(values: Array) -> float:
    seen = values[np.isfinite(values)]
    return float(seen.mean()) if len(seen) else 0.0


def _rms(values: Array) -> float:
    return math.sqrt(_mean(values**2))
