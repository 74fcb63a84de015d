"""Soak test in lockstep: days of simulated time by the real control loop, as fast as one core allows."""

import os
import random
from collections import Counter
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from softarm.daemon.control.records import EStop, Mode, Outputs, Request
from softarm.daemon.runtime.offline import Lockstep
from softarm.policies import registry
from softarm.schemas.config import Config
from softarm.schemas.flights import TEST_TARGETS
from softarm.schemas.robot import CONTROL_RATE_HZ
from validation.soak import growth
from validation.soak.clients import Unexpected
from validation.soak.growth import Slope, slope

DAY_TICKS = 86_400 * CONTROL_RATE_HZ
SAMPLES = 400  # per run, at least EVERY_TICKS apart
EVERY_TICKS = 2 * CONTROL_RATE_HZ
# Growth per simulated day that does not count as a leak.
ALLOWED = {"memory_mb": 1.0, "descriptors": 0.5, "threads": 0.5}
FLYING = (Mode.ARMING, Mode.ARMED)
UNEXPECTED_MAX = 100  # are reported
CHANGE_SHARE = 0.02  # share of goals before which the arm is disarmed, or stopped and acknowledged


class Sample(NamedTuple):
    """Resources of this process at a simulated time."""

    day: float
    memory_mb: float
    descriptors: int
    threads: int


class Stepped(NamedTuple):
    """Result of a soak test in lockstep."""

    seed: int
    days: float
    samples: list[Sample]
    slopes: dict[str, Slope]  # a simulated day
    counts: dict[str, int]
    unexpected: list[Unexpected]
    cart_max_m: float


def soak(days: float, seed: int, policy: str, on_progress: Callable[[float], None]) -> Stepped:
    """Fly goals for `days` of simulated time; `on_progress` receives the share done. Raises PolicyError."""
    return _Flight(seed, policy).fly(round(days * DAY_TICKS), on_progress)


class _Flight:
    def __init__(self, seed: int, policy: str) -> None:
        self._seed, self._chance = seed, random.Random(seed)
        self._daemon = Lockstep(Config(), registry.load(policy))
        self._counts: Counter[str] = Counter()
        self._unexpected: list[Unexpected] = []
        self._cart_max_m = 0.0
        self._ticks = 0
        self._asked = False  # a stop or a disarm was requested
        self._samples: list[Sample] = []

    def fly(self, ticks: int, on_progress: Callable[[float], None]) -> Stepped:
        every = max(EVERY_TICKS, ticks // SAMPLES)
        outputs = self._daemon.tick()
        for self._ticks in range(1, ticks + 1):
            outputs = self._look(outputs, self._daemon.tick(*self._requests(outputs)))
            if self._ticks % every == 0:
                now = growth.usage_of([os.getpid()])
                self._samples.append(Sample(self._ticks / DAY_TICKS, now.memory_mb, now.descriptors, now.threads))
                on_progress(self._ticks / ticks)
        found = self._samples
        slopes = {
            name: slope([s.day for s in found], [getattr(s, name) for s in found], allowed, np.min)
            for name, allowed in ALLOWED.items()
        }
        counts = dict(sorted(self._counts.items()))
        return Stepped(self._seed, ticks / DAY_TICKS, found, slopes, counts, self._unexpected, self._cart_max_m)

    def _requests(self, outputs: Outputs) -> list[Request]:
        """Return the next requests of an operator."""
        daemon, busy = self._daemon, outputs.goal.state == "running"
        if outputs.estop is EStop.LATCHED:
            return [daemon.request("acknowledge")]
        if outputs.mode is Mode.DISARMED and not outputs.arming_refusals:
            self._asked = False
            return [daemon.request("arm")]
        if outputs.mode is not Mode.ARMED or busy:
            return []
        if self._chance.random() < CHANGE_SHARE:
            self._asked = True
            kind = self._chance.choice(("disarm", "stop"))
            self._counts[f"asked: {kind}"] += 1
            return [daemon.request("disarm" if kind == "disarm" else "stop")]
        self._counts["goals"] += 1
        return [daemon.request("goal", self._chance.choice(TEST_TARGETS))]

    def _look(self, before: Outputs, now: Outputs) -> Outputs:
        self._cart_max_m = max(self._cart_max_m, abs(self._daemon.robot.body.truth.cart_position_m))
        if before.goal.state == "running" and now.goal.state == "reached":
            self._counts["reached"] += 1
        if before.mode in FLYING and now.mode not in FLYING and not self._asked:
            self._note(f"stopped: {now.last_stop}")
        for result in now.results:
            if result not in before.results and not result.accepted:
                self._note(f"refused: {'; '.join(result.reasons)}")
        return now

    def _note(self, what: str) -> None:
        if len(self._unexpected) < UNEXPECTED_MAX:
            self._unexpected.append(Unexpected(self._ticks / CONTROL_RATE_HZ, what, None))
