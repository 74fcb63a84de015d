"""Assembly of a diagnosis from the answers on its stages."""

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from softarm.diagnosis.data.trials import Trial
from softarm.diagnosis.engine.decision import Kind
from softarm.diagnosis.engine.result import Diagnosis, HeldOut, Overlay, Regime, Rival, Spectrum, Unexplained
from softarm.schemas.model import Model
from softarm.schemas.verdict import (
    CalibratedParameter,
    Gap,
    Interval,
    NamedEffect,
    NextExperiment,
    Quantity,
    Verdict,
    Where,
)
from softarm.simulator.effects import Effect


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


@dataclass(frozen=True, slots=True)
class Answer:
    """Answer on all stages of a system, before the verdict is written."""

    kind: Kind
    where: Where
    effects: tuple[NamedEffect, ...]
    stages: tuple[StageAnswer, ...]
    rivals: tuple[Rival, ...]
    margins: Mapping[str, float]
    calibration: tuple[CalibratedParameter, ...]
    held_out: HeldOut
    next_experiment: NextExperiment | None
    warnings: tuple[str, ...]
    units: Mapping[str, str] = field(default_factory=dict)
    vocabulary: Mapping[str, Effect] = field(default_factory=dict)
    equal_sets: tuple[tuple[str, ...], ...] = ()


def assemble(
    answer: Answer,
    trials: Sequence[Trial],
    started: float,
    nominal: Model | None = None,
    patched: Model | None = None,
    calibrated: Model | None = None,
) -> Diagnosis:
    """Return the diagnosis with its verdict.

    Args:
        answer: answer on all stages.
        trials: trials that were compared.
        started: `time.monotonic()` at the start of the diagnosis.
        nominal: nominal model of the robot; None for a rig.
        patched: nominal model with the named effects; None without any.
        calibrated: nominal model with the named effects and the calibration; None without either.
    """
    stages = answer.stages
    verdict = Verdict(
        verdict=answer.kind,
        where=answer.where,
        effects=answer.effects,
        equal_sets=answer.equal_sets,
        calibration=answer.calibration,
        gap=gap_of(stages),
        next_experiment=answer.next_experiment,
        warnings=tuple(dict.fromkeys(answer.warnings)),
    )
    return Diagnosis(
        verdict=verdict,
        nominal=nominal,
        patched=patched,
        calibrated=calibrated,
        trials=tuple((t.name, t.kind, t.duration_s) for t in trials),
        overlays=tuple(overlay for each in stages for overlay in each.overlays),
        spectra=tuple(each.spectrum for each in stages if each.spectrum is not None),
        regimes=tuple(regime for each in stages for regime in each.regimes),
        rivals=answer.rivals,
        unexplained=tuple(each.unexplained for each in stages if each.unexplained is not None),
        units=answer.units,
        seconds=time.monotonic() - started,
        total_shrink={each.stage: each.total_shrink for each in stages if each.total_shrink is not None},
        held_out=answer.held_out,
        margins=answer.margins,
        vocabulary=answer.vocabulary,
    )


def gap_of(stages: Iterable[StageAnswer]) -> Gap:
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
