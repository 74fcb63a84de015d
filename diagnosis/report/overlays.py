"""Overlays as compact data for the page's own plotter (page.js): 16 bits a sample, stamps as start and step."""

import base64
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.gap.result import Diagnosis, Overlay

Array = NDArray[np.float64]

# Samples of a page over all its curves: about 10 MB. Beyond it every k-th sample is shown, and the page says so.
BUDGET = 3_000_000
_STEPS = 65534  # the level after the last one is NaN
_UNIFORM_S = 1e-6


def every(overlays: Sequence[Overlay]) -> int:
    """Of how many samples one is on the page."""
    total = sum(len(o.t_s) * (2 if o.patched is None else 3) for o in overlays)
    return max(1, math.ceil(total / BUDGET))


def packed(diagnosis: Diagnosis) -> dict[str, object]:
    """What page.js reads: the overlays, which one to show first, and the floors of the stages."""
    step = every(diagnosis.overlays)
    return {
        "first": first(diagnosis.overlays, diagnosis.verdict.where.stage),
        "floors": {stage: floor.model_dump() for stage, floor in diagnosis.verdict.gap.floor.items()},
        "items": [_item(overlay, step) for overlay in diagnosis.overlays],
    }


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


def _mean(values: Array) -> float:
    seen = values[np.isfinite(values)]
    return float(seen.mean()) if len(seen) else 0.0


def _rms(values: Array) -> float:
    return math.sqrt(_mean(values**2))


def _item(overlay: Overlay, step: int) -> dict[str, object]:
    return {
        "stage": overlay.stage,
        "trial": overlay.trial,
        "kind": overlay.kind,
        "channel": overlay.channel,
        "unit": overlay.unit,
        "t": _stamps(overlay.t_s[::step]),
        "measured": _levels(overlay.measured[::step]),
        "nominal": _levels(overlay.nominal[::step]),
        "patched": None if overlay.patched is None else _levels(overlay.patched[::step]),
    }


def _stamps(t_s: Array) -> dict[str, object]:
    """Start, step and count of uniform stamps; microseconds since the start of others."""
    n = len(t_s)
    start, step = (float(t_s[0]) if n else 0.0), (float(t_s[-1] - t_s[0]) / (n - 1) if n > 1 else 0.0)
    about: dict[str, object] = {"n": n, "start": round(start, 6)}
    if n < 2 or np.abs(t_s - (start + step * np.arange(n))).max() < _UNIFORM_S:
        return about | {"step": step}
    return about | {"us": _text(np.round((t_s - start) * 1e6).astype("<u4"))}


def _levels(values: Array) -> dict[str, object]:
    """Values as 16-bit levels between their own extremes; what is not finite is the last level."""
    seen = np.isfinite(values)
    low, high = (float(values[seen].min()), float(values[seen].max())) if seen.any() else (0.0, 0.0)
    scale = _STEPS / (high - low) if high > low else 0.0
    levels = np.full(len(values), _STEPS + 1, dtype="<u2")
    levels[seen] = np.round((values[seen] - low) * scale).astype("<u2")
    return {"low": low, "high": high, "levels": _text(levels)}


def _text(values: NDArray[np.unsignedinteger]) -> str:
    return base64.b64encode(values.tobytes()).decode("ascii")
