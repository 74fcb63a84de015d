"""From energies and gains to a verdict: pure numbers in, words out. Every threshold stands here.

Energies are mean squares of a stage's residual over the floor's: 1 is what no simulator is blamed for.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from softarm.diagnosis.engine.search import Choice, SelectedEffect
from softarm.simulator.effects import REGISTRY

STANDS = 0.85  # share of what is explainable where an effect shows that it has to explain to be named
UNKNOWN_MIN = 0.5  # energy beyond the floor that asks for an explanation
# Of what is left beyond the floor at least this much counts as explainable: what changes at random from tick to tick
# no model finds, and it is not the floor's noise either.
RANDOM_SHARE = 0.5
# Where something is left, a strength that differs more than this from excitation to excitation is another law's: a
# part for any effect, and one for chance over the root of the energy that the effect explains.
# The same between the trials' halves: a strength that grows or fades is no constant effect's.
SCATTER, DRIFT, CHANCE = 0.06, 0.12, 0.10

Kind = Literal["named", "incomplete", "unknown", "none"]


@dataclass(frozen=True, slots=True)
class Decision:
    """What the fitted effects amount to."""

    kind: Kind
    selected: tuple[SelectedEffect, ...]  # the named ones
    left: Mapping[str, float]  # stage -> energy that could be explained and is not
    explained: float  # share of the explainable energy that these explain


def decide(choice: Choice, flexible: Mapping[str, float]) -> Decision:
    """Rule on the fitted effects. flexible: stage -> share of the rest that a flexible model finds."""
    _, after = choice.energies
    left = {s: max(e - 1.0, 0.0) * max(flexible.get(s, 0.0), RANDOM_SHARE) for s, e in after.items()}
    selected = tuple(m for m in choice.selected if _stands(m, choice, left))
    asks = max(left.values(), default=0.0) > UNKNOWN_MIN
    for fallen in (m for m in choice.selected if m not in selected):  # what it would have explained is not explained
        for stage, energy in fallen.gain.energies.items():
            left[stage] = left.get(stage, 0.0) + max(energy, 0.0)
    explained = sum(max(e, 0.0) for m in selected for e in m.gain.energies.values())
    share = explained / (explained + sum(left.values())) if selected else 0.0
    if not selected:
        return Decision("unknown" if asks or choice.selected else "none", (), left, share)
    whole = len(selected) == len(choice.selected) and share >= STANDS
    return Decision("named" if whole else "incomplete", selected, left, share)


def _stands(effect: SelectedEffect, choice: Choice, left: Mapping[str, float]) -> bool:
    """Whether an effect explains what there is to explain where it shows, with one strength if it leaves anything."""
    stage, energy = max(effect.gain.energies.items(), key=lambda each: each[1])
    i = choice.chosen.names.index(effect.candidate.name)
    scatter, drift = choice.chosen.scatter(i), choice.chosen.drift(i)
    chance = CHANCE / max(energy, 1e-6) ** 0.5
    steady = scatter <= SCATTER + chance and drift <= DRIFT + chance
    whole = choice.energies[1][stage] <= 1.0
    return (whole or steady) and energy > STANDS * (energy + left.get(stage, 0.0))


def stage_shares(decision: Decision, counted: Mapping[str, float]) -> dict[str, float]:
    """Stage -> share of the gap: what each effect explains is its own stage's, what is left the stage's it is seen in.

    counted: stage -> energies of effects that were read off stamps and noise.
    """
    energies: dict[str, float] = dict(counted)
    for effect in decision.selected:
        stage = REGISTRY[effect.candidate.name].stage
        energies[stage] = energies.get(stage, 0.0) + sum(max(e, 0.0) for e in effect.gain.energies.values())
    for stage, energy in decision.left.items():
        energies[stage] = energies.get(stage, 0.0) + energy
    total = sum(energies.values())
    return {s: e / total for s, e in energies.items()} if total > 0 else {}


def stage_of(shares: Mapping[str, float], order: Sequence[str]) -> str | None:
    """The stage with the largest share."""
    return max(order, key=lambda s: shares.get(s, 0.0)) if any(shares.values()) else None
