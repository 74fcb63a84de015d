"""Promises of a batch: robots are independent, no command breaks it, arrays belong to the caller."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks import commands
from softarm.schemas.model import Model, seed_effects
from softarm.simulator.simulator import Simulator

SEED = Model()


def state_of(simulator: Simulator) -> np.ndarray:
    columns = (
        simulator.cart_position_m[:, None],
        simulator.cart_velocity_m_s[:, None],
        simulator.pressure_kpa[:, None],
        simulator.link_angles_rad,
        simulator.link_rates_rad_s,
        simulator.tip_m(),
        simulator.tip_velocity_m_s(),
    )
    return np.concatenate(columns, axis=1)


@pytest.mark.parametrize("robots", [5, 40, 1040])
def test_batch_equals_one_by_one_bit_for_bit(robots: int) -> None:
    """In narrow blocks, wide blocks, and wide blocks on all cores, some of them only part full."""
    velocity, pressure = commands.bang_bang(robots, seed=robots)
    starts = np.random.default_rng(robots).uniform(-0.2, 0.2, (robots, 6))
    batch = Simulator(SEED, robots)
    batch.reset(cart_position_m=starts[:, 0], joint_angles_rad=starts[:, 1:])
    for v, p in zip(velocity[:20], pressure[:20], strict=True):
        batch.step(v, p)
    for i in range(0, robots, 7 if robots < 100 else 97):
        alone = Simulator(SEED)
        alone.reset(cart_position_m=starts[i, 0], joint_angles_rad=starts[i, 1:])
        for v, p in zip(velocity[:20, i], pressure[:20, i], strict=True):
            alone.step(v, p)
        np.testing.assert_array_equal(state_of(alone)[0], state_of(batch)[i])


def test_a_robot_with_nan_does_not_affect_others_and_recovers() -> None:
    velocity, pressure = commands.smooth(40, seed=1)
    clean, spoilt = Simulator(SEED, 40), Simulator(SEED, 40)
    for step in range(10):
        clean.step(velocity[step], pressure[step])
        if step == 3:
            velocity[step, 3], pressure[step, 35] = np.nan, np.nan
        spoilt.step(velocity[step], pressure[step])
    broken = np.zeros(40, dtype=bool)
    broken[[3, 35]] = True
    assert np.isnan(spoilt.tip_m()[broken]).all()
    np.testing.assert_array_equal(state_of(clean)[~broken], state_of(spoilt)[~broken])

    spoilt.reset(robots=broken)
    spoilt.step(0.5, 10.0)
    assert np.isfinite(state_of(spoilt)).all()


LEVEL = st.sampled_from([-1.0, 0.0, 1.0]) | st.floats(-1.0, 1.0)
PRESSURE = st.sampled_from([-0.7, 20.0]) | st.floats(-0.7, 20.0)
HELD = st.sampled_from([1 / 30, 0.001, 0.1]) | st.floats(1e-4, 0.2)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(LEVEL, PRESSURE, HELD), min_size=1, max_size=60),
    st.sampled_from([120.0, 240.0, 777.0]),
    st.sampled_from(["pressure.lag", "rail.acceleration_limit", "rail.delay", "nothing"]),
    st.floats(0.0, 0.1),
    st.floats(-0.5, 0.5),
)
def test_no_command_breaks_the_robot(
    script: list[tuple[float, float, float]], rate_hz: float, absent: str, delay_s: float, bend_rad: float
) -> None:
    effects = seed_effects() | {"rail.delay": {"delay": delay_s}}
    effects.pop(absent, None)
    simulator = Simulator(Model(effects=effects), 1, rate_hz)
    simulator.reset(joint_angles_rad=bend_rad)
    for velocity, pressure, duration in script:
        simulator.step(velocity, pressure, duration)
    state = state_of(simulator)
    assert np.isfinite(state).all()
    assert abs(simulator.cart_position_m[0]) < 0.32
    assert np.abs(simulator.link_angles_rad).max() < 4.0
    assert -0.7001 <= simulator.pressure_kpa[0] <= 20.001


def test_only_the_chosen_robots_are_reset() -> None:
    simulator = Simulator(SEED, 20)
    simulator.step(0.5, 10.0, 0.5)
    before = state_of(simulator)
    positions = np.linspace(-0.1, 0.1, 20)
    mask = np.zeros(20, dtype=bool)
    mask[[2, 11]] = True
    simulator.reset(robots=mask, cart_position_m=positions, pressure_kpa=3.0)
    simulator.reset(robots=[19], joint_angles_rad=[0.1, 0.0, 0.0, 0.0, 0.2])
    after = state_of(simulator)
    kept = np.setdiff1d(np.arange(20), [2, 11, 19])
    np.testing.assert_array_equal(after[kept], before[kept])
    np.testing.assert_allclose(simulator.cart_position_m[[2, 11, 19]], [positions[2], positions[11], 0.0])
    np.testing.assert_allclose(simulator.pressure_kpa[[2, 11, 19]], [3.0, 3.0, 0.0])
    np.testing.assert_allclose(simulator.link_angles_rad[19], [0.1, 0.1, 0.1, 0.1, 0.3], rtol=1e-6)
    assert not simulator.link_rates_rad_s[[2, 11, 19]].any()


def test_reset_forgets_commands_on_their_way() -> None:
    simulator = Simulator(SEED, 2, 1200.0)
    simulator.step(1.0, 0.0)  # reaches the cart only after this step
    simulator.reset(robots=[0])
    simulator.step(0.0, 0.0)
    still, moving = simulator.cart_velocity_m_s
    assert moving > 0.1
    assert abs(still) < 0.01


def test_arrays_are_copies_of_the_stated_shape() -> None:
    for robots in (1, 8, 32, 33):
        simulator = Simulator(SEED, robots)
        shapes = {
            "cart_position_m": (robots,),
            "cart_velocity_m_s": (robots,),
            "pressure_kpa": (robots,),
            "joint_angles_rad": (robots, 5),
            "link_angles_rad": (robots, 5),
            "link_rates_rad_s": (robots, 5),
            "link_ends_m": (robots, 5, 2),
            "tip_m": (robots, 2),
            "tip_velocity_m_s": (robots, 2),
        }
        for name, shape in shapes.items():
            value = getattr(simulator, name)
            array = value() if callable(value) else value
            assert array.shape == shape, name
            assert array.dtype == np.float32, name
            array[...] = 7.0
        assert not simulator.link_angles_rad.any()
        np.testing.assert_array_equal(simulator.tip_m(), simulator.link_ends_m()[:, -1])
        np.testing.assert_allclose(simulator.tip_m()[0], [0.0, 0.965 - 0.4425], atol=1e-6)


def test_scalars_and_arrays_are_the_same_command() -> None:
    states = []
    for v, p in ((0.5, 9), (np.float32(0.5), np.array(9.0)), (np.full(3, 0.5), [9.0, 9.0, 9.0])):
        simulator = Simulator(SEED, 3)
        simulator.step(v, p)
        states.append(state_of(simulator))
    np.testing.assert_array_equal(states[0], states[1])
    np.testing.assert_array_equal(states[0], states[2])


@pytest.mark.parametrize(
    "begin",
    [
        {"overrides": {"pressure.dead_time.delay": 0.1}},
        {"overrides": {"rail.lag.time": 0.2}},
        {"late_s": 0.01},
    ],
)
def test_an_effect_that_begins_in_flight_continues_the_motion(begin: dict[str, Any]) -> None:
    simulator = Simulator(SEED, 2)
    for velocity_m_s in [0.0] * 60 + [0.5] * 9:
        simulator.step(velocity_m_s, 8.0)
    before = simulator.pressure_kpa, simulator.cart_velocity_m_s
    simulator.override(begin.get("overrides", {}))
    for _ in range(3):
        simulator.step(0.5, 8.0, late_s=begin.get("late_s"))
        np.testing.assert_allclose(simulator.pressure_kpa, before[0], atol=0.01)
        np.testing.assert_allclose(simulator.cart_velocity_m_s, before[1], atol=0.02)


def test_time_counts_from_the_last_full_reset() -> None:
    simulator = Simulator(SEED, 2)
    simulator.step(0.0, 0.0, 0.25)
    simulator.reset(robots=[1])
    assert simulator.time_s == 0.25
    simulator.reset()
    assert simulator.time_s == 0.0


def test_rejections_state_the_allowed_values() -> None:
    simulator = Simulator(SEED, 3)
    with pytest.raises(ValueError, match=r"robots is 0; a simulator holds 1 or more"):
        Simulator(SEED, 0)
    with pytest.raises(ValueError, match=r"physics_rate_hz is 60.*120 or more"):
        Simulator(SEED, 1, 60.0)
    with pytest.raises(ValueError, match=r"shape \(2,\).*scalar or one entry a robot, \(3,\)"):
        simulator.step(np.zeros(2), 0.0)
    for duration in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="give a positive number of seconds"):
            simulator.step(0.0, 0.0, duration)
    with pytest.raises(ValueError):
        simulator.reset(joint_angles_rad=np.zeros((3, 4)))
    with pytest.raises(IndexError):
        simulator.reset(robots=[3])
