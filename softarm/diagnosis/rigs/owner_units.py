"""Conversion of a rig's diagnosis into the units of its table's columns; the diagnosis itself uses standard units."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

from softarm.common.quantity import PURE
from softarm.diagnosis.data.stage_rules import followed
from softarm.diagnosis.data.trials import TableStage, TableUnit, Trial
from softarm.diagnosis.engine.result import Diagnosis, Overlay, Regime
from softarm.schemas.verdict import Estimate, Gap, NamedEffect, Quantity

# Name of the table's unit, and its number of units per standard unit.
Unit = tuple[str, float]
Q = TypeVar("Q", Quantity, Estimate)
D = TypeVar("D", bound=Overlay | Regime)
# Fields in a stage's unit: of a Quantity, Estimate or CalibratedParameter, of an Overlay, of a Regime.
_VALUES = ("nominal", "value", "low", "high", "tolerance_low", "tolerance_high")
_CURVES = ("measured", "nominal", "patched", "calibrated")
_RMS = ("nominal_rms", "patched_rms")
_RATES = ("", "/s", "/s^2", "/s^3")


def in_owners_units(diagnosis: Diagnosis, trials: Sequence[Trial]) -> Diagnosis:
    """Return the diagnosis with gaps, parameters, overlays and regimes of every stage in its table's units."""
    stages = {trial.stage.name: trial.stage for trial in trials if trial.stage is not None}
    units = {name: owners(stage) for name, stage in stages.items()}
    verdict = diagnosis.verdict
    gap = Gap(
        **{
            when: {
                stage: _scaled(each, _own(each.unit, units.get(stage, {})))
                for stage, each in getattr(verdict.gap, when).items()
            }
            for when in Gap.model_fields
        }
    )
    named = tuple(_effect(effect, units.get(effect.name.rpartition(".")[0], {})) for effect in verdict.effects)
    own = {path: _own(unit, _of(path, units)) for path, unit in diagnosis.units.items()}
    calibration = tuple(_scaled(each, own.get(each.name, (each.unit, 1.0))) for each in verdict.calibration)
    best_fit = {
        stage: fit.model_copy(
            update={
                "parameters": {p: _scaled(of, own.get(p, (of.unit, 1.0))) for p, of in fit.parameters.items()},
                "before": _scaled(fit.before, _own(fit.before.unit, units.get(stage, {}))),
                "after": _scaled(fit.after, _own(fit.after.unit, units.get(stage, {}))),
            }
        )
        for stage, fit in verdict.best_fit.items()
    }
    found = {"gap": gap, "effects": named, "calibration": calibration, "best_fit": best_fit}
    return replace(
        diagnosis,
        verdict=verdict.model_copy(update=found),
        overlays=tuple(_converted(each, _CURVES, units) for each in diagnosis.overlays),
        regimes=tuple(_converted(each, _RMS, units) for each in diagnosis.regimes),
        rivals=tuple(replace(rival, parameters=_values(rival.parameters, own)) for rival in diagnosis.rivals),
        units={path: unit for path, (unit, _) in own.items()},
    )


def owners(stage: TableStage) -> dict[str, Unit]:
    """Return the table's unit for each standard unit of a stage; the compared column takes precedence."""
    found: dict[str, Unit] = {}
    for own in _columns(stage):
        if own.standard == PURE:  # only the column itself is in per cent, no parameter
            continue
        for standard, name in _rates(own):
            found.setdefault(standard, (name, 1 / own.factor))
    return found


def _rates(own: TableUnit) -> list[tuple[str, str]]:
    """A unit and its time derivatives, standard and in the table: (m/s, mm/s), (m/s^2, mm/s^2), ..."""
    if not own.standard.endswith("/s"):
        return [(own.standard + rate, own.name + rate) for rate in _RATES]
    standard, base = own.standard.removesuffix("/s"), own.name.removesuffix("/s")
    first = 1 if base != own.name else 0  # rpm is a rate by itself
    return [(standard + rate, base + _RATES[first + i]) for i, rate in enumerate(_RATES[1:])]


def _columns(stage: TableStage) -> list[TableUnit]:
    """Units of a stage's columns, the compared column's first."""
    measured = stage.units.get("measured", {})
    first = followed(measured) if stage.kind == "tracking" else next(iter(measured), None)
    ordered = [measured[first]] if first else []
    ordered += [own for name, own in measured.items() if name not in (first, "effort")]
    return ordered + [
        own for channel, columns in stage.units.items() if channel != "measured" for own in columns.values()
    ]


def _of(path: str, units: Mapping[str, Mapping[str, Unit]]) -> Mapping[str, Unit]:
    return units.get(path.rsplit(".", 2)[0], {})


def _own(unit: str, known: Mapping[str, Unit]) -> Unit:
    """Table's unit for a standard unit, or the standard unit if no column has it."""
    return known.get(unit, (unit, 1.0))


def _values(of: Mapping[str, float], own: Mapping[str, Unit]) -> dict[str, float]:
    return {path: value * own.get(path, ("", 1.0))[1] for path, value in of.items()}


def _scaled(of: Q, own: Unit) -> Q:
    unit, worth = own
    values = {name: getattr(of, name) * worth for name in _VALUES if name in type(of).model_fields}
    return of.model_copy(update={**values, "unit": unit})


def _effect(effect: NamedEffect, known: Mapping[str, Unit]) -> NamedEffect:
    parameters = {name: _scaled(of, _own(of.unit, known)) for name, of in effect.parameters.items()}
    return effect.model_copy(update={"parameters": parameters})


def _converted(of: D, fields: Sequence[str], units: Mapping[str, Mapping[str, Unit]]) -> D:
    unit, worth = _own(of.unit, units.get(of.stage, {}))
    values = {name: value * worth for name in fields if (value := getattr(of, name)) is not None}
    return replace(of, unit=unit, **values)
