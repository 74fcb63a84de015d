"""Effects of a rig's stage, declared with the types of the simulator's effect table.

Each kind of stage has one such table: `tracking_effects`, `driven_mass_effects` and `chain.effects`. Bounds and usual
sizes come from the rig's own recordings.
"""

from collections.abc import Iterable
from dataclasses import replace

from softarm.simulator.effect_table import Effect, Parameter, with_rivals
from softarm.simulator.effects import REGISTRY


def of_stage(stage: str, effects: Iterable[Effect], rivals: Iterable[tuple[str, str, str]]) -> tuple[Effect, ...]:
    """Return effects under a stage's name ('gain' -> 'axis.gain'), with the experiments that separate them.

    A rival is two names and "motion: what it shows"; pairs of which an effect is missing are skipped.
    """
    return tuple(
        replace(
            effect,
            name=f"{stage}.{effect.name}",
            separated_by={f"{stage}.{rival}": experiment for rival, experiment in effect.separated_by.items()},
        )
        for effect in with_rivals(effects, rivals)
    )


def like(registered: str, meaning: str, plain: str, *parameters: Parameter, name: str = "") -> Effect:
    """Return an effect with the law, and so with the source, of an effect of the soft arm.

    Args:
        registered: the soft arm's effect, such as 'pressure.gain'.
        meaning: what the effect does.
        plain: the effect in a technician's words.
        parameters: parameters of the effect.
        name: name of the effect; by default the second part of `registered`.
    """
    return Effect(name or registered.partition(".")[2], parameters, meaning, REGISTRY[registered].source, plain=plain)
