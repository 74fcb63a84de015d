"""The one law of braking before the rail's end: for one cart (floats) and for a batch of them (arrays) alike.

A velocity command passes when the cart can still stop after it: commands already under way act for the latency,
the new one for a tick, and only then can a brake begin to act. The cart is taken to speed up by `surge_m_s2` and to
brake by `braking_m_s2`: the drive's ramp, helped or hindered by the swinging arm.

Pure arithmetic on plain numbers, +y towards the rail's upper end. A number is a float or an array [R]; the same lines
serve both, so what a policy trains with is what it will fly with.
"""

import math
from collections.abc import Sequence
from typing import Any, Generic, NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

Number = TypeVar("Number", float, NDArray[np.float32])

RETURN_SPEED_M_S = 0.1  # at most, when the cart has to come back by itself
CREEP_MAX_M_S = 0.1  # a larger lead is a ramp under way
BISECTIONS = 12  # of a 2 m/s range: 0.5 mm/s, always on the safe side


class Bounded(NamedTuple, Generic[Number]):
    """A command that lets the cart stop in time, and which end of the rail changed it (bool, or bool [R])."""

    velocity_m_s: Number
    at_max: Any
    at_min: Any


class BrakingLaw(NamedTuple):
    """What the law counts on."""

    position_min_m: float  # where the cart must be able to stop: the rail's limits less their margin
    position_max_m: float
    surge_m_s2: float
    braking_m_s2: float
    latency_s: float  # from a command to its effect on the cart
    period_s: float  # of the commands

    @property
    def under_way(self) -> int:
        """How many commands have been sent and do not act yet."""
        return math.ceil(self.latency_s / self.period_s - 1e-9)

    def in_float32(self) -> Self:
        """For float32 batches: a 64-bit constant among them would widen what it is chosen beside."""
        numbers: Any = map(np.float32, self)
        return type(self)(*numbers)

    def bound(self, wanted: Number, position: Number, velocity: Number, sent: Sequence[Number]) -> Bounded[Number]:
        """The command nearest to the wanted one after which the cart can stop before either end.

        wanted and velocity in m/s, position in m, as of now; sent: the commands under way, oldest first, `under_way`
        of them. A cart for which both ends are too near (the numbers are wrong) is told to stand still.
        """
        highest = _highest(self, wanted, position, velocity, sent, self.position_max_m)
        mirrored = _highest(self, -highest, -position, -velocity, [-each for each in sent], -self.position_min_m)
        at_max, at_min = highest < wanted, -mirrored > highest
        return Bounded(_choose(at_max & at_min, 0.0, -mirrored), at_max, at_min)


def stops_at(law: BrakingLaw, position: Number, velocity: Number, candidate: Number) -> Number:
    """Farthest point towards +y still ahead when the candidate acts for a tick and the brake after it."""
    brake = 2.0 * law.braking_m_s2
    later, speed = _ramp(law, position, velocity, candidate, law.period_s)
    turned = _choose(velocity > 0.0, position + velocity * velocity / brake, later)  # it turned round on the way
    farthest: Number = _choose(speed > 0.0, later + speed * speed / brake, turned)
    return farthest


def _highest(
    law: BrakingLaw, wanted: Number, position: Number, velocity: Number, sent: Sequence[Number], aim_m: float
) -> Number:
    """The highest command, up to the wanted one, after which the cart can still stop before `aim_m`."""
    # How fast the arm drags a cart that holds its velocity: a small, steady lead over its set-point.
    lead = velocity - sent[0] if sent else velocity
    creep = _choose((lead > 0.0) & (lead < CREEP_MAX_M_S), lead, 0.0)
    time_s = law.latency_s - law.period_s * (len(sent) - 1)  # the oldest acts already: until the next one does
    for command in sent:
        position, velocity = _ramp(law, position, velocity, command + creep, time_s)
        time_s = law.period_s
    fits = stops_at(law, position, velocity, wanted + creep) <= aim_m
    if not isinstance(wanted, np.ndarray):
        return wanted if fits else _search(law, wanted, position, velocity, creep, aim_m)
    highest = wanted.copy()
    if (tight := np.flatnonzero(~fits)).size:  # most carts of a batch are far from the ends
        highest[tight] = _search(law, wanted[tight], position[tight], velocity[tight], creep[tight], aim_m)
    return highest


def _search(law: BrakingLaw, wanted: Number, position: Number, velocity: Number, creep: Number, aim_m: float) -> Number:
    """Bisect between coming back and what is wanted, which is too much."""
    low: Number = _choose(wanted < -RETURN_SPEED_M_S, wanted, -RETURN_SPEED_M_S)
    # Where even coming back passes the end there is nothing to search: it is all that can be done.
    high = _choose(stops_at(law, position, velocity, low + creep) <= aim_m, wanted, low)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        fits = stops_at(law, position, velocity, middle + creep) <= aim_m
        low, high = _choose(fits, middle, low), _choose(fits, high, middle)
    return low


def _ramp(law: BrakingLaw, position: Number, velocity: Number, target: Number, time_s: float) -> tuple[Number, Number]:
    """Position and velocity after the velocity has ramped towards the target for a while."""
    slope = _choose(target > velocity, law.surge_m_s2, -law.braking_m_s2)
    whole_s = (target - velocity) / slope
    ramping_s = _choose(whole_s < time_s, whole_s, time_s)
    # The same sum, rounded in another order: as each side has always added, so that the daemon replays old logs and a
    # seeded training repeats to the last bit.
    if isinstance(position, np.ndarray) and position.dtype == np.float32:
        position = position + velocity * ramping_s + 0.5 * slope * (ramping_s * ramping_s)
    else:
        position = position + (velocity * ramping_s + 0.5 * slope * ramping_s * ramping_s)
    velocity = velocity + slope * ramping_s
    return position + velocity * (time_s - ramping_s), velocity


def _choose(condition: Any, one: Any, other: Any) -> Any:
    """`one` where the condition holds, else the other."""
    if isinstance(condition, bool):
        return one if condition else other
    return np.where(condition, one, other)[()]  # [()]: of a number of numpy's own, a number again
