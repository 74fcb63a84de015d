"""The server's clock by this host's: echoes, of which the quick ones count, and a line for the drift between them."""

import math
from typing import NamedTuple

BUCKET_NS = 1_000_000_000  # of the echoes in a second the quickest is kept
BUCKETS = 60
FUZZ_NS, FUZZ = 20_000, 0.05  # an echo that took so much longer than the quickest counts a quarter
LINE_NS, LINE_ECHOES = 2e9, 4  # how wide apart, and how many, echoes have to be for a line
DRIFT_TYPICAL, DRIFT_DOUBT, DRIFT_MAX = 100e-6, 5e-6, 500e-6  # of quartz; once it was seen; beyond it is no clock
STEP_NS = 500_000  # what an echo may be off by; a clock that was set, or another server, is off by more
STEPS = 2  # so often in a row
FEW = 5  # echoes before stamps are given


class Exchange(NamedTuple):
    """One echo: when it was asked for and answered here, and what the server's clock said in between, all in ns."""

    asked: int
    answered: int
    there: int

    @property
    def took(self) -> int:
        """The whole way."""
        return self.answered - self.asked

    @property
    def offset(self) -> float:
        """Here less there, if both ways took as long."""
        return self.asked + self.took / 2 - self.there

    def excludes(self, offset: float, tolerance: float) -> bool:
        """Whether an offset is impossible: the server answered after the question and before its answer."""
        return not self.asked - tolerance <= self.there + offset <= self.answered + tolerance


class EchoClock:
    """Ticks of a server as nanoseconds of CLOCK_MONOTONIC here.

    Two clocks run apart by some 1e-5: offsets of the last minute's quickest echoes lie on a line. What makes an echo
    slow makes its offset wrong, by half of that at most, so quick ones count for more; so does a way out that is longer
    than the way back, which no echo shows and `uncertainty_s` counts.
    """

    def __init__(self, hz: int) -> None:
        self.hz = hz
        self.restarts = 0
        self._kept: dict[int, Exchange] = {}  # by the second
        self._odd: list[Exchange] = []
        self._heard = 0
        self._at = 0  # of the line's middle
        self._offset = self._drift = 0.0
        self._lined = False
        # How wrong a stamp may be: half of the way there and back, and what the drift's error makes of an echo's age.
        self.uncertainty_s = math.inf

    @property
    def is_ready(self) -> bool:
        """Whether `here_ns` may be asked."""
        return self._heard >= FEW

    @property
    def drift_ppm(self) -> float:
        """By how much the server's clock is slower than this one."""
        return self._drift * 1e6

    @property
    def offset_s(self) -> float:
        """This host's clock less the server's."""
        return self._offset / 1e9

    def there_ns(self, ticks: int) -> int:
        """Ticks in nanoseconds."""
        return ticks * 1_000_000_000 // self.hz

    def here_ns(self, ticks: int) -> int:
        """When the server's clock said that, by this host's clock."""
        there = self.there_ns(ticks)
        return there + round(self._offset_at(there))

    def hear(self, asked_ns: int, answered_ns: int, ticks: int) -> None:
        """Take an echo; an impossible one is left out."""
        exchange = Exchange(asked_ns, answered_ns, self.there_ns(ticks))
        if exchange.took < 0:
            return
        if self._kept and exchange.excludes(self._offset_at(exchange.there), STEP_NS + 1e9 * self.uncertainty_s):
            self._odd.append(exchange)
            if len(self._odd) < STEPS:
                return
            self._kept, self._drift, self._heard, self._lined = {}, 0.0, 0, False
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
        self._heard += 1
        while len(self._kept) > BUCKETS:
            del self._kept[min(self._kept)]

    def _offset_at(self, there: int) -> float:
        return self._offset + self._drift * (there - self._at)

    def _fit(self) -> None:
        """A line through the echoes, each counted by how quick it was; while they are too few, the best one."""
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
        first = kept[0].offset  # far numbers would cost digits
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
