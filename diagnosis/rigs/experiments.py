"""What to record next: what would tell the members of a set apart, in the words of the vocabulary."""

from collections.abc import Mapping, Sequence

from softarm.diagnosis.rigs.views import RigView
from softarm.schemas.verdict import NextExperiment

NOTHING = "nothing in the list separates these"


def splitting(view: RigView, answers: Sequence[Sequence[str]]) -> NextExperiment | None:
    """For the first set among the answers, each the names that it may be, that anything separates.

    Where nothing does, that; None where there is no set.
    """
    asked = [between(view, names) for names in answers if len(names) > 1]
    return next((each for each in asked if each.expect), asked[0] if asked else None)


def between(view: RigView, names: Sequence[str]) -> NextExperiment:
    """What separates the first pair of these that anything separates, whichever of the two is asked."""
    known = {e.name: _apart(e.separated_by) for e in view.effects}
    pairs = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]
    for one, other in pairs:
        how = known.get(one, {}).get(other) or known.get(other, {}).get(one)
        if how:
            motion, _, sign = how.partition(": ")
            return NextExperiment(
                excitation=motion, separates=(one, other), expect=dict.fromkeys((one, other), sign or how)
            )
    return NextExperiment(excitation=NOTHING, separates=tuple(names), expect={})


def _apart(text: str) -> Mapping[str, str]:
    """Rival -> what tells it apart, of an effect's `separated_by`."""
    found: dict[str, str] = {}
    for part in text.split("; "):
        name, colon, how = part.partition(": ")
        if colon and "." in name and " " not in name:
            found[name] = how
    return found
