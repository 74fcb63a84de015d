"""Braking, acceleration and drag of the cart, stretch by stretch, from the axis read-back.

In a stretch of braking every set-point that may be acting requests a velocity below the cart's by more than the drive's
proportional zone, and at one point a much lower one. Its value is the constant deceleration over the same distance,
(v0^2 - v1^2) / 2 s, as in the braking law. A stretch of acceleration counts with its steepest interval. Drag is the
excess of the cart's velocity over its velocity one latency ago and over all set-points that may have acted since.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from softarm.daemon.limits.latency import GAP_MAX_S
from softarm.recordings.rail_motion import Array, RailMotion

ZONE_M_S = 0.1  # this close to its set-point a drive need not use its full ramp
ASKED_M_S = 2 * ZONE_M_S  # velocity that a stretch of braking must lose


class Stretches(NamedTuple):
    """Value and duration of each stretch [N]."""

    values: Array  # m/s^2, of a drag m/s
    seconds: Array


class _InForce(NamedTuple):
    """Range of the set-points that may have acted in each interval between readings."""

    highest_m_s: Array
    lowest_m_s: Array
    known: NDArray[np.bool_]  # only set-points moved the cart


def brakings(motion: RailMotion, earliest_s: float, latest_s: float) -> Stretches:
    """Return the deceleration of every stretch of braking, negative if the arm pulled harder than the drive.

    Set-points act between `earliest_s` and `latest_s` after they are sent.
    """
    acting, found = _in_force(motion, earliest_s, latest_s), []
    for sign, furthest in ((1.0, acting.highest_m_s), (-1.0, -acting.lowest_m_s)):
        velocity = sign * motion.velocity_m_s
        asked = np.maximum(furthest, 0.0)
        slower, faster = np.minimum(velocity[:-1], velocity[1:]), np.maximum(velocity[:-1], velocity[1:])
        for first, last in _runs(acting.known & (slower - asked > ZONE_M_S)):
            way_m = sign * (motion.position_m[last] - motion.position_m[first])
            if (faster - asked)[first:last].max() > ASKED_M_S:
                lost = velocity[first] ** 2 - velocity[last] ** 2
                found.append((lost / (2 * way_m), motion.t_s[last] - motion.t_s[first]))
    return _stretches(found)


def surges(motion: RailMotion, earliest_s: float, latest_s: float) -> Stretches:
    """Return the steepest acceleration of every stretch in which the cart gained speed towards a set-point."""
    acting, found = _in_force(motion, earliest_s, latest_s), []
    for sign, furthest in ((1.0, acting.highest_m_s), (-1.0, -acting.lowest_m_s)):
        velocity = sign * motion.velocity_m_s
        slope = np.diff(velocity) / np.diff(motion.t_s)
        for first, last in _runs(acting.known & (slope > 0.0) & (furthest > velocity[:-1])):
            if velocity[last] - velocity[first] > ZONE_M_S:
                found.append((float(slope[first:last].max()), motion.t_s[last] - motion.t_s[first]))
    return _stretches(found)


def drags(motion: RailMotion, earliest_s: float, latest_s: float) -> Stretches:
    """Return the drag in every second in which the cart moved; 0 if it stayed below its set-points."""
    acting, spacing_s = _in_force(motion, earliest_s, latest_s), float(np.median(np.diff(motion.t_s)))
    unseen = max(1, round(latest_s / spacing_s))  # intervals
    if len(acting.known) < unseen:
        return _stretches([])
    now, then = motion.velocity_m_s[unseen:], motion.velocity_m_s[:-unseen]
    highest, lowest, known = (sliding_window_view(each, unseen) for each in acting)
    top = np.maximum(np.maximum(highest.max(axis=1), then), 0.0)
    bottom = np.minimum(np.minimum(lowest.min(axis=1), then), 0.0)
    lead = np.where(known.all(axis=1), np.maximum(np.maximum(now - top, bottom - now), 0.0), -1.0)
    moving = known.all(axis=1) & (np.abs(now) > ZONE_M_S)
    seconds = np.floor(motion.t_s[unseen:] - motion.t_s[0]).astype(np.int64)
    return _stretches([(float(lead[rows].max()), 1.0) for rows in _each(seconds) if moving[rows].any()])


def _each(labels: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
    """Yield the indices of each label; equal labels are adjacent."""
    yield from np.split(np.arange(len(labels)), np.flatnonzero(np.diff(labels)) + 1)


def _stretches(found: list[tuple[float, float]]) -> Stretches:
    table = np.array(found, dtype=np.float64).reshape(-1, 2)
    return Stretches(table[:, 0], table[:, 1])


def _runs(selected: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """Yield the first and last reading of each run of intervals."""
    edges = np.flatnonzero(np.diff(selected.astype(np.int8), prepend=0, append=0))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def _in_force(motion: RailMotion, earliest_s: float, latest_s: float) -> _InForce:
    t_s = motion.t_s
    first = np.searchsorted(motion.sent_s, t_s[:-1] - latest_s + 1e-9, side="right") - 1
    last = np.searchsorted(motion.sent_s, t_s[1:] - earliest_s + 1e-9, side="right") - 1
    known = (first >= 0) & (np.diff(t_s) <= GAP_MAX_S)
    first = np.maximum(first, 0)
    last = np.maximum(last, first)
    highest = lowest = motion.set_point_m_s[first]
    for ahead in range(int((last - first).max(initial=0)) + 1):
        sent = np.minimum(first + ahead, last)
        highest = np.maximum(highest, motion.set_point_m_s[sent])
        lowest = np.minimum(lowest, motion.set_point_m_s[sent])
        known = known & motion.obeyed[sent]
    return _InForce(highest, lowest, known)
