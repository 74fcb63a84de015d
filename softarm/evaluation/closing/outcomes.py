"""Outcomes of a policy's flights on a robot, and paired differences between two policies.

Every interval is always valid: it may be looked at after each flight, and the flights may end because of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

OLD, REPLANNED, NEW, ADAPTIVE = "old", "mppi", "new", "adaptive"
TITLES = {OLD: "old policy", REPLANNED: "mppi on the patch", NEW: "retrained", ADAPTIVE: "adaptive policy"}
NOMINAL, PATCHED, HELD_OUT = "nominal", "patched", "held-back"
REST, SWINGING = "rest", "swinging"
MANNERS = {REST: "at rest", SWINGING: "in mid-swing"}  # state of the arm when a goal starts
ERROR = 0.05  # probability that an interval ever excludes the true value
WORTH = 0.05  # a gain in the share reached that is certainly smaller ends the flights
TYPICAL = 108  # number of differences for which the intervals are narrowest
_MEANS = np.linspace(0.0, 1.0, 401)[:, None]
_BET_MOST = 0.75  # share of the capital


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
        value, low, high = (f"{100 * share:+.1f}".replace("+0.0", "0").replace("-0.0", "0") for share in self)
        return f"{value} % ({low} to {high})"


@dataclass(frozen=True)
class Flights:
    """Results of F flights, in the same order for every policy."""

    reached: NDArray[np.bool_]  # [F]; a stop is a failure
    stops: tuple[str | None, ...]  # [F], reason of an unrequested stop; None: no stop
    group: NDArray[np.int_]  # [F]; flights of one chain are one group, as they are correlated

    @property
    def stopped(self) -> NDArray[np.bool_]:
        """Flights that ended in a stop, booleans [F]."""
        return np.array([stop is not None for stop in self.stops], dtype=np.bool_)

    @property
    def share(self) -> float:
        """Share of flights that reached their target; NaN without flights."""
        return float(self.reached.mean()) if self.reached.size else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """Always-valid 95 % interval of the share."""
        low, high = always_valid(np.where(self.reached, 1.0, -1.0))
        return (low + 1.0) / 2.0, (high + 1.0) / 2.0

    def chosen(self, which: NDArray[np.bool_] | slice) -> "Flights":
        """Return some of the flights: booleans [F] or a slice."""
        numbers = np.arange(self.reached.size)[which]
        return Flights(self.reached[numbers], tuple(self.stops[k] for k in numbers), self.group[numbers])


def joined(parts: Sequence[Flights]) -> Flights:
    """Concatenate flights; their groups stay distinct."""
    groups, first = [np.zeros(0, dtype=np.int_)], 0
    for part in parts:
        groups.append(part.group + first)
        first += int(part.group.max(initial=-1)) + 1
    reached = [np.zeros(0, dtype=np.bool_), *(part.reached for part in parts)]
    stops = tuple(stop for part in parts for stop in part.stops)
    return Flights(np.concatenate(reached), stops, np.concatenate(groups))


def better(old: Flights, new: Flights) -> Paired:
    """Return the difference in success, paired flight by flight to the same goals."""
    return _paired(new.reached.astype(float) - old.reached, old.group)


def stops_more(old: Flights, new: Flights) -> Paired:
    """Return the difference in unrequested stops, paired flight by flight."""
    return _paired(new.stopped.astype(float) - old.stopped, old.group)


def settled(old: Flights, new: Flights) -> bool:
    """Return whether further flights would hardly change the decision between two policies.

    The new policy is better, stops more often, or gains less than WORTH. All at the error rate ERROR.
    """
    won = better(old, new)
    return won.above or won.high < WORTH or stops_more(old, new).above


def always_valid(values: NDArray[np.float64]) -> tuple[float, float]:
    """Return an interval of the mean of independent values in -1 .. 1, valid at every number of values at once.

    The hedged capital of Waudby-Smith and Ramdas, Estimating means of bounded random variables by betting (Journal of
    the Royal Statistical Society B, 2024), section 4.4: a bet against each possible mean, on both sides. A mean is
    excluded once its capital reaches 1 / ERROR, which happens to the true mean with probability ERROR at most.
    """
    x = (np.asarray(values, dtype=float) + 1.0) / 2.0
    if x.size == 0:
        return -1.0, 1.0
    count = np.arange(1, x.size + 1)
    mean = (0.5 + x.cumsum()) / (count + 1)
    variance = (0.1 + ((x - mean) ** 2).cumsum()) / (count + 1)
    known = np.concatenate(([0.1], variance[:-1]))  # before each value
    bet = np.sqrt(2.0 * np.log(2.0 / ERROR) / (known * TYPICAL))
    with np.errstate(divide="ignore"):
        above = np.log1p(np.minimum(bet, _BET_MOST / _MEANS) * (x - _MEANS)).cumsum(axis=1)
        below = np.log1p(-np.minimum(bet, _BET_MOST / (1.0 - _MEANS)) * (x - _MEANS)).cumsum(axis=1)
    capital = np.maximum(above, below).max(axis=1) - np.log(2.0)
    possible = _MEANS[capital < -np.log(ERROR), 0]
    if possible.size == 0:
        return 2.0 * float(x.mean()) - 1.0, 2.0 * float(x.mean()) - 1.0
    return 2.0 * float(possible[0]) - 1.0, 2.0 * float(possible[-1]) - 1.0


def _paired(difference: NDArray[np.float64], group: NDArray[np.int_]) -> Paired:
    """Return the mean of differences [F] with its always-valid interval over the means of the groups."""
    _, number = np.unique(group, return_inverse=True)
    values: NDArray[np.float64] = np.bincount(number, difference) / np.bincount(number)
    value = float(values.mean()) if values.size else float("nan")
    return Paired(value, *always_valid(values))
