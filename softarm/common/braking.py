"""Braking law before the end of the rail, for one cart (floats) and for a batch of carts (arrays).

A velocity command passes if the cart can still stop after it under every combination of these assumptions: a set-point
acts at once or after up to `latency_s`; the reading is as old as its stamp says; the next set-point arrives in time or
never, and then the rail's process brakes once this one is `hold_s` old. For the upper end the cart is therefore assumed
to follow, at every moment, the highest set-point that may act then, to accelerate with `surge_m_s2` and to decelerate
with no more than `braking_m_s2`: the drive's ramp, helped or hindered by the swinging arm. A set-point counts together
with the speed by which the arm drags the cart beyond it: the observed one, and at least `drag_m_s`. No cart that
behaves better gets farther, since of two carts at one position the faster one stays ahead. Less information means less
speed.

Only arithmetic on numbers, +y towards the upper end of the rail. A number is a float, an array [R], or the symbol of a
traced computation (training/task/tensor_guard.py); the same code serves all, so policies train with the law of their
flights.
"""

import math
from collections.abc import Iterable, Sequence
from functools import reduce
from itertools import pairwise
from typing import Any, Generic, NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

Number = TypeVar("Number", float, NDArray[np.float32])

RETURN_SPEED_M_S = 0.1  # maximum speed of a required return
CREEP_MAX_M_S = 0.1  # a larger lead is a ramp in progress
BISECTIONS = 12  # of a 2 m/s range: 0.5 mm/s, always on the safe side
INSTANT_S = 1e-6  # closer times count as one moment
# A tuple: a union would be built at each of a tick's hundreds of checks.
_NUMBERS = (float, int, np.generic)


class Bounded(NamedTuple, Generic[Number]):
    """Command after which the cart can stop in time, and the end that changed it (bool, or bool [R])."""

    velocity_m_s: Number
    at_max: Any
    at_min: Any


class Stretch(NamedTuple, Generic[Number]):
    """Period in which the same set-points may act, with the highest and the lowest of them, m/s."""

    time_s: float
    highest: Number
    lowest: Number


class _Course(NamedTuple, Generic[Number]):
    """Motion of a cart towards +y under any command from now on."""

    position: Number  # the farthest possible, and the highest possible velocity
    velocity: Number
    ahead: list[tuple[float, Number]]  # targets (time in s, m/s) that may act besides a command, each with its creep
    creep: Number
    aim_m: float  # the cart must stop before this position


class BrakingLaw(NamedTuple):
    """Braking law of the cart, with its assumptions."""

    position_min_m: float  # the cart must be able to stop here: the rail's limits less their margin
    position_max_m: float
    surge_m_s2: float
    braking_m_s2: float
    latency_s: float  # maximum time from a command to its effect on the cart
    hold_s: float  # the rail's process brakes when a set-point is not renewed for this time
    drag_m_s: float  # speed by which the arm may drag the cart beyond its set-point unobserved

    def in_float32(self) -> Self:
        """Return the law for float32 batches, since a float64 constant would widen the results."""
        numbers: Any = (*map(np.float32, self[:4]), *self[4:-1], np.float32(self.drag_m_s))
        return type(self)(*numbers)

    def bound(
        self,
        wanted: Number,
        position: Number,
        velocity: Number,
        age_s: float = 0.0,
        sent: Sequence[tuple[float, Number]] = (),
    ) -> Bounded[Number]:
        """Return the command nearest to the requested one after which the cart can stop before either end.

        If the two ends require contradicting commands, the result is zero.

        Args:
            wanted: Requested velocity, sent now, m/s.
            position: Position `age_s` ago, m.
            velocity: Velocity `age_s` ago, m/s.
            age_s: Age of the reading, s.
            sent: Every set-point that may have acted since the reading, oldest first, with its age in s; before them
                the command was zero.
        """
        stand: Any = np.zeros_like(wanted) if isinstance(wanted, np.ndarray) else 0.0
        spans = [span for span in _spans(self, sent, stand) if span[1] + INSTANT_S > -age_s]
        acting = [each for begin, end, each in spans if begin + INSTANT_S < -age_s < end + INSTANT_S]
        since, ahead = _cut(spans, -age_s, 0.0), _cut(spans, 0.0, self.latency_s)
        unseen_m = CREEP_MAX_M_S * age_s  # of a cart that the arm has started to drag since the reading
        targets = (
            [(time_s, highest) for time_s, highest, _ in since],
            [(time_s, highest) for time_s, highest, _ in ahead],
        )
        up = _course(self, position, velocity, acting, *targets, self.position_max_m - unseen_m)
        highest = _highest(self, wanted, up)
        acting = [-each for each in acting]
        targets = [(time_s, -lowest) for time_s, _, lowest in since], [(time_s, -lowest) for time_s, _, lowest in ahead]
        down = _course(self, -position, -velocity, acting, *targets, -self.position_min_m - unseen_m)
        lowest = -_highest(self, -highest, down)
        at_max, at_min = highest < wanted, lowest > highest
        torn = _too_high(self, lowest, at_min & (lowest > -RETURN_SPEED_M_S), up)
        return Bounded(_choose(torn, 0.0, lowest), at_max | torn, at_min)


