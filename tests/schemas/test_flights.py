"""Scenarios of the paper's test sets, the criterion of success, and shares that add up."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from softarm.schemas import flights
from softarm.schemas.flights import (
    CART_STARTS_M,
    SHELF_MIDDLE_M,
    TEST_TARGETS,
    TRAINED_Z_MAX_M,
    Flight,
    Scenario,
    Swing,
)
from softarm.schemas.goals import Goal, GoalStatus
from softarm.schemas.robot import RAIL_LIMIT_M

metres = st.floats(0.0, 1.0)


def test_the_test_targets_are_the_papers_grid_from_three_starts():
    assert len(TEST_TARGETS) == 54
    assert {goal.y_m for goal in TEST_TARGETS} == {round(-0.05 * i, 2) for i in range(9)}
    assert sorted({goal.z_m for goal in TEST_TARGETS}) == [0.55, 0.6, 0.65, 0.7, 0.75, 0.8]
    scenarios = flights.grid()
    assert len(scenarios) == len(set(scenarios)) == 162
    assert {scenario.cart_start_m for scenario in scenarios} == set(CART_STARTS_M) == {0.0, 0.1, 0.2}
    assert {scenario.seed for scenario in scenarios} == set(range(54))  # of a target, whatever the start
    assert all(scenario.shelf_m is None and scenario.swing is None for scenario in scenarios)


def test_the_paper_swings_into_twelve_shelves_and_the_random_ones_lie_in_its_training_range():
    twelve = flights.shelf()
    assert len(twelve) == 12
    assert {(each.goal.y_m, each.goal.z_m) for each in twelve} == {
        (-0.48, 0.6),
        (-0.48, 0.63),
        (-0.48, 0.66),
        (-0.53, 0.63),
    }
    assert {each.depth_m for each in twelve} == {SHELF_MIDDLE_M}
    assert flights.random_shelf() == flights.random_shelf()
    assert len(flights.random_shelf()) == 500
    for each in flights.random_shelf():
        assert -0.48 <= each.goal.y_m <= -0.40
        assert 0.58 <= each.goal.z_m <= 0.67
        assert -0.05 <= each.depth_m <= 0.20
        assert -0.025 <= each.cart_start_m <= 0.24


def test_a_shelf_is_placed_by_the_depth_and_height_of_its_target():
    scenario = Scenario(Goal("reach", -0.45, 0.6), 0.1, depth_m=0.07)
    assert scenario.shelf_m == pytest.approx((-0.38, 0.595))


def test_an_arm_is_swung_the_same_way_from_the_same_seed_and_within_what_actuators_do():
    scenarios = flights.swinging()
    assert scenarios == flights.swinging()
    assert len({scenario.swing for scenario in scenarios}) == 162
    for scenario in scenarios[:30]:
        assert scenario.cart_start_m == scenario.swing.cart_start_m
        assert 15 <= scenario.swing.ticks <= 75
        commands = np.array([scenario.swing.command(tick) for tick in range(scenario.swing.ticks)])
        assert np.abs(commands[:, 0]).max() <= 0.6 + 1e-6
        assert 1.0 - 1e-5 <= commands[:, 1].min() <= commands[:, 1].max() <= 17.0 + 1e-5
    assert Swing.draw(3) == Swing.draw(3) != Swing.draw(4)


@given(reached=st.booleans(), max_cart_m=metres)
def test_a_flight_succeeds_if_the_target_is_reached_within_the_rails_limit(reached, max_cart_m):
    status = GoalStatus(TEST_TARGETS[0], "reached" if reached else "failed")
    flight = Flight(status, max_tip_z_m=0.6, max_cart_m=max_cart_m, ticks=9)
    assert flight.reached == flights.counts(reached, max_cart_m) == (reached and max_cart_m <= RAIL_LIMIT_M)


@given(st.lists(st.tuples(st.booleans(), metres), min_size=1))
def test_shares_are_those_of_their_part_and_add_up(flown):
    reached, z_m = zip(*flown, strict=True)
    shares = flights.shares(reached, z_m)
    low = [hit for hit, z in flown if z <= TRAINED_Z_MAX_M + 1e-4]
    above = [hit for hit, z in flown if z > TRAINED_Z_MAX_M + 1e-4]
    counted = 0.0
    for part, share in ((low, shares.in_range), (above, shares.above)):
        if part:
            assert 0.0 <= share <= 1.0
            counted += len(part) * share
        else:
            assert np.isnan(share)
    assert shares.all == pytest.approx(counted / len(flown))
    assert shares.all == pytest.approx(sum(reached) / len(flown))
    assert flights.shares(reached[::-1], z_m[::-1]) == pytest.approx(shares, nan_ok=True)


@pytest.mark.parametrize("precision", [np.float32, np.float64])
def test_the_border_is_in_range_however_it_is_rounded(precision):
    heights = np.array([0.55, 0.60, 0.65, 0.70, 0.75, 0.80], dtype=precision)
    assert flights.in_range(heights).tolist() == [True, True, True, True, False, False]
    assert flights.in_range(np.linspace(0.55, 0.80, 6, dtype=precision)).sum() == 4


def test_shares_need_flights_and_one_target_each():
    with pytest.raises(ValueError, match="0 flights"):
        flights.shares([], [])
    with pytest.raises(ValueError, match="2 flights and 1 targets"):
        flights.shares([True, False], [0.6])


def test_shares_are_plain_numbers_and_a_sentence():
    shares = flights.shares(np.array([True, False, True, True]), np.float32([0.6, 0.6, 0.8, 0.8]))
    assert json.loads(json.dumps(shares._asdict())) == {"in_range": 0.5, "above": 1.0, "all": 0.75}
    assert shares.sentence == "50.0% in range, 100.0% above, 75.0% in all"
