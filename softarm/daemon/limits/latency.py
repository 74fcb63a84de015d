"""Latency of set-points, measured step by step from the axis read-back.

Each large step of the set-point has a window of readings. The model: the drive accelerates with its ramp towards the
active set-point, in proportion within a narrow zone around it; the arm's pull is a parabola in time. The residuals for
each latency of a grid give the latency and its uncertainty. A delay or filter in the velocity read-back counts as
latency, since the safety filter sees the same read-back.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from softarm.recordings.rail_motion import Array, RailMotion

STEP_MIN_M_S = 0.25  # smaller steps are masked by the arm's pull
ZONES_M_S = (0.03, 0.06, 0.1, 0.2)  # candidate widths of the zone with proportional acceleration
LATEST_S, GRID_S = 0.2, 0.002
BEFORE, AFTER = 2, 9  # intervals of a window before and after its step
GAP_MAX_S = 0.06  # between readings
APART_S = 0.2  # between the steps of two windows
PULL_ORDER = 2  # of the polynomial for the arm's pull
LIKELY = 10.0  # additional loss, in variances of a reading's noise, that is still likely
WIDTH_MAX_S = 0.03  # of the likely range; wider windows are not used
SAMPLES = 12  # of the set-point within an interval
MOST = 4000  # windows used, evenly spaced

_LATENCIES: Array = np.arange(0.0, LATEST_S + GRID_S / 2, GRID_S)


class StepLatencies(NamedTuple):
    """Latency of each conclusive step [N], and the ramp that fits all of them best."""

    surely_s: Array  # lower end of the likely range
    likeliest_s: Array
    ramp_m_s2: float  # 0 without a step


class _Fit(NamedTuple):
    """Fit of all windows [N] with a common ramp and zone."""

    loss: Array  # [N, latencies]
    ramp_m_s2: float
    total: float  # loss at the best common latency


def step_latencies(motions: Iterable[RailMotion]) -> StepLatencies:
    """Return the latency of every conclusive step, from all recordings of one drive."""
    motions = tuple(motions)
    windows = [(motion, rows) for motion in motions for rows in _windows(motion)]
    if not windows:
        return StepLatencies(np.empty(0), np.empty(0), 0.0)
    windows = windows[:: -(-len(windows) // MOST)]
    gained = np.stack([np.diff(motion.velocity_m_s[rows]) for motion, rows in windows])
    fit = min((_fitted(_pushed(windows, zone), gained) for zone in ZONES_M_S), key=lambda each: each.total)
    least, freedom = fit.loss.min(axis=1), gained.shape[1] - PULL_ORDER - 2
    noise = np.maximum(np.median(least), least) / freedom
    likely = fit.loss < (least + LIKELY * noise)[:, None]
    first, last = likely.argmax(axis=1), likely.shape[1] - 1 - likely[:, ::-1].argmax(axis=1)
    conclusive = (last - first) * GRID_S <= WIDTH_MAX_S
    return StepLatencies(_LATENCIES[first[conclusive]], _LATENCIES[fit.loss.argmin(axis=1)[conclusive]], fit.ramp_m_s2)


def _fitted(pushed: Array, gained: Array) -> _Fit:
    """pushed: [N, intervals, latencies] seconds at full ramp towards +y; gained: m/s [N, intervals]."""
    powers = np.linspace(-1.0, 1.0, gained.shape[1])[:, None] ** np.arange(PULL_ORDER + 1)
    pull = np.linalg.qr(powers)[0]
    pushed = pushed - np.einsum("ip,npl->nil", pull, np.einsum("jp,njl->npl", pull, pushed))
    gained = gained - gained @ pull @ pull.T
    alike, across = (pushed**2).sum(axis=1), np.einsum("nil,ni->nl", pushed, gained)
    squares = (gained**2).sum(axis=1)
    # One ramp for all steps: the one that fits best where one latency for all does.
    together = squares.sum() - across.sum(axis=0) ** 2 / np.maximum(alike.sum(axis=0), 1e-12)
    best = int(together.argmin())
    ramp = float(across[:, best].sum() / max(alike[:, best].sum(), 1e-12))
    return _Fit(squares[:, None] - 2 * ramp * across + ramp**2 * alike, ramp, float(together[best]))


def _windows(motion: RailMotion) -> NDArray[np.int64]:
    """Return the indices of the readings around each large step [N, intervals + 1]."""
    t_s, count = motion.t_s, BEFORE + AFTER
    first = np.searchsorted(t_s, _steps_s(motion)) - BEFORE
    first = first[(first >= 0) & (first + count < len(t_s))]
    rows = first[:, None] + np.arange(count + 1)
    whole = (np.diff(t_s[rows], axis=1) <= GAP_MAX_S).all(axis=1) & _obeyed(motion, t_s[rows[:, 0]], t_s[rows[:, -1]])
    return np.asarray(rows[whole])


def _steps_s(motion: RailMotion) -> Array:
    """Return the times of large steps of the set-point, at least APART_S apart."""
    large = np.flatnonzero(np.abs(np.diff(motion.set_point_m_s)) >= STEP_MIN_M_S) + 1
    found: list[float] = []
    for at_s in motion.sent_s[large].tolist():
        if not found or at_s - found[-1] >= APART_S:
            found.append(at_s)
    return np.array(found)


def _obeyed(motion: RailMotion, start_s: Array, end_s: Array) -> NDArray[np.bool_]:
    """Return whether only set-points moved the cart from the longest latency before `start_s` on."""
    first = np.searchsorted(motion.sent_s, start_s - LATEST_S, side="right") - 1
    last = np.searchsorted(motion.sent_s, end_s, side="right")
    ignored = np.concatenate(([0], np.cumsum(~motion.obeyed)))
    return np.asarray((first >= 0) & (ignored[last] == ignored[np.maximum(first, 0)]))


def _pushed(windows: Sequence[tuple[RailMotion, NDArray[np.int64]]], zone_m_s: float) -> Array:
    """Return the time at full acceleration towards +y in each interval, s [N, intervals, latencies]."""
    share = (np.arange(SAMPLES) + 0.5) / SAMPLES
    pushed = np.empty((len(windows), BEFORE + AFTER, len(_LATENCIES)))
    for number, (motion, rows) in enumerate(windows):
        t_s, velocity = motion.t_s[rows], motion.velocity_m_s[rows]
        steps_s = np.diff(t_s)[:, None]
        at_s = t_s[:-1, None] + steps_s * share
        at_m_s = velocity[:-1, None] + np.diff(velocity)[:, None] * share
        sent = np.searchsorted(motion.sent_s, at_s[..., None] - _LATENCIES + 1e-9, side="right") - 1
        gap = motion.set_point_m_s[np.maximum(sent, 0)] - at_m_s[..., None]
        pushed[number] = np.clip(gap / zone_m_s, -1.0, 1.0).mean(axis=1) * steps_s
    return pushed
