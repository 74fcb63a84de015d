"""Recommendation of a policy: the retrained one only if it is shown to be better, and nowhere shown to be worse."""

from dataclasses import dataclass
from typing import Literal

from softarm.evaluation.closing.closed import Closed
from softarm.evaluation.closing.outcomes import HELD_OUT, NEW, OLD, PATCHED
from softarm.reporting.numbers import percent


@dataclass(frozen=True)
class Advice:
    """The policy to fly, and the reasons against the retrained one."""

    fly: Literal["old", "retrained"]
    against: tuple[str, ...] = ()


def advise(closed: Closed) -> Advice:
    """Recommend the old or the retrained policy.

    The retrained policy must be significantly better on the patched simulator, or no worse there and significantly
    better on the campaign's robot. It must be significantly worse nowhere. Significant: the 95 % interval excludes 0.
    The campaign's robot is the held-out robot if it was declared to be, and the robot on the wires. An undeclared
    held-out robot may lack the named effects, so it does not count.
    """
    if closed.retrained is None:
        return Advice("old", ("no effect was named, so nothing was patched or retrained",))
    against, won = [], closed.won(PATCHED)
    proven = [closed.won(HELD_OUT)] if closed.declared else []
    if closed.wires is not None and closed.wires.is_the_robot and closed.wires.won is not None:
        proven.append(closed.wires.won)
    if won.value <= 0.0 or not (won.above or any(each.above for each in proven)):
        how = "worse" if won.below else "not significantly better" if won.value > 0.0 else "no better"
        against.append(f"on the patched simulator the retrained policy is {how}: {won.text} of flights")
    for place in (PATCHED, HELD_OUT) if closed.declared else (PATCHED,):
        if closed.stops_more(place).above:
            old, new = (int(closed.both(name, place).stopped.sum()) for name in (OLD, NEW))
            against.append(f"on {closed.place(place).title} it causes more unrequested stops: {new}, not {old}")
    if closed.declared and (won := closed.won(HELD_OUT)).below:
        against.append(f"on {closed.place(HELD_OUT).title} it is worse: {won.text}")
    if not closed.retrained.better:
        before, after = percent(closed.retrained.before), percent(closed.retrained.after)
        against.append(f"in validation it is no better: {before} before, {after} after")
    if closed.wires is not None:
        against += closed.wires.against
    return Advice("old" if against else "retrained", tuple(against))
