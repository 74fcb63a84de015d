"""Data model of verdict.json. `python -m softarm.schemas.verdict` prints its JSON Schema."""

import math
from typing import Annotated, Any, Final, Literal

from pydantic import AfterValidator, BeforeValidator, Field, PlainSerializer, WithJsonSchema, model_validator

from softarm.schemas.base import Strict

FORMAT: Final = 1

Share = Annotated[float, Field(ge=0, le=1)]


def _not_nan(x: float) -> float:
    if math.isnan(x):
        raise ValueError("the number is nan; give a finite or an infinite one")
    return x


def _open(end: float) -> tuple[Any, ...]:
    """Return the annotations of a number that may be infinite; null in JSON stands for `end`."""
    return (
        Field(allow_inf_nan=True),
        BeforeValidator(lambda x: end if x is None else x),
        AfterValidator(_not_nan),
        PlainSerializer(lambda x: x if math.isfinite(x) else None, when_used="json"),
        WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "null"}]}),
    )


OpenAbove = Annotated[float, *_open(math.inf)]
OpenBelow = Annotated[float, *_open(-math.inf)]


class Interval(Strict):
    """An estimate with its 95 % interval."""

    value: float
    low: float
    high: float


class Estimate(Interval):
    """A parameter of an effect, in the registry's unit, or for a rig in the unit of its columns.

    A bound is null if the data do not bound the parameter; the value is null for a limit that is absent.
    """

    value: OpenAbove
    low: OpenBelow
    high: OpenAbove
    unit: str


class Quantity(Strict):
    """A root mean square with its unit."""

    value: float
    unit: str


class Shrink(Strict):
    """Reduction of the held-out gap when the effect is added to the other named effects, as a share."""

    stage: Interval
    chain: Interval | None = None  # of the tip from commands alone; None if the chain cannot be simulated


class NamedEffect(Strict):
    """An effect that the simulator lacks, or has and the robot does not."""

    name: str  # stage.effect
    parameters: dict[str, Estimate]  # empty for an effect that is on or off
    # Share of correct answers of this kind on cases of known cause; None without such cases.
    confidence: Share | None = None
    equivalents: tuple[str, ...] = ()  # indistinguishable on this data
    shared_by: tuple[str, ...] = ()  # stages that show it in this size, as one cause; each has an entry
    shrink: Shrink


class CalibratedParameter(Estimate):
    """A parameter that the nominal model has, fitted within its tolerance; of a single joint its relative change."""

    name: str  # stage.effect.parameter, or arm.KEY[JOINT]
    nominal: float
    tolerance_low: float  # ends of the tolerance
    tolerance_high: float
    at_edge: bool = False  # at an end of the tolerance, so that the true value may lie beyond
    shrink: float  # share of its stage's held-out RMS that it takes next to all others


class BestFit(Strict):
    """The effects that predict a stage best, where the named ones leave more of its gap.

    A model for simulation, no diagnosis: their sizes differ between recordings, or stand for a cause that no effect
    expresses.
    """

    parameters: dict[str, Quantity]  # stage.effect.parameter, calibrated ones included
    before: Quantity  # root mean square of the gap when whole recordings are simulated
    after: Quantity  # the same with the parameters, held out


class Where(Strict):
    """Location of the gap in the causal chain; the stage is None without a gap."""

    stage: str | None
    share: dict[str, Share]  # stage -> share of the gap
    regime: str  # in words: when and in which band


class Gap(Strict):
    """Root mean squares of each stage driven by measured inputs, and of the tip for the whole `chain`."""

    before: dict[str, Quantity]
    after: dict[str, Quantity]  # with the named effects added; held out
    # With the named effects and the calibration; held out.
    calibrated: dict[str, Quantity] = Field(default_factory=dict)
    # Noise floor: repeatability, sensor noise, and the effect of deviations within tolerance on these recordings.
    floor: dict[str, Quantity]
    ceiling: dict[str, Quantity]  # gap that a flexible black-box model leaves


class Task(Strict):
    """Success shares of a policy; None if unknown."""

    success_real: Share | None = None
    success_nominal: Share | None = None
    success_patched: Share | None = None


class NextExperiment(Strict):
    """Excitation that separates indistinguishable effects; run it with `softarm excite --plan verdict.json`."""

    excitation: str  # a name of schemas.excitation.EXCITATIONS
    separates: tuple[str, ...]
    expect: dict[str, str]  # effect -> the observation if it is the cause


class Verdict(Strict):
    """The complete result of a diagnosis."""

    format: Literal[1] = 1
    verdict: Literal["named", "incomplete", "unknown", "none"]
    where: Where
    effects: tuple[NamedEffect, ...] = ()  # ordered by what each adds to the others
    # Other sets of effects that explain the recordings as well as the named effects of their stages.
    equal_sets: tuple[tuple[str, ...], ...] = ()
    calibration: tuple[CalibratedParameter, ...] = ()  # what takes most of the gap first
    best_fit: dict[str, BestFit] = Field(default_factory=dict)  # by stage
    creeping: tuple[str, ...] = ()  # stages whose dry friction creeps as in a simulation, where real friction holds
    gap: Gap
    task: Task | None = None
    next_experiment: NextExperiment | None = None
    warnings: tuple[str, ...] = ()

    @property
    def causes(self) -> tuple[NamedEffect, ...]:
        """The named effects; of one that several stages share, the entry of the first stage only."""
        first = {(e.name.rpartition(".")[2], e.shared_by): e for e in reversed(self.effects)}
        return tuple(e for e in self.effects if not e.shared_by or e is first[e.name.rpartition(".")[2], e.shared_by])

    def findings(self, calibration: bool, best_fit: bool = False) -> dict[str, tuple[float, str]]:
        """Return the findings as a model has them: stage.effect.parameter -> value and unit.

        Args:
            calibration: whether calibrated parameters are included.
            best_fit: whether a stage with a best fit has that instead of its names and calibration.
        """
        found = {each.name: (each.value, each.unit) for each in self.calibration if calibration}
        for effect in self.effects:
            found |= {f"{effect.name}.{name}": (of.value, of.unit) for name, of in effect.parameters.items()}
        if best_fit:
            for stage, fit in self.best_fit.items():
                found = {path: of for path, of in found.items() if not path.startswith(f"{stage}.")}
                found |= {path: (of.value, of.unit) for path, of in fit.parameters.items()}
        return found

    @model_validator(mode="before")
    @classmethod
    def _check_format(cls, content: object) -> object:
        format_ = content.get("format", FORMAT) if isinstance(content, dict) else FORMAT
        if isinstance(format_, int) and format_ > FORMAT:
            raise ValueError(f"verdict of format {format_}; this software reads format {FORMAT}: update it")
        return content


if __name__ == "__main__":
    import json

    print(json.dumps(Verdict.model_json_schema(), indent=1))
