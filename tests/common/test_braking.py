"""The law of braking: what it lets pass leaves room to stop, from either end, for one cart and for many alike."""

from collections import deque
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from softarm.common.braking import BISECTIONS, CREEP_MAX_M_S, RETURN_SPEED_M_S, BrakingLaw

PERIOD_S = 1 / 30
FAR_M = 100.0  # an end that never matters
ROUNDING_M = 1e-5  # of the cart below, which moves in steps


def law(braking_m_s2: float = 3.0, surge_m_s2: float = 9.0, under_way: int = 1, ends=(-0.24, 0.24)) -> BrakingLaw:
    return BrakingLaw(*ends, surge_m_s2, braking_m_s2, latency_s=under_way * PERIOD_S, period_s=PERIOD_S)


speeds = st.floats(-1.2, 1.2)
positions = st.floats(-0.27, 0.27)


@dataclass
class LawfulCart:
    """Does what the law counts on: speeds up by the surge, slows down by the brake, each command in its turn."""

    law: BrakingLaw
    position: float
    velocity: float
    under_way: deque[float]
    creep: float = 0.0
    one_end: bool = False  # worst for the upper end alone: even away from it as slowly as it would brake
    STEPS = 50

    def follow(self, command: float) -> float:
        """A command joins those under way and a tick passes; the farthest point of it, on the way back its last."""
        self.under_way.append(command)
        target, farthest = self.under_way.popleft() + self.creep, -FAR_M
        for _ in range(self.STEPS):
            if self.velocity > 0:
                farthest = max(farthest, self.position)
            self.advance(target)
        return max(farthest, self.position)

    def advance(self, target: float) -> None:
        """A step of a tick towards a velocity."""
        dt_s, gap = PERIOD_S / self.STEPS, target - self.velocity
        braked = gap < 0 if self.one_end or self.velocity > 0 else gap > 0
        rate = self.law.braking_m_s2 if braked else self.law.surge_m_s2
        change = max(-rate * dt_s, min(gap, rate * dt_s))
        self.position += (self.velocity + change / 2) * dt_s
        self.velocity += change


def farthest_after(rule: BrakingLaw, position: float, velocity: float, sent: float, command: float) -> float:
    """How far a cart gets from when the command begins to act, when it is braked a tick after that."""
    lead = velocity - sent
    cart = LawfulCart(rule, position, velocity, deque([sent]), lead if 0 < lead < CREEP_MAX_M_S else 0.0, True)
    cart.follow(command)  # the one before it acts
    assume(abs(cart.velocity) > 1e-6)  # whether a cart at rest still moves on is a matter of rounding
    farthest = cart.follow(0.0)
    cart.creep, cart.under_way = 0.0, deque()
    while cart.velocity > 0:
        farthest = max(farthest, cart.follow(0.0))
    return farthest


@settings(deadline=None)
@given(
    st.builds(law, st.floats(0.5, 12.0), st.floats(1.0, 20.0), ends=st.tuples(st.just(-FAR_M), st.floats(0.05, 0.29))),
    positions,
    speeds,
    speeds,
    speeds,
)
def test_a_cart_stops_in_time_after_what_passes_and_would_not_after_much_more(rule, position, velocity, sent, wanted):
    passed, at_max, at_min = rule.bound(wanted, position, velocity, [sent])
    aim, back = rule.position_max_m, min(wanted, -RETURN_SPEED_M_S)
    assert not at_min
    assert at_max is (passed < wanted)
    if passed != back:  # to come back is allowed where nothing is in time any more
        assert farthest_after(rule, position, velocity, sent, passed) <= aim + ROUNDING_M
    if passed < wanted:
        more = passed + 1.001 * (wanted - back) / 2**BISECTIONS
        assert farthest_after(rule, position, velocity, sent, more) >= aim - ROUNDING_M


@settings(deadline=None)
@given(
    st.builds(law, st.floats(1.5, 6.0), st.floats(6.0, 20.0), st.integers(0, 4)),
    st.floats(-0.2, 0.2),
    st.lists(st.floats(-1.0, 1.0) | st.sampled_from([-1.0, 1.0]), min_size=1, max_size=40),
)
def test_a_cart_that_was_at_rest_never_passes_an_end_whatever_is_wanted(rule, start, wanted):
    cart = LawfulCart(rule, start, 0.0, deque([0.0] * rule.under_way))
    for velocity in [*wanted, *[wanted[-1]] * 10]:
        cart.follow(rule.bound(velocity, cart.position, cart.velocity, cart.under_way).velocity_m_s)
        assert rule.position_min_m - ROUNDING_M <= cart.position <= rule.position_max_m + ROUNDING_M


@settings(deadline=None)
@given(
    st.builds(law, st.floats(1.5, 6.0), st.floats(6.0, 20.0)),
    st.integers(1, 4 * LawfulCart.STEPS),
    st.floats(-0.2, 0.2),
    st.lists(st.floats(-1.0, 1.0) | st.sampled_from([-1.0, 1.0]), min_size=1, max_size=40),
)
def test_nor_does_one_whose_commands_act_between_two_ticks(rule, late, start, wanted):
    rule = rule._replace(latency_s=late * PERIOD_S / LawfulCart.STEPS)
    cart = LawfulCart(rule, start, 0.0, deque())
    sent = [0.0] * (rule.under_way + 1)  # the newest last; the first of them acts already
    for velocity in [*wanted, *[wanted[-1]] * 10]:
        under_way = sent[len(sent) - rule.under_way :]
        sent.append(rule.bound(velocity, cart.position, cart.velocity, under_way).velocity_m_s)
        for step in range(LawfulCart.STEPS):
            begun = (step - late) // LawfulCart.STEPS  # ticks from the newest command to the one that acts now
            cart.advance(sent[begun - 1] if begun < 0 else sent[-1])
            assert rule.position_min_m - ROUNDING_M <= cart.position <= rule.position_max_m + ROUNDING_M


