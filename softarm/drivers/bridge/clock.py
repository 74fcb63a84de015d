"""Conversion of the server's clock to this host's: offsets of quick echoes, and a line for the drift."""

import math
from typing import NamedTuple

# The quickest echo of each second is kept.
BUCKET_NS = 1_000_000_000
BUCKETS = 60
# An echo that takes so much longer than the quickest has a quarter of its weight.
FUZZ_NS, FUZZ = 20_000, 0.05
# Width and number of echoes that a line needs.
LINE_NS, LINE_ECHOES = 2e9, 4
# Drift of a typical quartz, uncertainty of a measured drift, and the largest drift that is accepted.
DRIFT_TYPICAL, DRIFT_DOUBT, DRIFT_MAX = 100e-6, 5e-6, 500e-6
# A larger error in so many echoes in a row means that the clock was set, or the server was replaced.
STEP_NS = 500_000
STEPS = 2
# Echoes needed before frames are stamped.
ECHOES_MIN = 5


class Exchange(NamedTuple):
    """One echo: times of request and answer on this host, and the server's time in between, all in ns."""

    asked: int
    answered: int
    there: int

    @property
    def took(self) -> int:
        """Round-trip time of the echo, ns."""
        return self.answered - self.asked

    @property
    def offset(self) -> float:
        """Offset of this host's clock from the server's, if both directions took equally long."""
        return self.asked + self.took / 2 - self.there

    def excludes(self, offset: float, tolerance: float) -> bool:
        """Return whether an offset is impossible: the server answered between request and answer."""
        return not self.asked - tolerance <= self.there + offset <= self.answered + tolerance


class EchoClock:
    """Conversion of a server's ticks to nanoseconds of CLOCK_MONOTONIC on this host.

    Two clocks drift by about 1e-5, so the offsets of the last minute's quickest echoes are on a line. A delay of an
    echo makes its offset wrong by at most half the delay, so quick echoes have more weight. `uncertainty_s` is the
    largest error of a stamp: half the round trip, for unequal directions, and the drift's error over an echo's age.
    """

    def __init__(self, hz: int) -> None:
        self.hz = hz
        self.restarts = 0
        # By the second.
        self._kept: dict[int, Exchange] = {}
        self._odd: list[Exchange] = []
        self._count = 0
        # Time at which the offset holds.
        self._at = 0
        self._offset = self._drift = 0.0
        self._lined = False
        self.uncertainty_s = math.inf

    @property
    def is_ready(self) -> bool:
        """Whether `here_ns` is usable."""
        return self._count >= ECHOES_MIN

    @property
    def drift_ppm(self) -> float:
        """Drift of the server's clock; positive if it is slower than this host's."""
        return self._drift * 1e6

    @property
    def offset_s(self) -> float:
        """Offset of this host's clock from the server's."""
        return self._offset / 1e9

    def there_ns(self, ticks: int) -> int:
        """Return ticks in nanoseconds."""
        return ticks * 1_000_000_000 // self.hz

    def here_ns(self, ticks: int) -> int:
        """Return the time of this host's clock for ticks of the server's clock."""
        there = self.there_ns(ticks)
        return there + round(self._offset_at(there))

    def add(self, asked_ns: int, answered_ns: int, ticks: int) -> None:
        """Add an echo; an impossible one is ignored."""
        exchange = Exchange(asked_ns, answered_ns, self.there_ns(ticks))
        if exchange.took < 0:
            return
        if self._kept and exchange.excludes(self._offset_at(exchange.there), STEP_NS + 1e9 * self.uncertainty_s):
            self._odd.append(exchange)
            if len(self._odd) < STEPS:
                return
            self._kept, self._drift, self._count, self._lined = {}, 0.0, 0, False
            self.restarts += 1
            for each in self._odd:
                self._keep(each)
        self._odd = []
        self._keep(exchange)
        self._fit()

    def _keep(self, exchange: Exchange) -> None:
        second = exchange.answered // BUCKET_NS
        best = self._kept.get(second)
        if best is None or exchange.took <= best.took:
            self._kept[second] = exchange
        self._count += 1
        while len(self._kept) > BUCKETS:
            del self._kept[min(self._kept)]

    def _offset_at(self, there: int) -> float:
        return self._offset + self._drift * (there - self._at)

    def _fit(self) -> None:
        """Fit a line through the echoes, weighted by their speed; with too few, use the best one."""
        kept = list(self._kept.values())
        now = max(each.there for each in kept)
        quickest = min(each.took for each in kept)
        weights = [(FUZZ_NS + FUZZ * quickest + each.took - quickest) ** -2.0 for each in kept]
        times = [float(each.there - now) for each in kept]
        middle = _mean(times, weights)
        width = math.sqrt(_mean([(t - middle) ** 2 for t in times], weights))
        if width < LINE_NS or math.fsum(weights) ** 2 < LINE_ECHOES * math.fsum(w * w for w in weights):
            doubt = DRIFT_DOUBT if self._lined else DRIFT_TYPICAL
            best = min(kept, key=lambda each: each.took / 2 + doubt * (now - each.there))
            self._at, self._offset = best.there, best.offset
            self.uncertainty_s = (best.took / 2 + doubt * (now - best.there)) / 1e9
            return
        # Large numbers would cost digits.
        first = kept[0].offset
        offsets = [each.offset - first for each in kept]
        mean = _mean(offsets, weights)
        slope = _mean([(t - middle) * (o - mean) for t, o in zip(times, offsets, strict=True)], weights) / width**2
        self._drift = min(max(slope, -DRIFT_MAX), DRIFT_MAX)
        self._at, self._offset, self._lined = now, first + mean - self._drift * middle, True
        rests = [o - mean - self._drift * (t - middle) for t, o in zip(times, offsets, strict=True)]
        spread_ns = math.sqrt(_mean([rest**2 for rest in rests], weights))
        halves = _mean([each.took / 2 for each in kept], weights)
        self.uncertainty_s = (halves + spread_ns * (1 - middle / width)) / 1e9


def _mean(values: list[float], weights: list[float]) -> float:
    return math.fsum(v * w for v, w in zip(values, weights, strict=True)) / math.fsum(weights)
