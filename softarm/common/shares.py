"""Share of successes with its confidence interval."""

import math
from collections.abc import Iterable

from typing_extensions import TypedDict

_Z95 = 1.959964


class Share(TypedDict):
    """Share of hits with its 95 % interval, each None without cases."""

    share: float | None
    low: float | None
    high: float | None
    hits: int
    of: int


def share(hits: Iterable[bool]) -> Share:
    """Return the share of hits with its 95 % interval (Wilson 1927) and counts; the share of no cases is None."""
    found = list(hits)
    n, k = len(found), sum(found)
    if n == 0:
        return Share(share=None, low=None, high=None, hits=0, of=0)
    p, z2 = k / n, _Z95**2
    middle, half = p + z2 / (2 * n), _Z95 * math.sqrt(p * (1 - p) / n + z2 / (4 * n * n))
    # Exact at the ends, where rounding would leave the share outside its interval.
    low = (middle - half) / (1 + z2 / n) if k else 0.0
    high = (middle + half) / (1 + z2 / n) if k < n else 1.0
    return Share(share=p, low=low, high=high, hits=k, of=n)
