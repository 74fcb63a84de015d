"""Braking clamp of the daemon for a batch, so that policies learn with the clamp of their flights."""

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from softarm.schemas.config import DryveRail, RailLimits

Array = NDArray[np.float32]


def acting_ages_s(limits: RailLimits, period_s: float) -> list[float]:
    """Return the ages in s, oldest first, of the commands that act from now on and until now, one each `period_s`."""
    count = math.ceil(limits.latency_s / period_s - 1e-9) + 1
    return [age * period_s for age in range(count, 0, -1)]


class RailGuard:
    """Clamp of a batch's velocity commands by the braking law, with a memory of commands that still act."""

    def __init__(self, robots: int, period_s: float, limits: RailLimits | None = None) -> None:
        """Prepare a clamp with a command every `period_s`, undelayed readings and the daemon's configuration."""
        limits = limits or RailLimits()
        self._law = limits.braking_law(DryveRail().hold_s).in_float32()
        self._velocity_max_m_s = limits.velocity_max_m_s
        self._ages_s = acting_ages_s(limits, period_s)
        before = len(self._ages_s)
        self._sent: deque[Array] = deque((np.zeros(robots, dtype=np.float32) for _ in range(before)), maxlen=before)

    @property
    def sent_m_s(self) -> Array:
        """Earlier commands, float32 [commands, R], the newest last."""
        return np.stack(self._sent)

    @sent_m_s.setter
    def sent_m_s(self, sent: Array) -> None:
        self._sent.extend(sent)

    def reset(self, robots: NDArray[np.bool_]) -> None:
        """Set the earlier commands of robots [R] to zero."""
        for sent in self._sent:
            sent[robots] = 0.0

    def replace(self, sent_m_s: Array) -> None:
        """Replace the last commands [R] by those that were sent."""
        self._sent[-1] = sent_m_s.copy()

    def apply(self, wanted_m_s: Array, position_m: Array, velocity_m_s: Array) -> Array:
        """Return commands that keep the carts inside the limits, float32 [R]."""
        wanted = np.clip(wanted_m_s, -self._velocity_max_m_s, self._velocity_max_m_s)
        sent = list(zip(self._ages_s, self._sent, strict=True))
        bounded = self._law.bound(wanted, position_m, velocity_m_s, sent=sent).velocity_m_s
        self._sent.append(bounded)
        return bounded.copy()
