"""What came of a policy's flights on a robot, and how much better another policy's of the same goals are."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

OLD, NEW, REPLANNED = "old", "new", "mppi"
TITLES = {OLD: "old policy", NEW: "retrained", REPLANNED: "mppi"}
NOMINAL, PATCHED, HELD_BACK = "nominal", "patched", "held-back"
REST, CHAINED = "rest", "chained"
MANNERS = {REST: "at rest", CHAINED: "in mid-swing"}  # how a goal finds the arm
RESAMPLES, SEED = 4000, 54
SURE = (2.5, 97.5)  # percentiles: the interval of 95 %


class Paired(NamedTuple):
    """By how much a share of the new policy's flights is above the old one's, with its interval of 95 %."""

    value: float
    low: float
    high: float

    @property
    def above(self) -> bool:
        """Whether the new one's is surely larger."""
        return self.low > 0.0

    @property
    def below(self) -> bool:
        """Whether it is surely smaller."""
        return self.high < 0.0

    @property
    def text(self) -> str:
        """`+6.8 % (2.5 to 11.1)`."""
        low, high = (f"{100 * end:+.1f}".replace("+0.0", "0").replace("-0.0", "0") for end in (self.low, self.high))
        return f"{100 * self.value:+.1f} % ({low} to {high})"


@dataclass(frozen=True)
class Flights:
    """F flights, in an order that every policy's have."""

    reached: NDArray[np.bool_]  # [F]; a stop is no success
    stops: tuple[str | None, ...]  # [F], why the arm stopped, unasked; None: it did not
    group: NDArray[np.int_]  # [F]; flights of one group have a fate in common: of one target, or of one chain

    @property
    def stopped(self) -> NDArray[np.bool_]:
        """[F], which of them ended in a stop."""
        return np.array([stop is not None for stop in self.stops], dtype=np.bool_)

    @property
    def share(self) -> float:
        """Of the flights, those that reached."""
        return float(self.reached.mean())


def joined(parts: Sequence[Flights]) -> Flights:
    """One after the other; their groups stay apart."""
    groups, first = [], 0
    for part in parts:
        groups.append(part.group + first)
        first += int(part.group.max(initial=-1)) + 1
    stops = tuple(stop for part in parts for stop in part.stops)
    return Flights(np.concatenate([part.reached for part in parts]), stops, np.concatenate(groups))


def better(old: Flights, new: Flights) -> Paired:
    """How much more often the new policy reached, flight by flight of the same goals."""
    return _paired(new.reached.astype(float) - old.reached, old.group)


def stops_more(old: Flights, new: Flights) -> Paired:
    """How much more often its arm stopped, unasked."""
    return _paired(new.stopped.astype(float) - old.stopped, old.group)


def _paired(difference: NDArray[np.float64], group: NDArray[np.int_]) -> Paired:
    """Mean of differences [F] and its percentile interval, whole groups drawn anew (Efron and Tibshirani 1993, 8.5)."""
    names, number = np.unique(group, return_inverse=True)
    total, size = np.bincount(number, difference), np.bincount(number)
    drawn = np.random.default_rng(SEED).integers(len(names), size=(RESAMPLES, len(names)))
    low, high = np.percentile(total[drawn].sum(axis=1) / size[drawn].sum(axis=1), SURE)
    return Paired(float(difference.mean()), float(low), float(high))
