"""Whole plans and recordings in one call, a batch at the state of one robot, points of a trajectory."""

import numpy as np
import pytest

from benchmarks import commands
from softarm.schemas.model import Arm, Model
from softarm.simulator.simulator import Simulator
from softarm.simulator.stage_simulator import StageSimulator

STEPS = 12


@pytest.mark.parametrize("robots", [5, 40, 70])
def test_a_plan_flown_in_one_call_is_the_steps_it_consists_of(robots: int) -> None:
    velocity, pressure = (each[:STEPS] for each in commands.bang_bang(robots, seed=robots))
    whole, stepped = Simulator(robots=robots), Simulator(robots=robots)
    path = whole.fly(velocity, pressure)
    assert path.shape == (STEPS, 4, robots)
    for step in range(STEPS):
        stepped.step(velocity[step], pressure[step])
        seen = (stepped.cart_position_m, stepped.cart_velocity_m_s, *stepped.tip_m().T)
        np.testing.assert_array_equal(path[step], seen)
    assert whole.time_s == pytest.approx(stepped.time_s)
    np.testing.assert_array_equal(whole.tip_m(), stepped.tip_m())


@pytest.mark.parametrize("shapes", [((3, 4), (3, 4)), ((3, 5), (2, 5)), ((5,), (5,))])
def test_plans_of_another_shape_are_refused(shapes) -> None:
    with pytest.raises(ValueError, match=r"steps, 5"):
        Simulator(robots=5).fly(np.zeros(shapes[0]), np.zeros(shapes[1]))


def test_a_batch_takes_over_one_robot_with_its_commands_under_way() -> None:
    velocity, pressure = commands.smooth(3, seed=1)
    few, many = Simulator(robots=3), Simulator(robots=40)
    for step in range(20):
        few.step(velocity[step], pressure[step])
    many.take_over(few, robot=1)
    for step in range(20, 30):
        few.step(velocity[step], pressure[step])
        many.step(velocity[step, 1], pressure[step, 1])
    np.testing.assert_array_equal(many.tip_m(), np.tile(few.tip_m()[1], (40, 1)))
    assert not np.array_equal(few.tip_m()[0], few.tip_m()[1])


def test_arms_of_another_number_of_links_are_not_taken_over() -> None:
    shorter = Arm(**{name: value[:4] for name, value in Arm() if isinstance(value, tuple)})
    with pytest.raises(ValueError, match="4 links"):
        Simulator().take_over(Simulator(Model(arm=shorter)))
    for robot in (-1, 3):
        with pytest.raises(ValueError, match=rf"robot is {robot}; the other simulator has 0 to 2"):
            Simulator().take_over(Simulator(robots=3), robot)


def test_robots_put_at_their_own_state_continue_unchanged() -> None:
    """The delayed command still acts; `reset` would have dropped it."""
    velocity, pressure = commands.smooth(6, seed=2)
    touched, left = Simulator(robots=6), Simulator(robots=6)
    for step in range(20):
        if step == 10:
            touched.place(
                touched.cart_position_m,
                touched.cart_velocity_m_s,
                touched.link_angles_rad,
                touched.link_rates_rad_s,
                touched.pressure_kpa,
            )
        touched.step(velocity[step], pressure[step])
        left.step(velocity[step], pressure[step])
    np.testing.assert_array_equal(touched.tip_m(), left.tip_m())
    assert np.ptp(left.tip_m()[:, 0]) > 0.01


@pytest.mark.parametrize("robots", [5, 40])
@pytest.mark.parametrize("effects", [{}, {"arm.payload.mass": 0.01, "rail.delay.delay": 0.02}])
def test_recordings_of_a_stage_flown_in_one_call_are_the_steps_they_consist_of(robots: int, effects) -> None:
    random, at, duration_s = np.random.default_rng(robots), (STEPS, robots), 1 / 60
    speed, push = (random.normal(0, size, at) for size in (0.1, 0.5))
    pressure, late = random.uniform(0, 20, at), random.uniform(0, 0.005, at)
    whole, stepped = StageSimulator(robots=robots, overrides=effects), Simulator(robots=robots, overrides=effects)
    seen_m_s, seen_kpa = whole.fly_cart(speed, push, late, duration_s), whole.fly_pressure(pressure, late, duration_s)
    for step in range(STEPS):
        np.testing.assert_array_equal(seen_kpa[step], stepped.pressure_kpa)
        stepped.step(0.0, pressure[step], duration_s, late_s=late[step])
    alone = StageSimulator(overrides=effects).fly_cart(*(each[:, -1:] for each in (speed, push, late)), duration_s)
    np.testing.assert_array_equal(seen_m_s[:, -1:], alone)
