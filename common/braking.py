"""The one law of braking before the rail's end: for one cart (floats) and for a batch of them (arrays) alike.

A velocity command passes when the cart can still stop after it, whatever of this is true: a set-point acts at once or
as late as `latency_s`; the reading is as old as it says; the next set-point comes in time or never, and then the
rail's link brakes by itself once this one is `hold_s` old. So for the upper end the cart is taken to follow, at every
moment, the highest of the set-points that may act then, to speed up by `surge_m_s2` and to slow down by no more than
`braking_m_s2`: the drive's ramp, helped or hindered by the swinging arm. A set-point counts with what the arm drags
the cart beyond it: what is seen of that, and `drag_m_s` at least. No cart that does better gets farther, for of two
carts at one place the faster stays ahead. Where less is known, less speed passes.

Pure arithmetic on plain numbers, +y towards the rail's upper end. A number is a float or an array [R]; the same lines
serve both, so what a policy trains with is what it will fly with.
"""

import math
from collections.abc import Iterable, Sequence
from functools import reduce
from itertools import pairwise
from typing import Any, Generic, NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

Number = TypeVar("Number", float, NDArray[np.float32])

RETURN_SPEED_M_S = 0.1  # at most, when the cart has to come back by itself
CREEP_MAX_M_S = 0.1  # a larger lead is a ramp under way
BISECTIONS = 12  # of a 2 m/s range: 0.5 mm/s, always on the safe side
INSTANT_S = 1e-6  # what lies closer together is one moment


class Bounded(NamedTuple, Generic[Number]):
    """A command that lets the cart stop in time, and which end of the rail changed it (bool, or bool [R])."""

    velocity_m_s: Number
    at_max: Any
    at_min: Any


class Stretch(NamedTuple, Generic[Number]):
    """A while in which the same set-points may act: the highest and the lowest of them, m/s."""

    time_s: float
    highest: Number
    lowest: Number


class _Course(NamedTuple, Generic[Number]):
    """A cart on its way towards +y, whatever it is told now."""

    position: Number  # as far and as fast as it may be
    velocity: Number
    ahead: list[tuple[float, Number]]  # targets (time in s, m/s) that may act beside a command, each with its creep
    creep: Number
    aim_m: float  # before which it has to stop


class BrakingLaw(NamedTuple):
    """What the law counts on."""

    position_min_m: float  # where the cart must be able to stop: the rail's limits less their margin
    position_max_m: float
    surge_m_s2: float
    braking_m_s2: float
    latency_s: float  # from a command to its effect on the cart, at most
    hold_s: float  # a set-point that is not renewed for so long is followed by the link's own brake
    drag_m_s: float  # by which the arm may come to drag the cart beyond its set-point, unseen as yet

    def in_float32(self) -> Self:
        """For float32 batches: a 64-bit constant among them would widen what it is chosen beside."""
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
        """The command nearest to the wanted one after which the cart can stop before either end.

        wanted, in m/s, would be sent now; position in m and velocity in m/s as they were `age_s` ago; sent: every
        set-point that may have acted since then, oldest first, each with its age in s. Before them the cart was told
        to stand. Where the ends ask for what rules each other out, the cart is told to stand still.
        """
        stand: Any = np.zeros_like(wanted) if isinstance(wanted, np.ndarray) else 0.0
        spans = [span for span in _spans(self, sent, stand) if span[1] + INSTANT_S > -age_s]
        acting = [each for begin, end, each in spans if begin + INSTANT_S < -age_s < end + INSTANT_S]
        since, ahead = _cut(spans, -age_s, 0.0), _cut(spans, 0.0, self.latency_s)
        unseen_m = CREEP_MAX_M_S * age_s  # of a cart that the arm has begun to drag since
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
    """What may act between two moments, in s from now (the past is negative); sent: as in `BrakingLaw.bound`."""
    return _cut(_spans(law, sent, 0.0), begin_s, end_s)


def fastest(law: BrakingLaw, velocity: float, targets: Iterable[tuple[float, float]]) -> float:
    """The highest velocity in m/s that a cart may have come to after targets, each of them for a while in s."""
    _, highest = _follow(law, 0.0, velocity, targets)
    return highest


