"""From energies and gains to a verdict: pure numbers in, words out. The thresholds stand in `engine/thresholds.py`.

Energies are mean squares of a stage's residual over the floor's: 1 is what no simulator is blamed for.
"""

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field
from typing import Literal

from softarm.diagnosis.engine.search import Choice, SelectedEffect
from softarm.diagnosis.engine.structure import Structure
from softarm.diagnosis.engine.thresholds import ROBOT, Thresholds

Kind = Literal["named", "incomplete", "unknown", "none"]


@dataclass(frozen=True, slots=True)
class Decision:
    """What the fitted effects amount to."""

    kind: Kind
    selected: tuple[SelectedEffect, ...]  # the named ones
    left: Mapping[str, float]  # stage -> energy that could be explained and is not
    explained: float  # share of the explainable energy that these explain
    odd: Mapping[str, str] = field(default_factory=dict)  # stage -> the structure in what is left that asks for a cause


def decide(
    choice: Choice,
    flexible: Mapping[str, float],
    structures: Mapping[str, Structure] | None = None,
    tolerated: Mapping[str, float] | None = None,
    thresholds: Thresholds = ROBOT,
    signs: Mapping[str, Structure] | None = None,
    bent: Mapping[str, float] | None = None,
) -> Decision:
    """Rule on the fitted effects.

    By stage: flexible, the share of the rest that a flexible model finds; structures, what the rest has that noise has
    not; tolerated, the energy that nuisances take away within their boxes; signs, what a test of its own found, by
    its own floor, that no effect of the list can explain; bent, the energy by which nuisances in their boxes may be off
    the straight lines that take them away.
    """
    t, (_, after) = thresholds, choice.energies
    left = {s: max(e - 1.0, 0.0) * max(flexible.get(s, 0.0), t.random_share) for s, e in after.items()}
    taken = {s: max((tolerated or {}).get(s, 0.0), 0.0) for s in after}
    gone = {s: taken[s] + max(choice.energies[0][s] - e, 0.0) for s, e in after.items()}
    most = {s: t.beside_most + min((bent or {}).get(s, 0.0), t.bent_share * gone[s]) for s in after}
    over = {s for s, e in left.items() if e > most[s]}  # more than any name may leave beside it
    selected = tuple(m for m in choice.selected if _stands(m, choice, left, gone, over, t))
    for effect in selected:
        for stage, energy in effect.gain.energies.items():
            taken[stage] = taken.get(stage, 0.0) + max(energy, 0.0)
    odd = {
        s: each.where
        for s, each in (structures or {}).items()
        if each.energy > max(t.structure_min, min(t.structure_share * taken[s], most[s] / t.random_share))
    }
    odd |= {s: each.where for s, each in (signs or {}).items()}
    granted = {s: max(t.unknown_min, min(t.tolerated * e, t.tolerated_most)) for s, e in taken.items()}
    asks = bool(odd) or any(e > granted[s] for s, e in left.items() if s in granted)
    for fallen in (m for m in choice.selected if m not in selected):  # what it would have explained is not explained
        asks = asks or max(fallen.gain.energies.values()) > t.fallen_min
        for stage, energy in fallen.gain.energies.items():
            left[stage] = left.get(stage, 0.0) + max(energy, 0.0)
    explained = sum(max(e, 0.0) for m in selected for e in m.gain.energies.values())
    share = explained / (explained + sum(left.values())) if selected else 0.0
    for stage, each in (signs or {}).items():  # where it is seen, there the rest of the gap is
        left[stage] = max(left.get(stage, 0.0), each.energy)
    if not selected:
        return Decision("unknown" if asks else "none", (), left, share, odd)
    if share < t.least_share:  # beside a gap that nobody explains a small name would be taken for its cause
        return Decision("unknown", (), left, 0.0, odd)
    whole = len(selected) == len(choice.selected) and share >= t.stands and not odd and not over
    return Decision("named" if whole else "incomplete", selected, left, share, odd)


def _stands(
    effect: SelectedEffect,
    choice: Choice,
    left: Mapping[str, float],
    gone: Mapping[str, float],
    over: Set[str],
    t: Thresholds,
) -> bool:
    """Whether an effect explains what there is to explain where it shows, with one strength if it leaves anything.

    gone: stage -> energy that all chosen effects and the nuisances take away together; over: stages
    that keep more than any name may leave: there an effect has to stand by itself.
    """
    stage, energy = max(effect.gain.energies.items(), key=lambda each: each[1])
    i = choice.chosen.names.index(effect.candidate.name)
    scatter, drift = choice.chosen.scatter(i), choice.chosen.drift(i)
    chance = t.chance / max(energy, 1e-6) ** 0.5
    steady = scatter <= t.scatter + chance and drift <= t.drift + chance
    whole = choice.energies[1][stage] <= 1.0 + min(t.whole_share * gone[stage], t.whole_most)
    pinned = effect.candidate.at_bound(choice.chosen.u[i])
    adds = effect.gain.low > 0  # beside the others; what stands in for an equal may add nothing
    constant = not effect.candidate.constant or (scatter**2 + drift**2) ** 0.5 <= t.constant + chance
    takes = gone[stage] if t.together else energy
    least = t.stands_over if stage in over else t.stands
    own = stage not in over or energy > left.get(stage, 0.0)
    clear = own and takes > least * (takes + left.get(stage, 0.0))
    return adds and not pinned and constant and (whole or steady) and clear


def stage_shares(decision: Decision, counted: Mapping[str, float]) -> dict[str, float]:
    """Stage -> share of the gap: what each effect explains is its own stage's, what is left the stage's it is seen in.

    counted: stage -> energies of effects that were read off stamps and noise.
    """
    energies: dict[str, float] = dict(counted)
    for effect in decision.selected:
        stage = effect.candidate.stage
        energies[stage] = energies.get(stage, 0.0) + sum(max(e, 0.0) for e in effect.gain.energies.values())
    for stage, energy in decision.left.items():
        energies[stage] = energies.get(stage, 0.0) + energy
    total = sum(energies.values())
    return {s: e / total for s, e in energies.items()} if total > 0 else {}


def stage_of(shares: Mapping[str, float], order: Sequence[str]) -> str | None:
    """The stage with the largest share."""
    return max(order, key=lambda s: shares.get(s, 0.0)) if any(shares.values()) else None
