"""The overlays of a diagnosis as what the plot of recordings draws."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine.result import Diagnosis, Overlay
from softarm.pages import plot

Array = NDArray[np.float64]

CHOICES = ("stage", "trial", "channel")


def traces(diagnosis: Diagnosis) -> list[plot.Traces]:
    """Measured, nominal and patched of every stage, trial and channel; beneath them the stage's floor as a band."""
    return [_traces(overlay, diagnosis) for overlay in diagnosis.overlays]


def packed(diagnosis: Diagnosis) -> dict[str, object]:
    """The same as the page's data."""
    shown_first = first(diagnosis.overlays, diagnosis.verdict.where.stage)
    return plot.packed(CHOICES, traces(diagnosis), shown_first)


def first(overlays: Sequence[Overlay], stage: str | None) -> int:
    """Index of the overlay to show first: of the blamed stage, the largest gap against the channel's own spread."""
    spread: dict[tuple[str, str], float] = {}
    for overlay in overlays:
        key = overlay.stage, overlay.channel
        spread[key] = max(spread.get(key, 0.0), _rms(overlay.measured - _mean(overlay.measured)))

    def gap(index: int) -> tuple[bool, float]:
        overlay = overlays[index]
        widest = spread[overlay.stage, overlay.channel]
        return overlay.stage == stage, _rms(overlay.measured - overlay.nominal) / widest if widest > 0 else 0.0

    return max(range(len(overlays)), key=gap, default=0)


def _traces(overlay: Overlay, diagnosis: Diagnosis) -> plot.Traces:
    curves = {"measured": overlay.measured, "nominal": overlay.nominal}
    if overlay.patched is not None:
        curves["patched"] = overlay.patched
    floor = diagnosis.verdict.gap.floor.get(overlay.stage)
    band = floor.value if floor is not None and floor.unit == overlay.unit else 0.0
    chosen = (overlay.stage, overlay.trial, overlay.channel)
    return plot.Traces(chosen, overlay.kind, overlay.unit, overlay.t_s, curves, band)


def _mean(values: Array) -> float:
    seen = values[np.isfinite(values)]
    return float(seen.mean()) if len(seen) else 0.0


def _rms(values: Array) -> float:
    return math.sqrt(_mean(values**2))
