"""The cart as the axis reads it beside the cart as motion capture shows it: how late are the cameras? Pure.

Stamps say when a pose was taken; what tracking and cameras take before that they do not say. It shows while the cart
moves: motion capture's steps are the axis's own of a while ago. For each of a few lags the squares of what is left
between the two are summed and slowly forgotten; the lag that leaves least is the delay.
"""

from collections import deque
from collections.abc import Sequence

STEP_NS = 10_000_000
LAGS_NS = tuple(step * STEP_NS for step in range(16))  # 0 to 150 ms
KEPT_NS = 400_000_000  # of the axis: the longest lag behind a frame that is itself late
AHEAD_NS = 50_000_000  # that a reading is carried on at its rate
FORGOTTEN = 0.03  # of the sums in a tick in which the cart moves: they are of about a second
MOVING_M = 0.003  # in a step
TELLING_M = 0.01  # that lags either side, 30 ms off, must leave more than the best
EITHER_SIDE = 3  # lags
MIRRORED_M2 = 5e-4  # of squared steps: about 50 mm in a few ticks


class Past:
    """What a device read of a quantity and of its rate, for a while back."""

    def __init__(self) -> None:
        self._readings: deque[tuple[int, float, float]] = deque()  # stamp, value, rate (1/s); oldest first

    def add(self, t_ns: int, value: float, rate: float = 0.0) -> None:
        """Take in the newest reading, if it is a new one."""
        readings = self._readings
        if readings and t_ns <= readings[-1][0]:
            return
        readings.append((t_ns, value, rate))
        while t_ns - readings[0][0] > KEPT_NS:
            readings.popleft()

    def at(self, t_ns: int) -> tuple[float, float] | None:
        """Value and rate at an instant; None where no reading is near."""
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
    """How far motion capture is behind the axis, and how far from it."""

    def __init__(self) -> None:
        self.axis = Past()  # m, m/s
        self.lag_ns: int | None = None  # None until the cart has moved enough to tell
        self._before: tuple[int, float, tuple[float, ...]] | None = None  # stamp, cart, the axis at each lag
        self.restart()

    def restart(self) -> None:
        """Forget what the steps told: they are told anew whenever the arm is armed."""
        self.lag_ns = None
        self._shown_m2 = 0.0  # squared steps of motion capture
        self._axis_m2 = [0.0] * len(LAGS_NS)  # squared steps of the axis at each lag
        self._both_m2 = [0.0] * len(LAGS_NS)  # the products of the two

    def see(self, t_ns: int, cart_y_m: float) -> float | None:
        """Take in a tick's newest frame; how far the cart is from the axis, m. None where that cannot be said.

        As long as the lag is not known any that is possible may explain the distance.
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
        """Motion capture's cart moves against the axis: that leaves far less than moving with it, whatever the lag."""
        return self._shown_m2 > MIRRORED_M2 and 4 * min(self._left(-1)) < min(self._left(1))

    def _step(self, step_ns: int, shown_m: float, now_m: Sequence[float], before_m: Sequence[float]) -> None:
        steps_m = [now - before for now, before in zip(now_m, before_m, strict=True)]
        if step_ns > KEPT_NS or max(map(abs, steps_m)) < MOVING_M:
            return
        self._shown_m2 += shown_m * shown_m - FORGOTTEN * self._shown_m2
        for place, step_m in enumerate(steps_m):
            self._axis_m2[place] += step_m * step_m - FORGOTTEN * self._axis_m2[place]
            self._both_m2[place] += shown_m * step_m - FORGOTTEN * self._both_m2[place]
        self._estimate()

    def _left(self, sense: int) -> list[float]:
        """Squared steps that the axis, in this sense, does not explain, at each lag."""
        return [
            self._shown_m2 - 2 * sense * both + axis for both, axis in zip(self._both_m2, self._axis_m2, strict=True)
        ]

    def _estimate(self) -> None:
        left = self._left(1)
        best = min(range(len(left)), key=left.__getitem__)
        sides = [left[place] for place in (best - EITHER_SIDE, best + EITHER_SIDE) if 0 <= place < len(left)]
        # Both must move, alike, and at no other lag as much alike: a slip of the axis alone tells no lag.
        if min(*sides, self._shown_m2) < 4 * left[best] + TELLING_M**2:
            return
        lag = float(best)
        if 0 < best < len(left) - 1:
            low, high = left[best - 1], left[best + 1]
            lag += 0.5 * (low - high) / (low - 2 * left[best] + high)
        self.lag_ns = round(lag * STEP_NS)


def _outside(value: float, path: Sequence[float]) -> float:
    """How far a place is from a path on a line."""
    return max(min(path) - value, value - max(path), 0.0)
