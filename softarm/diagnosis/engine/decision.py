"""Verdict from the energies and gains of fitted effects, by the rules in `engine/thresholds.py`.

An energy is the mean square of a stage's residual over the noise floor's: 1 is noise.
"""

from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from math import hypot
from typing import Literal

from softarm.diagnosis.engine.search import Choice, SelectedEffect
from softarm.diagnosis.engine.structure import Structure
from softarm.diagnosis.engine.thresholds import ROBOT, Thresholds

Kind = Literal["named", "incomplete", "unknown", "none"]
Energies = Mapping[str, float]  # stage -> energy


@dataclass(frozen=True, slots=True)
class Decision:
    """Verdict on the fitted effects."""

    kind: Kind
    selected: tuple[SelectedEffect, ...]  # the named effects
    unexplained: Energies  # explainable energy that no named effect explains
    explained: float  # share of the explainable energy that the named effects explain
    structure: Mapping[str, str] = field(default_factory=dict)  # stage -> structure in the residual that needs a cause
    unresolved: tuple[SelectedEffect, ...] = ()  # causes that the data do not resolve next to the others
    equal_sets: tuple[tuple[str, ...], ...] = ()  # names of other sets that explain as much as all named effects
    noise: bool = False  # the residual exceeds the noise floor, and no flexible model explains it beyond chance


@dataclass(frozen=True, slots=True)
class Evidence:
    """Evidence on the residuals of a search, by stage."""

    flexible: Energies = field(default_factory=dict)  # share of the residual that a flexible model finds
    structures: Mapping[str, Structure] = field(default_factory=dict)  # structure that noise does not have
    tolerated: Energies = field(default_factory=dict)  # energy that nuisances explain within their boxes
    bent: Energies = field(default_factory=dict)  # linearisation error of the nuisances
    # Findings of further tests with noise floors of their own; no effect of the list explains them.
    signs: Mapping[str, Structure] = field(default_factory=dict)
    unresolved: AbstractSet[str] = frozenset()  # chosen effects that the data do not resolve
    caused: bool = False  # whether the views hold a named effect already
    # Share of the residual that a flexible model finds beyond chance, if nothing is named and no noise floor is known;
    # None if it was not tested.
    proven: Energies | None = None


@dataclass(frozen=True, slots=True)
class Remainder:
    """Energies that remain after the fitted effects, by stage."""

    left: Energies  # explainable energy beyond the noise floor
    removed: Energies  # energy that all fitted effects and the nuisances explain together
    most: Energies  # largest energy that may remain next to a name
    excess: AbstractSet[str]  # stages that keep more


def decide(choice: Choice, evidence: Evidence, thresholds: Thresholds = ROBOT) -> Decision:
    """Return the verdict on the fitted effects of a search."""
    rest = remainder(choice, evidence, thresholds)
    causes = tuple(effect for effect in choice.selected if is_cause(effect, choice, rest, thresholds))
    fallen = tuple(effect for effect in choice.selected if effect not in causes)
    unresolved = tuple(effect for effect in causes if effect.candidate.name in evidence.unresolved)
    if len(unresolved) == len(causes) and not evidence.caused:  # the gap has a cause, and the first explains it best
        unresolved = unresolved[1:]
    selected = tuple(effect for effect in causes if effect not in unresolved)
    taken = _added({stage: evidence.tolerated.get(stage, 0.0) for stage in rest.left}, selected)
    structure = _structure(evidence, rest, taken, thresholds)
    needs = rest.left
    if evidence.proven is not None:
        structure = {s: where for s, where in structure.items() if evidence.proven.get(s) or s in evidence.signs}
        needs = {s: max(e - 1.0, 0.0) * evidence.proven.get(s, 0.0) for s, e in choice.energies[1].items()}
    unnamed = _without_cause(needs, taken, fallen, thresholds) | structure.keys()
    left = _added(rest.left, fallen + unresolved)
    excess = any(energy > rest.most[stage] for stage, energy in left.items())
    share = _share(selected, left)
    whole = not fallen and share >= thresholds.cause.explained_min and not structure and not excess
    if not whole and (doubtful := _doubtful(selected, unnamed, choice, evidence, thresholds)):
        selected = tuple(effect for effect in selected if effect not in doubtful)
        left = _added(left, doubtful)
        share = _share(selected, left)
    left |= {stage: max(left.get(stage, 0.0), sign.energy) for stage, sign in evidence.signs.items()}
    if not selected:
        noise = not unnamed and evidence.proven is not None
        return Decision("unknown" if unnamed else "none", (), left, share, structure, noise=noise)
    if share < thresholds.cause.answer_min:
        return Decision("unknown", (), left, 0.0, structure)
    complete = len(selected) == len(choice.selected)
    equals = tuple(fit.names for fit in choice.equal_sets) if complete else ()
    return Decision("named" if whole else "incomplete", selected, left, share, structure, unresolved, equals)


def without(decision: Decision, dropped: SelectedEffect) -> Decision:
    """Return a decision in which an effect is no cause; what it explains remains unexplained."""
    selected = tuple(effect for effect in decision.selected if effect is not dropped)
    left = _added(decision.unexplained, [dropped])
    return Decision(
        kind="incomplete" if selected else "unknown",
        selected=selected,
        unexplained=left,
        explained=_share(selected, left),
        structure=decision.structure,
        unresolved=decision.unresolved,
    )


