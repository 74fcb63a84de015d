"""Recommendation of a policy: another one than the old only if it is shown to be better."""

from collections.abc import Mapping
from dataclasses import dataclass

from softarm.evaluation.closing.closed import Closed
from softarm.evaluation.closing.outcomes import NEW, OLD
from softarm.reporting.numbers import percent


@dataclass(frozen=True)
class Advice:
    """The policy to fly, and the reasons against each other way."""

    fly: str  # old, mppi, new, adaptive
    against: Mapping[str, tuple[str, ...]]


def advise(closed: Closed) -> Advice:
    """Recommend the way with the largest gain among those that are shown to be better, or the old policy.

    A way must be significantly better on the judging robot, and stop no more often there. The retrained policy must
    also be better in validation and not worse on the wires; on them it may show its gain too. Significant: the
    always-valid 95 % interval excludes 0.
    """
    against = {name: tuple(_against(closed, name)) for name in closed.ways}
    good = [name for name, reasons in against.items() if not reasons]
    return Advice(max(good, key=lambda name: closed.won(name).value, default=OLD), against)


def _against(closed: Closed, name: str) -> list[str]:
    """Return the reasons against a way."""
    won, found = closed.won(name), []
    wires = closed.wires if name == NEW else None
    proven = wires is not None and wires.is_the_robot and wires.won is not None and wires.won.above
    if won.below or not (won.above or (proven and won.value >= 0.0)):
        how = "worse" if won.below else "not significantly better" if won.value > 0.0 else "no better"
        draws = closed.flown[name, closed.judged.key].reached.size
        found.append(f"on {closed.judged.title} it is {how}: {won.text} of {draws} flights")
    if closed.stops_more(name).above:
        old, new = (int(closed.flown[each, closed.judged.key].stopped.sum()) for each in (OLD, name))
        found.append(f"on {closed.judged.title} it causes more unrequested stops: {new}, not {old}")
    if name == NEW and closed.retrained is not None and not closed.retrained.better:
        before, after = percent(closed.retrained.before), percent(closed.retrained.after)
        found.append(f"in validation it is no better: {before} before, {after} after")
    return found + list(wires.against if wires is not None else ())
