"""Assembly of a diagnosis from the answers on its stages."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

from softarm.diagnosis.data.trials import Trial
from softarm.diagnosis.engine.result import Diagnosis, Overlay, Regime, Spectrum, Unexplained
from softarm.schemas.verdict import Gap, Interval, Quantity, Verdict


@dataclass(frozen=True, slots=True)
class StageAnswer:
    """Gap of one stage, in `unit`, with its evidence."""

    stage: str
    unit: str
    before: float  # RMS of the nominal model
    after: float  # RMS with the named effects, held out
    floor: float  # RMS of the noise floor
    calibrated: float | None  # RMS with the named effects and the calibration, held out; None if it has no meaning
    ceiling: float | None  # RMS that a flexible model leaves; None if it was not fitted
    overlays: tuple[Overlay, ...] = ()
    spectrum: Spectrum | None = None
    regimes: tuple[Regime, ...] = ()
    unexplained: Unexplained | None = None
    total_shrink: Interval | None = None  # share of the RMS that all named effects remove


def assemble(verdict: Verdict, stages: Sequence[StageAnswer], trials: Sequence[Trial], started: float) -> Diagnosis:
    """Return a diagnosis with the evidence on its stages; started: `time.monotonic()` at its start."""
    return Diagnosis(
        verdict=verdict,
        trials=tuple((t.name, t.kind, t.duration_s) for t in trials),
        overlays=tuple(overlay for each in stages for overlay in each.overlays),
        spectra=tuple(each.spectrum for each in stages if each.spectrum is not None),
        regimes=tuple(regime for each in stages for regime in each.regimes),
        unexplained=tuple(each.unexplained for each in stages if each.unexplained is not None),
        seconds=time.monotonic() - started,
        total_shrink={each.stage: each.total_shrink for each in stages if each.total_shrink is not None},
    )


def gap_of(stages: Sequence[StageAnswer]) -> Gap:
    """Return the gap of a verdict by stage."""
    found: dict[str, dict[str, Quantity]] = {when: {} for when in Gap.model_fields}
    for each in stages:
        for when, quantities in found.items():
            if (value := getattr(each, when)) is not None:
                quantities[each.stage] = Quantity(value=value, unit=each.unit)
    return Gap(**found)


def share(value: float, low: float, high: float) -> Interval:
    """Return an interval that includes its value."""
    return Interval(value=value, low=min(low, value), high=max(high, value))