def _doubtful(
    selected: Sequence[SelectedEffect], unnamed: AbstractSet[str], choice: Choice, evidence: Evidence, t: Thresholds
) -> tuple[SelectedEffect, ...]:
    """Return the selected effects that may stand in for an unknown cause, which leaves a rest.

    Such an effect has no steady strength next to a rest in its own stage. The laws of a rig leave a rest next to true
    causes, too; there it is one whose interval contains the model's own value.
    """
    if t.approximate:
        return tuple(effect for effect in selected if effect.candidate.name in evidence.unresolved)
    most = t.cause.beside_rest_max
    return tuple(effect for effect in selected if effect.strongest in unnamed and _varies(effect, choice, most))


def remainder(choice: Choice, evidence: Evidence, t: Thresholds) -> Remainder:
    """Return the energies that remain after the fitted effects."""
    before, after = choice.energies
    left = {s: max(e - 1.0, 0.0) * max(evidence.flexible.get(s, 0.0), t.gap.random_share) for s, e in after.items()}
    removed = {s: evidence.tolerated.get(s, 0.0) + max(before[s] - e, 0.0) for s, e in after.items()}
    most = {s: t.cause.rest_most + min(evidence.bent.get(s, 0.0), t.cause.bent_share * removed[s]) for s in after}
    return Remainder(left, removed, most, {s for s, e in left.items() if e > most[s]})


def is_cause(effect: SelectedEffect, choice: Choice, rest: Remainder, t: Thresholds) -> bool:
    """Return whether an effect explains the gap of its stage, with one strength unless nothing remains."""
    stage = effect.strongest
    energy = effect.gain.energies[stage]
    i = choice.chosen.names.index(effect.candidate.name)
    if effect.gain.low <= 0 or effect.candidate.at_bound(choice.chosen.u[i]):
        return False
    scatter, drift = choice.chosen.scatter(i), choice.chosen.drift(i)
    chance = t.cause.chance / max(energy, 1e-6) ** 0.5
    if effect.candidate.constant and _varies(effect, choice, t.cause.constant_max):
        return False
    steady = scatter <= t.cause.scatter_max + chance and drift <= 2 * t.cause.scatter_max + chance
    at_floor = choice.energies[1][stage] <= 1.0 + min(t.cause.floor_share * rest.removed[stage], t.cause.floor_most)
    return (steady or at_floor) and _explains(stage, energy, rest, t)


def _varies(effect: SelectedEffect, choice: Choice, most: float) -> bool:
    """Return whether an effect's strength differs between excitations or halves of the trials by more than a share."""
    i = choice.chosen.names.index(effect.candidate.name)
    return hypot(choice.chosen.scatter(i), choice.chosen.drift(i)) > most


def _share(selected: Sequence[SelectedEffect], left: Energies) -> float:
    """Return the share of the explainable energy that the named effects explain."""
    explained = sum(max(e, 0.0) for effect in selected for e in effect.gain.energies.values())
    return explained / (explained + sum(left.values())) if selected else 0.0


def _explains(stage: str, energy: float, rest: Remainder, t: Thresholds) -> bool:
    left = rest.left.get(stage, 0.0)
    if stage in rest.excess and energy <= left:
        return False
    takes = rest.removed[stage] if t.approximate else energy
    least = t.cause.explained_over if stage in rest.excess else t.cause.explained_min
    return takes > least * (takes + left)


def _structure(evidence: Evidence, rest: Remainder, taken: Energies, t: Thresholds) -> dict[str, str]:
    found = {}
    for stage, each in evidence.structures.items():
        granted = min(t.gap.structure_share * taken[stage], rest.most[stage] / t.gap.random_share)
        if each.energy > max(t.gap.structure_min, granted):
            found[stage] = each.where
    return found | {stage: each.where for stage, each in evidence.signs.items()}


def _without_cause(needs: Energies, taken: Energies, fallen: Sequence[SelectedEffect], t: Thresholds) -> set[str]:
    """Return the stages whose remaining energy, or that of a rejected effect, needs a cause."""
    granted = {s: max(t.gap.unknown_min, min(t.gap.tolerated_share * e, t.cause.rest_most)) for s, e in taken.items()}
    remains = {s for s, e in needs.items() if e > granted[s]}
    # Approximate laws leave small effects that are not named; exact laws do not.
    least = t.gap.unknown_min if t.approximate else 0.0
    return remains | {effect.strongest for effect in fallen if effect.gain.energies[effect.strongest] > least}


def _added(energies: Energies, effects: Sequence[SelectedEffect]) -> dict[str, float]:
    found = dict(energies)
    for effect in effects:
        for stage, energy in effect.gain.energies.items():
            found[stage] = found.get(stage, 0.0) + max(energy, 0.0)
    return found


def stage_shares(decision: Decision, counted: Energies) -> dict[str, float]:
    """Return each stage's share of the gap.

    The energy of a named effect belongs to the effect's stage, unexplained energy to the stage that shows it, and
    `counted` is the energy of effects that were measured from stamps and noise.
    """
    energies: dict[str, float] = dict(counted)
    for effect in decision.selected:
        stage = effect.candidate.stage
        energies[stage] = energies.get(stage, 0.0) + sum(max(e, 0.0) for e in effect.gain.energies.values())
    for stage, energy in decision.unexplained.items():
        energies[stage] = energies.get(stage, 0.0) + energy
    total = sum(energies.values())
    return {s: e / total for s, e in energies.items()} if total > 0 else {}


def stage_of(shares: Mapping[str, float], order: Sequence[str]) -> str | None:
    """Return the stage with the largest share, or None if there is no gap."""
    return max(order, key=lambda s: shares.get(s, 0.0)) if any(shares.values()) else None
