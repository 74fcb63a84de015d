"""What lies between a command and the device that hears it: a queue with a delay that may vary."""

from collections import deque

import numpy as np


class Wire:
    """Delivers in order, so a late command holds up the next; `delay_s` plus an exponential part of mean `jitter_s`."""

    def __init__(self, delay_s: float, jitter_s: float, random: np.random.Generator) -> None:
        self._delay_s, self._jitter_s, self._random = delay_s, jitter_s, random
        self._queue: deque[tuple[float, float]] = deque()
        self._heard = 0.0

    def send(self, t_s: float, value: float) -> None:
        """Put a command on the wire."""
        arrival = t_s + self._delay_s
        if self._jitter_s:
            arrival += float(self._random.exponential(self._jitter_s))
        self._queue.append((arrival, value))

    def hear(self, t_s: float) -> float:
        """The newest command that has arrived by then; 0 before the first."""
        while self._queue and self._queue[0][0] <= t_s:
            self._heard = self._queue.popleft()[1]
        return self._heard
