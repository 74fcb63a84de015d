"""Table of every effect in docs/reference/effects.md; `python -m softarm.simulator.effects_page` prints it."""

import math
from collections.abc import Iterator

from softarm.schemas.model import seed_effects
from softarm.simulator.effect_table import RIVALS
from softarm.simulator.effects import REGISTRY, STAGES, Effect, Parameter

_STAGES = {
    "pressure": "From the pressure command to the muscle's pressure and its reading.",
    "rail": "From the velocity command to the cart's motion.",
    "arm": "From pressure and cart motion to the links' motion.",
    "mocap": "From motion to measured poses.",
    "observation": "From measurements to the observation of the policy.",
    "clock": "Timing, next to the other stages.",
    "contact": "The shelf's surface; in the shelf task only.",
}


def markdown() -> str:
    """Return every effect with its parameters, and the pairs of similar effects."""
    seed = ", ".join(f"`{name}`" for name in seed_effects())
    stages = (line for stage in STAGES for line in _stage(stage))
    return "\n".join([f"The seed's model has {seed}.", "", *stages, *_pairs()])


def _stage(stage: str) -> Iterator[str]:
    effects = [effect for effect in REGISTRY.values() if effect.stage == stage]
    yield from (f"## {stage}", "", _STAGES[stage], "")
    for effect in effects:
        yield f"- **`{effect.name}`**: {_text(effect)}"
    yield ""
    if rows := [_row(effect, parameter) for effect in effects for parameter in effect.parameters]:
        yield from ("| parameter | unit | bounds | meaning |", "|---|---|---|---|", *rows, "")


def _text(effect: Effect) -> str:
    text = f"{effect.meaning[0].upper()}{effect.meaning[1:]}."
    return text if effect.parameters else f"{text} No parameters: write `{{}}`."


def _row(effect: Effect, p: Parameter) -> str:
    meaning = p.meaning
    if p.default is not None:
        meaning += f"; none neutral, default {p.default:g}"
    elif p.neutral not in (0, math.inf):
        meaning += f"; neutral at {p.neutral:g}"
    name = f"`{effect.name}.{p.name}`"
    return f"| {name} | {p.unit} | {p.low:g} .. {p.high:g} | {meaning} |"


def _pairs() -> Iterator[str]:
    yield from ("## Similar effects", "", "Pairs of effects that explain similar data, and what separates them.", "")
    yield from (f"- `{one}`, `{other}`: {how}." for one, other, how in RIVALS)


if __name__ == "__main__":
    print(markdown())
