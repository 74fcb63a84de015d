"""Overlays of a diagnosis, packed for the plot of recordings."""

from softarm.diagnosis.answer.worst import window, worst
from softarm.diagnosis.engine.result import Diagnosis, Overlay
from softarm.reporting import plot

CHOICES = ("stage", "trial", "channel")


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
    at = worst(diagnosis)
    view = window(diagnosis.overlays[at]) if diagnosis.overlays else None
    return plot.packed(CHOICES, traces(diagnosis), at, view)


def _floor(diagnosis: Diagnosis, overlay: Overlay) -> float:
    return diagnosis.verdict.gap.floor[overlay.stage].value
