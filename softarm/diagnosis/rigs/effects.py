"""Effects of a rig's stage, declared with the types of the simulator's effect table.

Each kind of stage has one such table: `tracking_effects`, `driven_mass_effects` and `chain.effects`. Bounds and usual
sizes come from the rig's own recordings.
"""

from collections.abc import Iterable
from dataclasses import replace

from softarm.simulator.effect_table import Effect, with_rivals
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


def source(name: str) -> str:
    """Return the source of the soft arm's effect of this name, for a rig's effect with the same law."""
    return REGISTRY[name].source
