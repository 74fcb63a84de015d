"""Which policy to fly: the retrained one only where it is shown to be better, and nowhere shown to be worse."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from softarm.flights.closing.outcomes import HELD_BACK, NEW, OLD, PATCHED
from softarm.pages.numbers import percent

if TYPE_CHECKING:
    from softarm.flights.closing.closed import Closed


@dataclass(frozen=True)
class Advice:
    """fly: the old policy or the retrained one. against: why not the retrained one, a sentence each."""

    fly: Literal["old", "retrained"]
    against: tuple[str, ...] = ()


def advise(closed: "Closed") -> Advice:
    """Surely better on the patched simulator, or no worse there and surely better on the robot itself; worse nowhere.

    Surely: by an interval above nought. The robot itself: the held-back one if it was declared to be the campaign's,
    and the one behind the wires. A held-back robot that nobody declared may lack what was named, and is not asked.
    """
    if closed.retrained is None:
        return Advice("old", ("nothing was named, so nothing was patched or retrained",))
    against, won = [], closed.won(PATCHED)
    proven = [closed.won(HELD_BACK)] if closed.declared else []
    if closed.wires is not None and closed.wires.is_the_robot and closed.wires.won is not None:
        proven.append(closed.wires.won)
    if won.value <= 0.0 or not (won.above or any(each.above for each in proven)):
        how = "worse" if won.below else "not surely better" if won.value > 0.0 else "no better"
        against.append(f"on its own patched simulator the retrained one is {how}: {won.text} of flights")
    for place in (PATCHED, HELD_BACK) if closed.declared else (PATCHED,):
        if closed.stops_more(place).above:
            old, new = (int(closed.both(name, place).stopped.sum()) for name in (OLD, NEW))
            against.append(f"on {closed.place(place).title} its arm stops unasked more often: {new} times, not {old}")
    if closed.declared and (won := closed.won(HELD_BACK)).below:
        against.append(f"on {closed.place(HELD_BACK).title} it is worse: {won.text}")
    if not closed.retrained.better:
        before, after = percent(closed.retrained.before), percent(closed.retrained.after)
        against.append(f"in validation it is no better: {before} before, {after} after")
    if closed.wires is not None:
        against += closed.wires.against
    return Advice("old" if against else "retrained", tuple(against))
