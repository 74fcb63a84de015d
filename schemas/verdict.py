"""verdict.json: what a diagnosis says. The JSON Schema is printed by `python -m softarm.schemas.verdict`."""

from typing import Annotated, Final, Literal

from pydantic import Field, model_validator

from softarm.schemas.base import Strict

FORMAT: Final = 1

Share = Annotated[float, Field(ge=0, le=1)]


class Interval(Strict):
    """An estimate with its 95 % interval."""

    value: float
    low: float
    high: float


class Estimate(Interval):
    """A parameter of an effect, in the registry's unit; of another rig in the unit of its owner's columns."""

    unit: str


class Quantity(Strict):
    """A root mean square."""

    value: float
    unit: str


class Shrink(Strict):
    """The share of the gap that goes once the effect is added to the others; held out, conditional."""

    stage: Interval
    chain: Interval | None = None  # of the tip from commands alone; None where the chain cannot be simulated


class NamedEffect(Strict):
    """An effect that the simulator lacks, or has and the robot does not."""

    name: str  # stage.effect
    parameters: dict[str, Estimate]  # empty for an effect that is on or off
    # How often such an answer was right, on cases of known cause; None where no such cases stand behind it.
    confidence: Share | None = None
    equivalents: tuple[str, ...] = ()  # cannot be told apart on this data
    shrink: Shrink


class Where(Strict):
    """Where in the causal chain the gap arises; None when there is none."""

    stage: str | None
    share: dict[str, Share]  # stage -> share of the gap
    regime: str  # in words: when and in which band


class Gap(Strict):
    """Root mean squares by stage, each driven by what was measured upstream, and of the tip for the whole `chain`."""

    before: dict[str, Quantity]
    after: dict[str, Quantity]  # with the named effects added; held out
    # What no simulator is blamed for: repeats, noise, and what deviations within tolerance make on these recordings.
    floor: dict[str, Quantity]
    ceiling: dict[str, Quantity]  # with any model at all: what a flexible one leaves


class Task(Strict):
    """Success shares of a policy; what logs or simulators cannot tell is None."""

    success_real: Share | None = None
    success_nominal: Share | None = None
    success_patched: Share | None = None


class NextExperiment(Strict):
    """The excitation that would tell apart what this data cannot: run it by `softarm excite --plan verdict.json`."""

    excitation: str  # a name of schemas.excitation.EXCITATIONS
    separates: tuple[str, ...]
    expect: dict[str, str]  # effect -> what one would see if it is the cause


class Verdict(Strict):
    """The answer, whole."""

    format: Literal[1] = 1
    verdict: Literal["named", "incomplete", "unknown", "none"]
    where: Where
    effects: tuple[NamedEffect, ...] = ()  # in order of what each adds given the others
    gap: Gap
    task: Task | None = None
    next_experiment: NextExperiment | None = None
    warnings: tuple[str, ...] = ()

    @model_validator(mode="before")
    @classmethod
    def _not_newer(cls, content: object) -> object:
        format_ = content.get("format", FORMAT) if isinstance(content, dict) else FORMAT
        if isinstance(format_, int) and format_ > FORMAT:
            raise ValueError(f"a verdict of format {format_}; this software reads format {FORMAT}: update it")
        return content


if __name__ == "__main__":
    import json

    print(json.dumps(Verdict.model_json_schema(), indent=1))
