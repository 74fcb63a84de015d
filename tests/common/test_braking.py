"""The braking law: an allowed command leaves room to stop for every cart within the assumptions."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from softarm.common.braking import BISECTIONS, CREEP_MAX_M_S, RETURN_SPEED_M_S, BrakingLaw, fastest, stretches

STEP_S = 1e-3  # everything below happens on these
TICK = 33
FAR_M = 100.0  # an end that never matters
ROUNDING_M = 2e-5  # of the cart below, which moves in steps


def law(braking_m_s2=3.0, surge_m_s2=9.0, latency=TICK, hold=45, ends=(-0.24, 0.24), drag_m_s=0.0) -> BrakingLaw:
    """latency and hold in steps."""
    return BrakingLaw(*ends, surge_m_s2, braking_m_s2, latency * STEP_S, hold * STEP_S, drag_m_s)


laws = st.builds(law, st.floats(0.8, 6.0), st.floats(6.0, 20.0), st.integers(0, 120), st.integers(34, 90))
speeds = st.floats(-1.0, 1.0) | st.sampled_from([-1.0, 1.0])
positions = st.floats(-0.27, 0.27)


@dataclass
class Cart:
    """A rail that does anything which the law allows for. Time in steps.

    Set-points act in the order in which they were sent, each at once or as late as the latency; the link brakes when
    none came for the hold; the speed changes by anything between braking and surge.
    """

    law: BrakingLaw
    position: float
    draw: np.random.Generator
    velocity: float = 0.0
    creep: float = 0.0  # how fast the arm drags a cart that holds its velocity
    now: int = 0
    sent: list[tuple[int, float]] = field(default_factory=list)
    due: list[tuple[int, float]] = field(default_factory=list)  # what the drive will hear and when
    track: list[tuple[float, float]] = field(default_factory=list)  # of every step
    acting: float = 0.0

    @property
    def latency(self) -> int:
        return round(self.law.latency_s / STEP_S)

    def send(self, velocity: float) -> None:
        """A set-point, now."""
        self.sent.append((self.now, velocity))
        self._hear(velocity)

    def _hear(self, velocity: float) -> None:
        last = self.due[-1][0] if self.due else 0
        late = self.draw.choice([0, self.latency, self.draw.integers(self.latency + 1)])
        self.due.append((max(last, self.now + late), velocity))

    def let_pass(self, steps: int) -> None:
        """Move on; nothing is sent."""
        low, high = self.law.braking_m_s2, self.law.surge_m_s2
        # A third each: the lowest rate, the highest, any between.
        rates = self.draw.uniform(2 * low - high, 2 * high - low, steps).clip(low, high)
        for rate in rates.tolist():
            self.track.append((self.position, self.velocity))
            if self.sent and self.now - self.sent[-1][0] == round(self.law.hold_s / STEP_S):
                self._hear(0.0)  # the link brakes
            while self.due and self.due[0][0] <= self.now:
                self.acting = self.due.pop(0)[1]
            self._advance(self.acting + self.creep, rate)
            self.now += 1

    def _advance(self, target: float, rate: float) -> None:
        change = max(-rate * STEP_S, min(target - self.velocity, rate * STEP_S))
        self.position += (self.velocity + change / 2) * STEP_S
        self.velocity += change

    def ask(self, wanted: float, age: int) -> float:
        """Return the allowed command for the reading of `age` steps ago."""
        age = min(age, self.now)
        position, velocity = self.track[self.now - age] if age else (self.position, self.velocity)
        sent = [((self.now - at) * STEP_S, each) for at, each in self.sent]
        return self.law.bound(wanted, position, velocity, age * STEP_S, sent).velocity_m_s


@dataclass(frozen=True)
class Flight:
    """Requested commands, ages of the readings, and steps until the next tick."""

    wanted: list[float]
    ages: list[int]
    pauses: list[int]

    def fly(self, cart: Cart) -> float:
        """Return the largest distance beyond an end, m; negative if the cart never passes one."""
        beyond, read_at = -FAR_M, 0
        for tick in range(len(self.wanted) + 10):
            read_at = max(read_at, cart.now - self.ages[tick % len(self.ages)])
            wanted = self.wanted[min(tick, len(self.wanted) - 1)]
            cart.send(cart.ask(wanted, cart.now - read_at))
            cart.let_pass(self.pauses[tick % len(self.pauses)])
        for position, _ in cart.track:
            beyond = max(beyond, position - cart.law.position_max_m, cart.law.position_min_m - position)
        return beyond


ages = st.lists(st.integers(0, 150), min_size=1, max_size=6) | st.just([0])
pauses = st.lists(st.sampled_from([TICK, TICK, 34, 31, 2 * TICK, 4 * TICK, 250]), min_size=1, max_size=7)
flights = st.builds(Flight, st.lists(speeds, min_size=1, max_size=40), ages, pauses)
seeds = st.integers(0, 2**32)


@settings(deadline=None, max_examples=25)
@given(laws, st.floats(-0.2, 0.2), flights, seeds)
def test_no_cart_within_the_assumptions_ever_passes_an_end(rule, start, flight, seed):
    """Commands, ages of readings, skipped ticks and delays are arbitrary."""
    cart = Cart(rule, start, np.random.default_rng(seed))
    assert flight.fly(cart) <= ROUNDING_M


@pytest.mark.parametrize("seed", range(3))
def test_no_cart_passes_an_end_under_an_adverse_policy(seed):
    """Drive to and fro between the ends with the least information, which random histories rarely do."""
    draw = np.random.default_rng(seed)
    rule = law(latency=int(draw.choice([0, 5, TICK, 90])), braking_m_s2=float(draw.choice([1.5, 3.0])))
    hold = int(draw.integers(2, 20))
    wanted = [float(draw.choice([-1.0, 1.0])) for _ in range(20) for _ in range(hold)]
    flight = Flight(wanted, [int(draw.choice([0, 28, 60, 150]))], [TICK, TICK, TICK, int(draw.choice([TICK, 99, 132]))])
    assert flight.fly(Cart(rule, 0.0, draw)) <= ROUNDING_M


def worst_after(rule: BrakingLaw, position, velocity, age, sent, candidate) -> float:
    """Return the farthest position of the fastest cart within the assumptions, step by step; ages in steps."""
    latency, hold = round(rule.latency_s / STEP_S), round(rule.hold_s / STEP_S)
    acts = [(-1000, (-sent[0][0] if sent else 0) + latency, 0.0)]
    for (before, each), until in zip(sent, [*(-at for at, _ in sent[1:]), 0], strict=False):
        acts.append((-before, min(until, hold - before) + latency, each))
        if hold - before < until:
            acts.append((hold - before, until + latency, 0.0))
    acts += [(0, hold + latency, candidate), (hold + latency, 10_000, 0.0)]
    reached = -FAR_M
    for step in range(-age, 10_000):
        if step >= 0:
            reached = max(reached, position)
            if velocity <= 0 and step > hold + latency:
                break
        target = max(each for begin, end, each in acts if begin <= step < end)
        change = max(-rule.braking_m_s2 * STEP_S, min(target - velocity, rule.surge_m_s2 * STEP_S))
        position, velocity = position + (velocity + change / 2) * STEP_S, velocity + change
    return reached


histories = st.lists(st.tuples(st.sampled_from([31, TICK, TICK, 80]), speeds), max_size=5)


@settings(deadline=None)
@given(laws, positions, speeds, st.integers(0, 150), histories, speeds)
def test_a_cart_stops_in_time_after_an_allowed_command_but_not_after_a_higher_one(
    rule, position, velocity, age, history, wanted
):
    sent, at = [], 0
    for pause, each in history:
        at += pause
        sent.insert(0, (at, each))
    rule = rule._replace(position_min_m=-FAR_M)
    set_points = [(at * STEP_S, each) for at, each in sent]
    assume(not any(0 < velocity - each < CREEP_MAX_M_S for each in (0.0, *(each for _, each in sent))))  # creep: below
    passed, at_max, at_min = rule.bound(wanted, position, velocity, age * STEP_S, set_points)
    aim, back = rule.position_max_m - CREEP_MAX_M_S * age * STEP_S, min(wanted, -RETURN_SPEED_M_S)
    assert not at_min
    assert at_max is (passed < wanted)
    if passed != back:  # to come back is allowed where nothing is in time any more
        assert worst_after(rule, position, velocity, age, sent, passed) <= aim + ROUNDING_M
    if passed < wanted:
        more = passed + 1.001 * (wanted - back) / 2**BISECTIONS
        assert worst_after(rule, position, velocity, age, sent, more) >= aim - ROUNDING_M


@given(st.integers(0, 150), st.integers(0, 120), st.integers(0, 120))
def test_less_information_allows_less_speed(age, latency, more):
    """Compare a cart at rest in the middle and a moving one."""

    def passed(age, latency, velocity):
        set_points = [(k * TICK * STEP_S, velocity) for k in range(16, 0, -1)]
        return law(latency=latency).bound(1.0, 0.0, velocity, age * STEP_S, set_points).velocity_m_s

    step = 1.2 / 2**BISECTIONS
    for velocity in (0.0, 0.3):
        assert passed(age, latency + more, velocity) <= passed(age, latency, velocity) + step
        assert passed(age + more, latency, velocity) <= passed(age, latency, velocity) + step


@given(speeds, speeds, positions, speeds, st.integers(0, 100))
def test_a_mirrored_cart_gets_the_mirrored_command(sent, wanted, position, velocity, age):
    age_s = age * STEP_S
    here, at_max, at_min = law().bound(wanted, position, velocity, age_s, [(0.033, sent)])
    there, mirrored_max, mirrored_min = law().bound(-wanted, -position, -velocity, age_s, [(0.033, -sent)])
    # Where the two ends leave nothing but a gap, the one that is asked first gives way.
    if not (at_max and at_min):
        assert (here, at_max, at_min) == (-there, mirrored_min, mirrored_max)
    else:
        assert here == 0.0


batches = st.integers(1, 8).flatmap(
    lambda carts: st.tuples(*(st.lists(each, min_size=carts, max_size=carts) for each in (speeds, positions, speeds)))
)
few = st.lists(speeds, max_size=4).map(lambda all: [((len(all) - k) / 30, each) for k, each in enumerate(all)])


@settings(max_examples=40)
@given(batches, few, st.integers(0, 100), st.integers(0, 100))
def test_every_cart_of_a_batch_gets_the_same_command_as_alone(batch, sent, age, latency):
    rule, age_s = law(latency=latency), age * STEP_S
    wanted, position, velocity = map(np.array, batch)
    set_points = [(at, np.full(len(wanted), each)) for at, each in sent]
    together = rule.bound(wanted, position, velocity, age_s, set_points)
    alone = [rule.bound(*cart, age_s, sent) for cart in zip(*batch, strict=True)]
    assert [tuple(cart) for cart in zip(*together, strict=True)] == [tuple(cart) for cart in alone]


@settings(max_examples=20)
@given(speeds, positions, speeds, speeds)
def test_numpy_scalars_are_accepted(wanted, position, velocity, sent):
    own = law().bound(*map(np.float64, (wanted, position, velocity)), 0.0, [(0.033, np.float64(sent))])
    assert own == law().bound(wanted, position, velocity, 0.0, [(0.033, sent)])
    assert isinstance(own.velocity_m_s, float)


@settings(max_examples=40)
@given(batches, speeds)
def test_a_batch_in_float32_differs_by_its_rounding(batch, sent):
    rule, step = law(), 2.5 / 2**BISECTIONS
    wanted, position, velocity = (np.array(each, dtype=np.float32) for each in batch)
    together = rule.in_float32().bound(wanted, position, velocity, 0.0, [(0.033, np.full_like(wanted, sent))])
    assert together.velocity_m_s.dtype == np.float32
    for cart, got in enumerate(together.velocity_m_s):
        # The nearer to the upper end, the less; where the answer jumps, a rounded position falls on either side.
        nearer, farther = (
            rule.bound(float(wanted[cart]), float(position[cart]) + off, float(velocity[cart]), 0.0, [(0.033, sent)])
            for off in (1e-6, -1e-6)
        )
        assert nearer.velocity_m_s - step <= got <= farther.velocity_m_s + step


def test_a_cart_outside_returns_slowly():
    assert RETURN_SPEED_M_S == 0.1
    assert law().bound(0.0, 0.28, 0.0) == (-RETURN_SPEED_M_S, True, False)
    assert law().bound(0.0, -0.28, 0.0) == (RETURN_SPEED_M_S, False, True)


def test_contradicting_ends_stop_the_cart():
    to_and_fro = [(k * TICK * STEP_S, (-1.0) ** k) for k in range(16, 0, -1)]
    assert law(latency=100).bound(1.0, 0.0, 0.0, 0.4, to_and_fro) == (0.0, True, True)


def test_the_far_end_never_drives_the_cart_towards_the_near_one():
    # A slow drive returns from 24 mm before its end and may not stop in time before the other end.
    slow = law(0.622, 6.41, latency=62)
    sent = [(0.167, 0.069), (0.133, 0.061), (0.1, 0.056), (0.067, -0.819), (0.033, -0.645)]
    assert slow.bound(-0.819, 0.2158, -0.004, 0.1, sent) == (0.0, True, True)


def test_a_fast_cart_outside_returns_as_fast_as_the_far_end_allows():
    slow = law(0.622, 6.41, latency=62)
    passed, at_max, at_min = slow.bound(-1.0, 0.25, -0.5)
    assert (at_max, at_min) == (False, True)
    assert passed == slow._replace(position_max_m=FAR_M).bound(-1.0, 0.25, -0.5).velocity_m_s
    assert -0.8 < passed < -0.6


slow_laws = st.builds(law, st.floats(0.3, 0.8), st.floats(4.0, 8.0), st.integers(30, 120))


@given(slow_laws, few, speeds, st.floats(-0.26, 0.26), st.floats(-0.1, 0.1), st.integers(50, 150))
def test_a_command_allowed_by_both_ends_is_allowed_by_each(rule, sent, wanted, position, velocity, age):
    passed = rule.bound(wanted, position, velocity, age * STEP_S, sent).velocity_m_s
    upper, lower = rule._replace(position_min_m=-FAR_M), rule._replace(position_max_m=FAR_M)
    for one, back in ((upper, passed <= -RETURN_SPEED_M_S), (lower, passed >= RETURN_SPEED_M_S)):
        assert passed == 0.0 or back or one.bound(passed, position, velocity, age * STEP_S, sent).velocity_m_s == passed


def check_dragged(passed, position, velocity, age, set_points, creep):
    """Check that a dragged cart stops in time after a command, but not after a higher one."""
    assert -RETURN_SPEED_M_S < passed < 1.0
    dragged, up = [(at, each + creep) for at, each in set_points], law(ends=(-FAR_M, 0.24))
    more = passed + 1.001 * 1.1 / 2**BISECTIONS
    aim = 0.24 - CREEP_MAX_M_S * age * STEP_S  # it may have begun to drag since
    assert worst_after(up, position, velocity, age, dragged, passed + creep) <= aim + ROUNDING_M
    assert worst_after(up, position, velocity, age, dragged, more + creep) >= aim - ROUNDING_M


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("age", [0, 20, 100])
@pytest.mark.parametrize("lead", [0.01, 0.09])
def test_a_dragged_cart_stops_in_time_but_not_after_a_higher_command(lead, age, side):
    """Its bound equals that of set-points that are higher by the lead, at both ends."""
    rule = law(ends=(-FAR_M, 0.24) if side > 0 else (-0.24, FAR_M))
    set_points = [(k * TICK, 0.05) for k in range(8, 0, -1)]
    position, velocity = 0.2 - 0.05 * age * STEP_S, 0.05 + lead
    sent = [(at * STEP_S, side * each) for at, each in set_points]
    passed = side * rule.bound(side * 1.0, side * position, side * velocity, age * STEP_S, sent).velocity_m_s
    check_dragged(passed, position, velocity, age, set_points, lead)


@pytest.mark.parametrize("lead", [0.0, 0.05, 0.2])
@pytest.mark.parametrize("drag", [0.05, 0.3])
def test_a_possible_drag_counts_as_an_observed_one(drag, lead):
    """A smaller observed drag changes only the velocity at the reading."""
    set_points = [(k * TICK, 0.05) for k in range(8, 0, -1)]
    sent = [(at * STEP_S, each) for at, each in set_points]
    passed = law(ends=(-FAR_M, 0.24), drag_m_s=drag).bound(1.0, 0.13, 0.05 + lead, 0.02, sent).velocity_m_s
    check_dragged(passed, 0.13, 0.05 + lead, 20, set_points, max(drag, lead if lead < CREEP_MAX_M_S else 0.0))


def test_a_large_lead_counts_as_a_ramp():
    set_points = [(k * TICK * STEP_S, 0.05) for k in range(8, 0, -1)]
    dragged, ramping = (law().bound(1.0, 0.2, 0.05 + lead, 0.0, set_points).velocity_m_s for lead in (0.099, 0.101))
    assert ramping > dragged + 0.05


@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_a_cart_with_nan_or_infinity_in_a_batch_stands_still(number):
    wanted, velocity = np.ones(2, dtype=np.float32), np.zeros(2, dtype=np.float32)
    with np.errstate(invalid="ignore"):
        passed = law().in_float32().bound(wanted, np.array([number, 0.0], dtype=np.float32), velocity)
    assert abs(passed.velocity_m_s[0]) <= RETURN_SPEED_M_S + 1e-6
    assert passed.velocity_m_s[1] == 1.0


@pytest.mark.parametrize("number", [1e300, -1e300])
def test_no_number_is_too_large(number):
    assert abs(law().bound(1.0, 0.0, number, 0.01, [(0.033, number)]).velocity_m_s) <= 1.0


def test_set_points_act_within_their_intervals():
    """A set-point acts from its sending until the latency after its replacement; after the hold, the link brakes."""
    set_points = [(0.2, 0.7), (0.1, -0.4), (0.03, 0.9)]  # the first is 100 ms old when the second comes
    rule = law(latency=20, hold=45)
    assert [tuple(round(each, 6) for each in part) for part in stretches(rule, set_points, -0.2, 0.02)] == [
        (0.02, 0.7, 0.0),  # the set-point before it is zero
        (0.025, 0.7, 0.7),
        (0.02, 0.7, 0.0),  # it is 45 ms old: the link brakes
        (0.035, 0.0, 0.0),
        (0.02, 0.0, -0.4),
        (0.025, -0.4, -0.4),
        (0.02, 0.0, -0.4),
        (0.005, 0.0, 0.0),
        (0.02, 0.9, 0.0),
        (0.03, 0.9, 0.9),
    ]


def test_the_fastest_cart_speeds_up_by_the_surge_and_slows_down_by_the_brake():
    assert fastest(law(), 0.0, [(0.1, 1.0)]) == pytest.approx(0.9)
    assert fastest(law(), 0.0, [(0.1, 1.0), (0.1, 1.0), (0.1, 0.0)]) == pytest.approx(0.7)