def _spans(law: BrakingLaw, sent: Sequence[tuple[float, Number]], stand: Number) -> list[tuple[float, float, Number]]:
    """From when to when, in s from now, each set-point may act; `stand`, a zero, where there was none or it was old."""
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
    """How fast the arm drags a cart that holds its velocity: a small lead over what may have acted until then."""
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
    """From where and how fast the cart was when it was read, and what may have acted then, since and from now on."""
    creep = _higher(_creep(velocity, acting), law.drag_m_s)
    followed = _follow(law, position, velocity, [(time_s, target + creep) for time_s, target in since])
    return _Course(*followed, [(time_s, target + creep) for time_s, target in ahead], creep, aim_m)


def _of(course: _Course[Any], rows: Any) -> _Course[Any]:
    """The same of some robots of a batch."""
    ahead = [(time_s, target[rows]) for time_s, target in course.ahead]
    return _Course(course.position[rows], course.velocity[rows], ahead, course.creep[rows], course.aim_m)


def _fits(law: BrakingLaw, command: Number, course: _Course[Number]) -> Any:
    """Whether a cart can still stop before its aim after a command: a bool, or bool [R]."""
    return farthest(law, course.position, course.velocity, course.ahead, command + course.creep) <= course.aim_m


def _highest(law: BrakingLaw, wanted: Number, course: _Course[Number]) -> Number:
    """The highest command, up to the wanted one, that fits."""
    fits = _fits(law, wanted, course)
    if not isinstance(wanted, np.ndarray):
        return wanted if fits else _search(law, wanted, course)
    highest = wanted.copy()
    if (tight := np.flatnonzero(~fits)).size:  # most carts of a batch are far from the ends
        highest[tight] = _search(law, wanted[tight], _of(course, tight))
    return highest


def _too_high(law: BrakingLaw, command: Any, asked: Any, course: _Course[Any]) -> Any:
    """Where it is asked for: whether the command does not fit."""
    if not isinstance(asked, np.ndarray):
        return asked and not _fits(law, command, course)
    if (rows := np.flatnonzero(asked)).size:
        asked[rows] = ~_fits(law, command[rows], _of(course, rows))
    return asked


def _search(law: BrakingLaw, wanted: Number, course: _Course[Number]) -> Number:
    """Bisect between coming back and what is wanted, which is too much."""
    low: Number = _choose(wanted < -RETURN_SPEED_M_S, wanted, -RETURN_SPEED_M_S)
    # Where even coming back passes the end there is nothing to search: it is all that can be done.
    high = _choose(_fits(law, low, course), wanted, low)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        fits = _fits(law, middle, course)
        low, high = _choose(fits, middle, low), _choose(fits, high, middle)
    return low


def farthest(
    law: BrakingLaw, position: Number, velocity: Number, ahead: Iterable[tuple[float, Number]], candidate: Number
) -> Number:
    """Farthest point towards +y still ahead: the candidate may act from now on beside what is ahead, then acts alone
    as long as it is held, and then the brake.

    It is where the cart would stop from the end of one of these stretches: within them that place only moves on, or
    the cart is on its way back.
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
    """Position and velocity after the velocity has ramped towards the target for a while."""
    slope = _choose(target > velocity, law.surge_m_s2, -law.braking_m_s2)
    whole_s = (target - velocity) / slope
    ramping_s = _choose(whole_s < time_s, whole_s, time_s)
    position = position + (velocity * ramping_s + 0.5 * slope * ramping_s * ramping_s)
    velocity = velocity + slope * ramping_s
    return position + velocity * (time_s - ramping_s), velocity


def _higher(one: Any, other: Any) -> Any:
    """The higher of two numbers."""
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        return np.maximum(one, other)
    return max(one, other)


def _choose(condition: Any, one: Any, other: Any) -> Any:
    """`one` where the condition holds, else the other."""
    if isinstance(condition, bool):
        return one if condition else other
    return np.where(condition, one, other)[()]  # [()]: of a number of numpy's own, a number again
