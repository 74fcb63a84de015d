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

    A rival is an effect, one or more others and "motion: what it shows"; pairs with a missing effect are skipped.
    """
    pairs = [(one, other, experiment) for one, others, experiment in rivals for other in others.split()]
    return tuple(
        replace(
            effect,
            name=f"{stage}.{effect.name}",
            separated_by={f"{stage}.{rival}": experiment for rival, experiment in effect.separated_by.items()},
        )
        for effect in with_rivals(effects, pairs)
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


def backlash(gap: Parameter) -> Effect:
    """Return the effect of play between a drive and its load."""
    meaning = "play at reversals: the drive crosses the gap before the load follows"
    return like("rail.backlash", meaning, "{stage} has {gap} of play", gap)


def dry_friction(size: Parameter, give: Parameter) -> Effect:
    """Return the effect of dry friction, which bends over a travel before it slips."""
    plain = f"{{stage}} has {{{size.name}}} of dry friction"
    return like("rail.coulomb_friction", "dry friction", plain, size, give)


def stiction(size: Parameter, speed: Parameter) -> Effect:
    """Return the effect of more dry friction at rest, which fades at a speed."""
    meaning = "dry friction is larger at rest and at creeping speed (Stribeck)"
    source = "Armstrong-Helouvry et al. 1994, A survey of models for the control of machines with friction"
    plain = f"{{stage}} sticks: {{{size.name}}} more friction at rest"
    return Effect("stiction", (size, speed), meaning, source, plain=plain)


def damping(viscous: Parameter) -> Effect:
    """Return the effect of friction that is proportional to the speed."""
    meaning, plain = "viscous friction; a motor's back-EMF acts alike", "{stage} has viscous friction of {viscous}"
    return like("rail.coulomb_friction", meaning, plain, viscous, name="damping")


def drag(coefficient: Parameter) -> Effect:
    """Return the effect of friction that grows with the speed squared."""
    return like("arm.drag", "friction grows with the speed squared", "drag slows {stage} at speed", coefficient)


def latency(delay: Parameter) -> Effect:
    """Return the effect of readings that are older than their stamps."""
    plain = "the readings of {stage} are {delay} older than their stamps"
    return like("mocap.latency", "readings are older than their stamps state", plain, delay)
