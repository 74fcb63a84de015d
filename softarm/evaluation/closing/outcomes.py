"""Outcomes of a policy's flights on a robot, and paired differences between two policies."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

OLD, NEW, REPLANNED = "old", "new", "mppi"
TITLES = {OLD: "old policy", NEW: "retrained", REPLANNED: "mppi"}
NOMINAL, PATCHED, HELD_OUT = "nominal", "patched", "held-back"
REST, CHAINED = "rest", "chained"
MANNERS = {REST: "at rest", CHAINED: "in mid-swing"}  # state of the arm when a goal starts
RESAMPLES, SEED = 4000, 54
PERCENTILES = (2.5, 97.5)  # the interval of 95 %


class Paired(NamedTuple):
    """Difference between the shares of two policies, new minus old, with its 95 % interval."""

    value: float
    low: float
    high: float

    @property
    def above(self) -> bool:
        """Whether the new share is significantly larger."""
        return self.low > 0.0

    @property
    def below(self) -> bool:
        """Whether the new share is significantly smaller."""
        return self.high < 0.0

    @property
    def text(self) -> str:
        """The difference as text: `+6.8 % (2.5 to 11.1)`."""
        low, high = (f"{100 * end:+.1f}".replace("+0.0", "0").replace("-0.0", "0") for end in (self.low, self.high))
        return f"{100 * self.value:+.1f} % ({low} to {high})"


@dataclass(frozen=True)
class Flights:
    """Results of F flights, in the same order for every policy."""

    reached: NDArray[np.bool_]  # [F]; a stop is a failure
    stops: tuple[str | None, ...]  # [F], reason of an unrequested stop; None: no stop
    group: NDArray[np.int_]  # [F]; flights of one target or one chain are one group, as they are correlated

    @property
    def stopped(self) -> NDArray[np.bool_]:
        """Flights that ended in a stop, booleans [F]."""
        return np.array([stop is not None for stop in self.stops], dtype=np.bool_)

    @property
    def share(self) -> float:
        """Share of flights that reached their target."""
        return float(self.reached.mean())


def joined(parts: Sequence[Flights]) -> Flights:
    """Concatenate flights; their groups stay distinct."""
    groups, first = [], 0
    for part in parts:
        groups.append(part.group + first)
        first += int(part.group.max(initial=-1)) + 1
    stops = tuple(stop for part in parts for stop in part.stops)
    return Flights(np.concatenate([part.reached for part in parts]), stops, np.concatenate(groups))


def better(old: Flights, new: Flights) -> Paired:
    """Return the difference in success, paired flight by flight to the same goals."""
    return _paired(new.reached.astype(float) - old.reached, old.group)


def stops_more(old: Flights, new: Flights) -> Paired:
    """Return the difference in unrequested stops, paired flight by flight."""
    return _paired(new.stopped.astype(float) - old.stopped, old.group)


def _paired(difference: NDArray[np.float64], group: NDArray[np.int_]) -> Paired:
    """Return the mean of differences [F] and its bootstrap interval over groups (Efron and Tibshirani 1993, 8.5)."""
    names, number = np.unique(group, return_inverse=True)
    total, size = np.bincount(number, difference), np.bincount(number)
    drawn = np.random.default_rng(SEED).integers(len(names), size=(RESAMPLES, len(names)))
    low, high = np.percentile(total[drawn].sum(axis=1) / size[drawn].sum(axis=1), PERCENTILES)
    return Paired(float(difference.mean()), float(low), float(high))
