"""Transport of commands to a device: a queue with a constant or random delay."""

from collections import deque

import numpy as np


class Wire:
    """Delayed queue: a constant delay plus an exponential jitter; a late command also delays the next one."""

    def __init__(self, delay_s: float, jitter_s: float, random: np.random.Generator) -> None:
        self._delay_s, self._jitter_s, self._random = delay_s, jitter_s, random
        self._queue: deque[tuple[float, float]] = deque()
        self._received = 0.0

    def send(self, t_s: float, value: float) -> None:
        """Send a command at a time, s."""
        arrival = t_s + self._delay_s
        if self._jitter_s:
            arrival += float(self._random.exponential(self._jitter_s))
        self._queue.append((arrival, value))

    def receive(self, t_s: float) -> float:
        """Return the newest command that has arrived by a time, or 0 before the first."""
        while self._queue and self._queue[0][0] <= t_s:
            self._received = self._queue.popleft()[1]
        return self._received