def stretches(
    law: BrakingLaw, sent: Sequence[tuple[float, float]], begin_s: float, end_s: float
) -> list[Stretch[float]]:
    """Return the commands that may act between two moments, in s from now; `sent` as in `BrakingLaw.bound`."""
    return _cut(_spans(law, sent, 0.0), begin_s, end_s)


def fastest(law: BrakingLaw, velocity: float, targets: Iterable[tuple[float, float]]) -> float:
    """Return the highest velocity in m/s that a cart may have reached after targets of given durations in s."""
    _, highest = _follow(law, 0.0, velocity, targets)
    return highest


def _spans(law: BrakingLaw, sent: Sequence[tuple[float, Number]], stand: Number) -> list[tuple[float, float, Number]]:
    """Yield from when to when, in s from now, each set-point may act; `stand` is zero for missing or old ones."""
    moments: list[float] = [*(-age_s for age_s, _ in sent), 0.0]
    spans = [(-math.inf, moments[0] + law.latency_s, stand)]
    for (_, velocity), (begin_s, next_s) in zip(sent, pairwise(moments), strict=True):
        end_s = begin_s + law.hold_s
        if end_s < next_s:
            spans.append((end_s, next_s + law.latency_s, stand))
        spans.append((begin_s, min(end_s, next_s) + law.latency_s, velocity))
    return spans


def _cut(spans: list[tuple[float, float, Number]], begin_s: float, end_s: float) -> list[Stretch[Number]]:
    ends = (moment for first, last, _ in spans for moment in (first, last))
    moments: set[float] = {moment for moment in ends if begin_s + INSTANT_S < moment < end_s - INSTANT_S}
    pieces = []
    for begin, end in pairwise((begin_s, *sorted(moments), end_s)):
        acting = [each for first, last, each in spans if first <= begin + INSTANT_S and last >= end - INSTANT_S]
        highest, lowest = reduce(_higher, acting), -reduce(_higher, [-each for each in acting])
        pieces.append(Stretch(end - begin, highest, lowest))
    return pieces


def _creep(velocity: Number, acting: Sequence[Number]) -> Number:
    """Return the speed by which the arm drags a cart beyond its set-point: a small lead over the acting commands."""
    creep: Number = 0.0 * velocity
    for each in acting:
        lead = velocity - each
        creep = _higher(creep, _choose((lead > 0.0) & (lead < CREEP_MAX_M_S), lead, 0.0))
    return creep


def _course(
    law: BrakingLaw,
    position: Number,
    velocity: Number,
    acting: Sequence[Number],
    since: Sequence[tuple[float, Number]],
    ahead: Sequence[tuple[float, Number]],
    aim_m: float,
) -> _Course[Number]:
    """Return the motion from the reading on, with the commands that may have acted then, since, and from now on."""
    creep = _higher(_creep(velocity, acting), law.drag_m_s)
    followed = _follow(law, position, velocity, [(time_s, target + creep) for time_s, target in since])
    return _Course(*followed, [(time_s, target + creep) for time_s, target in ahead], creep, aim_m)


def _of(course: _Course[Any], rows: Any) -> _Course[Any]:
    """Return the courses of some robots of a batch."""
    ahead = [(time_s, target[rows]) for time_s, target in course.ahead]
    return _Course(course.position[rows], course.velocity[rows], ahead, course.creep[rows], course.aim_m)


