"""Simple cart with known limits: a drive that ramps late and an arm that pulls."""

import math
from collections import deque
from pathlib import Path

import numpy as np
import pytest

from softarm.recordings.rail_motion import RailMotion

TICK_S, STEP_S = 1 / 30, 0.002
SOFT_S = 0.02  # of the drive's velocity loop near its set-point


def _cart(
    ramp_m_s2: float = 6.0,
    latency_s: float = 1 / 30,
    pull_m_s2: float = 0.0,
    *,
    seconds: float = 45.0,
    age_s: float = 0.0,
    filter_s: float = 0.0,
    quantum_m_s: float = 1e-3,
    jitter_s: float = 0.0,
    late: tuple[float, float] = (0.0, 0.0),
    top_m_s: float = 0.9,
    seed: int = 1,
) -> RailMotion:
    """Cart with random set-points to and fro, read once a tick.

    age_s: so much older than its stamp a reading is; filter_s: of its velocity; jitter_s: by which stamps are late at
    most. late: a share of the set-points, and by how much later than `latency_s` they act.
    """
    rng = np.random.default_rng(seed)
    rate_hz, phase = rng.uniform(1.0, 1.6), rng.uniform(0, 2 * math.pi)
    target = position = velocity = shown = 0.0
    past: deque[tuple[float, float]] = deque([(0.0, 0.0)], maxlen=round(age_s / STEP_S) + 1)
    under_way: deque[tuple[float, float]] = deque()
    sent, readings, ticks_left = [], [], 0
    for k in range(round(seconds / STEP_S)):
        t = k * STEP_S
        if t >= len(sent) * TICK_S - 1e-9:
            readings.append((t + rng.uniform(0, jitter_s), *past[0]))
            if ticks_left == 0:
                ticks_left = int(rng.integers(3, 10))
                wanted = 0.0 if rng.random() < 0.3 else rng.uniform(0.3, top_m_s)
                wanted *= -np.sign(position) if abs(position) > 0.08 else rng.choice((-1, 1))
            ticks_left -= 1
            sent.append((t, wanted))
            under_way.append((t + latency_s + (late[1] if rng.random() < late[0] else 0.0), wanted))
        while under_way and under_way[0][0] <= t + 1e-9:
            target = under_way.popleft()[1]
        gap = target - velocity
        own = math.copysign(min(ramp_m_s2, abs(gap) / SOFT_S), gap)
        velocity += (own + pull_m_s2 * math.sin(2 * math.pi * rate_hz * t + phase)) * STEP_S
        position += velocity * STEP_S
        shown += (velocity - shown) * (STEP_S / filter_s if filter_s else 1.0)
        past.append((position, round(shown / quantum_m_s) * quantum_m_s))
    sent_s, set_points = np.array(sent).T
    return RailMotion(Path("cart"), sent_s, set_points, np.ones(len(sent), dtype=bool), *np.array(readings).T)


@pytest.fixture
def cart():
    return _cart