@given(speeds, st.tuples(speeds, speeds), st.tuples(positions, positions), speeds)
def test_more_is_let_pass_when_more_is_wanted_and_less_nearer_to_the_end(sent, wanted, position, velocity):
    rule, step = law(ends=(-FAR_M, 0.24)), 1.3 / 2**BISECTIONS
    less, more = sorted(wanted)
    near, far = sorted(position, reverse=True)

    def passed(wish: float, where: float) -> float:
        return rule.bound(wish, where, velocity, [sent]).velocity_m_s

    assert passed(less, near) <= passed(more, near) + step
    assert passed(more, near) <= passed(more, far) + step


@given(speeds, speeds, positions, speeds)
def test_a_mirrored_cart_gets_the_mirrored_command(sent, wanted, position, velocity):
    here, at_max, at_min = law().bound(wanted, position, velocity, [sent])
    there, mirrored_max, mirrored_min = law().bound(-wanted, -position, -velocity, [-sent])
    assert here == -there
    assert (at_max, at_min) == (mirrored_min, mirrored_max)


batches = st.integers(1, 8).flatmap(
    lambda carts: st.tuples(*(st.lists(each, min_size=carts, max_size=carts) for each in (speeds, positions, speeds)))
)


@given(batches, st.lists(speeds, max_size=3))
def test_every_cart_of_a_batch_gets_what_it_would_get_alone(batch, sent):
    rule = law(under_way=len(sent))
    wanted, position, velocity = map(np.array, batch)
    together = rule.bound(wanted, position, velocity, [np.full(len(wanted), each) for each in sent])
    alone = [rule.bound(*cart, sent) for cart in zip(*batch, strict=True)]
    assert [tuple(cart) for cart in zip(*together, strict=True)] == [tuple(cart) for cart in alone]


@given(speeds, positions, speeds, speeds)
def test_numbers_of_numpys_own_are_numbers(wanted, position, velocity, sent):
    own = law().bound(*map(np.float64, (wanted, position, velocity)), [np.float64(sent)])
    assert own == law().bound(wanted, position, velocity, [sent])
    assert isinstance(own.velocity_m_s, float)


@given(batches, speeds)
def test_a_batch_in_float32_differs_by_its_rounding(batch, sent):
    rule, step = law(), 2.5 / 2**BISECTIONS
    wanted, position, velocity = (np.array(each, dtype=np.float32) for each in batch)
    together = rule.in_float32().bound(wanted, position, velocity, [np.full_like(wanted, sent)]).velocity_m_s
    assert together.dtype == np.float32
    for cart, got in enumerate(together):
        # The nearer to the upper end, the less; where the answer jumps, a rounded position falls on either side.
        nearer, farther = (
            rule.bound(float(wanted[cart]), float(position[cart]) + off, float(velocity[cart]), [sent]).velocity_m_s
            for off in (1e-6, -1e-6)
        )
        assert nearer - step <= got <= farther + step


def test_a_cart_outside_is_brought_back_gently():
    assert law().bound(0.0, 0.28, 0.0, [0.0]) == (-RETURN_SPEED_M_S, True, False)
    assert law().bound(0.0, -0.28, 0.0, [0.0]) == (RETURN_SPEED_M_S, False, True)


@pytest.mark.parametrize("lead", [0.01, 0.05, 0.09])
def test_a_cart_that_is_dragged_along_is_braked_earlier(lead):
    """A small lead over the set-point is the arm pulling: it will last."""
    held, dragged = (law().bound(0.1, 0.2345, velocity, [0.05]).velocity_m_s for velocity in (0.05, 0.05 + lead))
    assert dragged < held - 0.9 * lead


@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_a_cart_of_a_batch_whose_numbers_are_none_stands_still(number):
    wanted, velocity = np.ones(2, dtype=np.float32), np.zeros(2, dtype=np.float32)
    with np.errstate(invalid="ignore"):
        passed = law().in_float32().bound(wanted, np.array([number, 0.0], dtype=np.float32), velocity, [velocity])
    assert abs(passed.velocity_m_s[0]) <= RETURN_SPEED_M_S + 1e-6
    assert passed.velocity_m_s[1] == 1.0


@pytest.mark.parametrize("number", [1e300, -1e300])
def test_no_number_is_too_large(number):
    assert abs(law().bound(1.0, 0.0, number, [number]).velocity_m_s) <= 1.0


@pytest.mark.parametrize(("latency_s", "count"), [(0.0, 0), (0.01, 1), (1 / 30, 1), (0.05, 2), (0.1, 3)])
def test_the_commands_under_way_cover_the_latency(latency_s, count):
    assert law()._replace(latency_s=latency_s).under_way == count