def _fits(law: BrakingLaw, command: Number, course: _Course[Number]) -> Any:
    """Return whether a cart can still stop before its aim after a command (bool, or bool [R])."""
    return farthest(law, course.position, course.velocity, course.ahead, command + course.creep) <= course.aim_m


def _highest(law: BrakingLaw, wanted: Number, course: _Course[Number]) -> Number:
    """Return the highest command, up to the requested one, that fits."""
    fits = _fits(law, wanted, course)
    if _is_number(wanted):
        return wanted if fits else _search(law, wanted, course)
    if not isinstance(wanted, np.ndarray):
        traced: Number = _choose(fits, wanted, _search(law, wanted, course))
        return traced
    highest = wanted.copy()
    if (tight := np.flatnonzero(~fits)).size:  # most carts of a batch are far from the ends
        highest[tight] = _search(law, wanted[tight], _of(course, tight))
    return highest


def _too_high(law: BrakingLaw, command: Any, asked: Any, course: _Course[Any]) -> Any:
    """Return where a check is requested and the command does not fit."""
    if _is_number(command):
        return asked and not _fits(law, command, course)
    if not isinstance(asked, np.ndarray):
        return asked & ~_fits(law, command, course)
    if (rows := np.flatnonzero(asked)).size:
        asked[rows] = ~_fits(law, command[rows], _of(course, rows))
    return asked


def _search(law: BrakingLaw, wanted: Number, course: _Course[Number]) -> Number:
    """Bisect between returning and the requested command, which is too high."""
    low: Number = _choose(wanted < -RETURN_SPEED_M_S, wanted, -RETURN_SPEED_M_S)
    # If even returning passes the end, it is the best command and there is nothing to search.
    high = _choose(_fits(law, low, course), wanted, low)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        fits = _fits(law, middle, course)
        low, high = _choose(fits, middle, low), _choose(fits, high, middle)
    return low


def farthest(
    law: BrakingLaw, position: Number, velocity: Number, ahead: Iterable[tuple[float, Number]], candidate: Number
) -> Number:
    """Return the farthest point towards +y that the cart can reach with a candidate command.

    The candidate may act from now on together with the commands ahead, then alone while it is held, and then the brake
    acts. The farthest point is the stopping point at the end of one of these periods: within a period that point only
    moves on, or the cart returns.
    """
    reach = _stops_at(law, position, velocity)
    for time_s, target in (
        *((time_s, _higher(target, candidate)) for time_s, target in ahead),
        (law.hold_s, candidate),
    ):
        position, velocity = _ramp(law, position, velocity, target, time_s)
        reach = _higher(reach, _stops_at(law, position, velocity))
    return reach


def _stops_at(law: BrakingLaw, position: Number, velocity: Number) -> Number:
    onward = _higher(velocity, 0.0)
    place: Number = position + onward * onward / (2.0 * law.braking_m_s2)
    return place


def _follow(
    law: BrakingLaw, position: Number, velocity: Number, targets: Iterable[tuple[float, Number]]
) -> tuple[Number, Number]:
    for time_s, target in targets:
        position, velocity = _ramp(law, position, velocity, target, time_s)
    return position, velocity


def _ramp(law: BrakingLaw, position: Number, velocity: Number, target: Number, time_s: float) -> tuple[Number, Number]:
    """Return position and velocity after the velocity has ramped towards the target for a time."""
    slope = _choose(target > velocity, law.surge_m_s2, -law.braking_m_s2)
    whole_s = (target - velocity) / slope
    ramping_s = _choose(whole_s < time_s, whole_s, time_s)
    position = position + (velocity * ramping_s + 0.5 * slope * ramping_s * ramping_s)
    velocity = velocity + slope * ramping_s
    return position + velocity * (time_s - ramping_s), velocity


def _higher(one: Any, other: Any) -> Any:
    """Return the higher of two numbers."""
    return max(one, other) if _is_number(one) and _is_number(other) else np.maximum(one, other)


def _is_number(value: Any) -> bool:
    return isinstance(value, _NUMBERS)


def _choose(condition: Any, one: Any, other: Any) -> Any:
    """Return `one` where the condition holds, else the other."""
    if isinstance(condition, bool):
        return one if condition else other
    return np.where(condition, one, other)[()]  # [()] turns a zero-dimensional array into a number
