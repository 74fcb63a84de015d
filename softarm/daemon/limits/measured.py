"""Limits of the rail measured from recordings: worst cases with their amount of data."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from softarm.daemon.limits.latency import AFTER, BEFORE, step_latencies
from softarm.daemon.limits.swings import Stretches, brakings, drags, surges
from softarm.recordings.rail_motion import Array, RailMotion
from softarm.schemas.robot import RAIL_TRAVEL_M

SHARE = 0.99  # of all events that must stay within a limit
SURE = 0.95
SHARE_MIN = 0.95  # a limit that covers less is not given
COUNT_MIN = math.ceil(math.log(1 - SURE) / math.log(SHARE_MIN))  # events: 59
SPACING_S = 1 / 30  # of the readings used; a faster read-back is thinned
STOP_ROOM_M = 0.01  # closer than this, the mechanical stop itself may brake the cart
SCALE_MAX = 0.1  # allowed difference of the velocity from the slope of the position
MOVING_M_S = 0.05
EARLIEST_PERCENT = 5  # percentile of the latencies taken as the earliest effect
NO_STRETCHES = Stretches(np.empty(0), np.empty(0))


class Bound(NamedTuple):
    """Bound that `share` of all events keep, with confidence SURE."""

    value: float
    share: float
    median: float
    events: int
    seconds: float  # total duration of the events


@dataclass(frozen=True, slots=True)
class Measured:
    """Measured limits; a bound is None with fewer than COUNT_MIN events."""

    latency: Bound | None  # s, largest
    surely: Bound | None  # s, the same for the lower end of each step's likely range
    braking: Bound | None  # m/s^2, least
    surge: Bound | None  # m/s^2, largest
    drag: Bound | None  # m/s, largest
    ramp_m_s2: float  # of the drive, approximate
    steps: int  # conclusive steps of the set-point
    brakings: int  # 0 if the latency is unknown
    runs: int
    moving: int  # seconds in which the cart moved
    recordings: int
    seconds: float
    left_out: tuple[str, ...]  # recordings, each with the reason


def tolerance_bound(values: Array, seconds: float, *, least: bool = False) -> Bound | None:
    """Return a bound of SHARE of all values with confidence SURE, for any distribution.

    It is an order statistic (Wilks 1941). With fewer than 299 values it is the most extreme value, which bounds a
    smaller share; with fewer than COUNT_MIN it is None. `seconds` is the total duration of the values.
    """
    count = len(values)
    if count < COUNT_MIN:
        return None
    ordered = np.sort(values) if least else np.sort(-values)
    beyond = _may_lie_beyond(count)
    share = SHARE if beyond is not None else (1 - SURE) ** (1 / count)
    value = float(ordered[beyond or 0])
    return Bound(value if least else -value, share, float(np.median(values)), count, seconds)


def _may_lie_beyond(count: int) -> int | None:
    """Return how many of `count` values may exceed the bound, or None if there are too few values for SHARE."""
    found, below, term = None, 0.0, SHARE**count
    for number in range(count):
        below += term  # probability of at most `number` values beyond the true bound
        if below > 1 - SURE:
            break
        found = number
        term *= (count - number) / (number + 1) * (1 - SHARE) / SHARE
    return found


def measure(motions: Iterable[RailMotion], ramp_m_s2: float) -> Measured:
    """Measure the limits from all recordings with this ramp of the drive that are plausible."""
    kept, left_out = [], []
    for motion in motions:
        reason = _unusable(motion, ramp_m_s2)
        if reason is None:
            kept.append(_thinned(motion))
        else:
            left_out.append(f"{motion.source}: {reason}")
    steps = step_latencies(kept)
    lasted_s = len(steps.surely_s) * (BEFORE + AFTER) * SPACING_S
    latency, surely = (tolerance_bound(each, lasted_s) for each in (steps.likeliest_s, steps.surely_s))
    braked = sped = dragged = NO_STRETCHES
    if latency is not None:  # without it the times of braking are unknown
        earliest_s = float(np.percentile(steps.likeliest_s, EARLIEST_PERCENT))
        braked = _together(brakings(motion, earliest_s, latency.value) for motion in kept)
        sped = _together(surges(motion, earliest_s, latency.value) for motion in kept)
        dragged = _together(drags(motion, earliest_s, latency.value) for motion in kept)
    return Measured(
        latency,
        surely,
        tolerance_bound(braked.values, float(braked.seconds.sum()), least=True),
        tolerance_bound(sped.values, float(sped.seconds.sum())),
        tolerance_bound(dragged.values, float(dragged.seconds.sum())),
        steps.ramp_m_s2,
        len(steps.surely_s),
        len(braked.values),
        len(sped.values),
        len(dragged.values),
        len(kept),
        float(sum(motion.t_s[-1] - motion.t_s[0] for motion in kept)),
        tuple(left_out),
    )


def _together(parts: Iterable[Stretches]) -> Stretches:
    return Stretches(*(np.concatenate(each) for each in zip(NO_STRETCHES, *parts, strict=True)))


def _unusable(motion: RailMotion, ramp_m_s2: float) -> str | None:
    """Return why a recording cannot be used, or None."""
    if len(motion.t_s) < 2 or len(motion.sent_s) < 2:
        return "has no set-points or no axis readings"
    ramp = ramp_m_s2 if motion.config is None else motion.config.drivers.rail.acceleration_m_s2
    if ramp != ramp_m_s2:
        return f"was recorded with drivers.rail.acceleration_m_s2 {ramp:g}, not {ramp_m_s2:g}"
    steps_s = np.diff(motion.t_s)
    way = 0.5 * (motion.velocity_m_s[1:] + motion.velocity_m_s[:-1]) * steps_s
    moving = np.abs(way) > MOVING_M_S * steps_s
    if not moving.any():
        return "the cart did not move"
    scale = float((np.diff(motion.position_m)[moving] @ way[moving]) / (way[moving] @ way[moving]))
    if abs(scale - 1.0) > SCALE_MAX:
        return f"the axis's velocity is {1 / scale:.2g} times the slope of its position: check drivers.rail first"
    if len(_thinned(motion).t_s) < 2:
        farthest_m = RAIL_TRAVEL_M - STOP_ROOM_M
        return f"the cart was never within {farthest_m:g} m of the centre: home the axis, check centre_m"
    return None


def _thinned(motion: RailMotion) -> RailMotion:
    """Return the readings away from the mechanical stops, about SPACING_S apart."""
    free = np.flatnonzero(np.abs(motion.position_m) <= RAIL_TRAVEL_M - STOP_ROOM_M)
    every = max(1, round(SPACING_S / float(np.median(np.diff(motion.t_s)))))
    rows = free[free % every == 0]
    return replace(
        motion, t_s=motion.t_s[rows], position_m=motion.position_m[rows], velocity_m_s=motion.velocity_m_s[rows]
    )
