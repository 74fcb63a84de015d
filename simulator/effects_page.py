"""docs/effects.md, from the registry: `python -m softarm.simulator.effects_page > docs/effects.md`."""

from collections.abc import Iterator

from softarm.schemas.model import seed_effects
from softarm.simulator.effect_table import RIVALS
from softarm.simulator.effects import REGISTRY, STAGES, Effect, Parameter

_INTRO = """\
<!-- Written by `python -m softarm.simulator.effects_page > docs/effects.md`; edit effect_table.py instead. -->
# Effects

An effect is a named piece of physics, actuation, sensing or timing that a simulator can have or lack. A model file
lists those that it has under `effects:`, each with its parameters; an effect without a line is absent. At its neutral
value it changes nothing, exactly. Here they stand in causal order; `softarm model show seed` tells which a model has.

*Neutral*: where the parameter changes nothing (-: it only shapes the effect, and has the default in brackets).
*Bounds*: what a fit, a draw or a model file may say. *Strong*: a large but sane value, which the tests use.
[P] is the CoRL 2023 paper (SM: its supplement), [C] its authors' released configuration.

"""

_STAGES = {
    "pressure": "From the pressure command to the muscle's pressure and its reading.",
    "rail": "From the velocity command to the cart's motion.",
    "arm": "From pressure and cart motion to the links' motion.",
    "mocap": "From motion to measured poses.",
    "observation": "From measurements to what the policy is fed.",
    "clock": "When things happened; beside the other stages.",
    "contact": "The shelf's surface; in the shelf task only.",
}


def page() -> str:
    """Return the page."""
    return _INTRO + "".join(_stage(stage) for stage in STAGES).rstrip("\n") + "\n"


def _stage(stage: str) -> str:
    effects = [effect for effect in REGISTRY.values() if effect.stage == stage]
    return f"## {stage}\n{_STAGES[stage]}\n\n" + "".join("\n".join(_effect(effect)) + "\n\n" for effect in effects)


def _effect(effect: Effect) -> Iterator[str]:
    mark = " (the seed's)" if effect.name in seed_effects() else ""
    yield f"### {effect.name}{mark}"
    yield f"{effect.meaning[0].upper()}{effect.meaning[1:]}."
    yield ""
    if effect.parameters:
        yield "| parameter | unit | neutral | bounds | strong | meaning |"
        yield "|---|---|---|---|---|---|"
        yield from map(_row, effect.parameters)
        yield ""
    else:
        yield "No parameters: it is on or absent. Write `{}`."
        yield ""
    yield f"Source: {effect.source}."
    rivals = [
        (one if other == effect.name else other, how) for one, other, how in RIVALS if effect.name in (one, other)
    ]
    if rivals:
        yield ""
        yield "Easily taken for:"
        yield from (f"- `{name}`; apart by: {how}." for name, how in rivals)


def _row(p: Parameter) -> str:
    neutral = f"{p.neutral:g}" if p.default is None else f"- ({p.default:g})"
    return f"| {p.name} | {p.unit} | {neutral} | {p.low:g} .. {p.high:g} | {p.exemplar:g} | {p.meaning} |"


if __name__ == "__main__":
    print(page(), end="")
