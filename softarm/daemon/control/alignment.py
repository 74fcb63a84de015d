"""Latency of motion capture, estimated by comparing its cart with the axis read-back. Pure.

Capture stamps leave out the delay of cameras and tracking. While the cart moves, motion capture's steps equal earlier
steps of the axis. For each candidate lag the squared residuals are summed with exponential forgetting; the lag with the
smallest sum is the latency.
"""

from collections import deque
from collections.abc import Sequence

STEP_NS = 10_000_000
LAGS_NS = tuple(step * STEP_NS for step in range(16))  # 0 to 150 ms
KEPT_NS = 400_000_000  # history of the axis: the longest lag behind a late frame
AHEAD_NS = 50_000_000  # longest extrapolation of the newest reading
FORGOTTEN = 0.03  # share forgotten per tick in which the cart moves: a window of about a second
MOVING_M = 0.003  # a larger step counts as movement
DISTINCT_M = 0.01  # by which the residual at neighbouring lags must exceed the smallest
NEIGHBOURS = 3  # lags, 30 ms
MIRRORED_M2 = 5e-4  # sum of squared steps: about 50 mm in a few ticks


class ReadingHistory:
    """Recent readings of a quantity and its rate."""

    def __init__(self) -> None:
        self._readings: deque[tuple[int, float, float]] = deque()  # stamp, value, rate (1/s); oldest first

    def add(self, t_ns: int, value: float, rate: float = 0.0) -> None:
        """Add a reading if it is newer than the last."""
        readings = self._readings
        if readings and t_ns <= readings[-1][0]:
            return
        readings.append((t_ns, value, rate))
        while t_ns - readings[0][0] > KEPT_NS:
            readings.popleft()

    def at(self, t_ns: int) -> tuple[float, float] | None:
        """Return value and rate at an instant, or None if no reading is near."""
        readings = self._readings
        if not readings or t_ns < readings[0][0] or t_ns - readings[-1][0] > AHEAD_NS:
            return None
        newest_ns, value, rate = readings[-1]
        if t_ns >= newest_ns:
            return value + rate * (t_ns - newest_ns) * 1e-9, rate
        place = len(readings) - 2
        while readings[place][0] > t_ns:
            place -= 1
        (before_ns, value, rate), (after_ns, next_value, next_rate) = readings[place], readings[place + 1]
        share = (t_ns - before_ns) / (after_ns - before_ns)
        return value + share * (next_value - value), rate + share * (next_rate - rate)


class Alignment:
    """Latency and distance of motion capture relative to the axis."""

    def __init__(self) -> None:
        self.axis = ReadingHistory()  # m, m/s
        self.lag_ns: int | None = None  # None until the cart has moved enough
        self._before: tuple[int, float, tuple[float, ...]] | None = None  # stamp, cart, the axis at each lag
        self.restart()

    def restart(self) -> None:
        """Discard the estimate, to measure again whenever the arm is armed."""
        self.lag_ns = None
        self._mocap_m2 = 0.0  # squared steps of motion capture
        self._axis_m2 = [0.0] * len(LAGS_NS)  # squared steps of the axis at each lag
        self._both_m2 = [0.0] * len(LAGS_NS)  # products of the two at each lag

    def update(self, t_ns: int, cart_y_m: float) -> float | None:
        """Process the newest frame of a tick.

        Returns:
            Distance between cart and axis, m, or None if the axis has no reading at that time. Until the lag is
            known, the smallest distance over all lags.
        """
        places = [self.axis.at(t_ns - lag_ns) for lag_ns in LAGS_NS]
        known = tuple(place[0] for place in places if place is not None)
        if len(known) < len(LAGS_NS):
            self._before = None
            return None
        if self._before is not None:
            self._step(t_ns - self._before[0], cart_y_m - self._before[1], known, self._before[2])
        self._before = (t_ns, cart_y_m, known)
        if self.lag_ns is None:
            return _outside(cart_y_m, known)
        best = round(self.lag_ns / STEP_NS)
        return _outside(cart_y_m, known[max(best - 1, 0) : best + 2])

    @property
    def mirrored(self) -> bool:
        """Return whether motion capture and axis move in opposite directions, at any lag."""
        return self._mocap_m2 > MIRRORED_M2 and 4 * min(self._residual_m2(-1)) < min(self._residual_m2(1))

    def _step(self, step_ns: int, mocap_m: float, now_m: Sequence[float], before_m: Sequence[float]) -> None:
        steps_m = [now - before for now, before in zip(now_m, before_m, strict=True)]
        if step_ns > KEPT_NS or max(map(abs, steps_m)) < MOVING_M:
            return
        self._mocap_m2 += mocap_m * mocap_m - FORGOTTEN * self._mocap_m2
        for place, step_m in enumerate(steps_m):
            self._axis_m2[place] += step_m * step_m - FORGOTTEN * self._axis_m2[place]
            self._both_m2[place] += mocap_m * step_m - FORGOTTEN * self._both_m2[place]
        self._estimate()

    def _residual_m2(self, sense: int) -> list[float]:
        """Return the squared residuals at each lag; sense 1 or -1 is the direction of the axis."""
        return [
            self._mocap_m2 - 2 * sense * both + axis for both, axis in zip(self._both_m2, self._axis_m2, strict=True)
        ]

    def _estimate(self) -> None:
        residual_m2 = self._residual_m2(1)
        best = min(range(len(residual_m2)), key=residual_m2.__getitem__)
        places = (best - NEIGHBOURS, best + NEIGHBOURS)
        sides = [residual_m2[place] for place in places if 0 <= place < len(residual_m2)]
        # Both must move alike, and clearly less alike at other lags: a slip of the axis alone shows no lag.
        if min(*sides, self._mocap_m2) < 4 * residual_m2[best] + DISTINCT_M**2:
            return
        lag = float(best)
        if 0 < best < len(residual_m2) - 1:
            low, high = residual_m2[best - 1], residual_m2[best + 1]
            lag += 0.5 * (low - high) / (low - 2 * residual_m2[best] + high)
        self.lag_ns = round(lag * STEP_NS)


def _outside(value: float, path: Sequence[float]) -> float:
    """Return the distance of a position from a path on a line."""
    return max(min(path) - value, value - max(path), 0.0)
