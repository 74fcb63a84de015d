"""The arm against mechanics, without the kernel's own formulas."""

from collections.abc import Callable

import numpy as np
import pytest

from benchmarks import commands
from softarm.schemas.model import Arm, Cart, Model, seed_effects
from softarm.simulator.simulator import Simulator
from tests.simulator.stages import UNDRIVEN, energies_j, tips_m


def test_energy_is_conserved_to_second_order() -> None:
    """No damping, no drive: what energy drifts in a second falls fourfold as the step is halved."""
    free = UNDRIVEN.model_copy(update={"damping_nm_s_rad": (0.0,) * 5})
    model = Model(arm=free, cart=Cart(velocity_gain_n_s_m=0.0, travel_m=100.0), effects={})
    drifts = []
    for rate_hz in (1200.0, 2400.0, 4800.0):
        simulator = Simulator(model, 1, rate_hz, dtype=np.float64)
        simulator.reset(joint_angles_rad=[0.5, 0.3, 0.2, 0.1, 0.1])
        before = energies_j(simulator)[0]
        worst = 0.0
        for _ in range(30):
            simulator.step(0.0, 0.0)
            worst = max(worst, abs(energies_j(simulator)[0] - before))
        drifts.append(worst)
    assert drifts[0] < 0.01 * abs(before)
    assert np.log2(drifts[0] / drifts[1]) > 1.8
    assert np.log2(drifts[1] / drifts[2]) > 1.8


def test_error_falls_with_the_square_of_the_step() -> None:
    effects = {name: given for name, given in seed_effects().items() if name != "rail.acceleration_limit"}
    model = Model(cart=Cart(travel_m=100.0), effects=effects)

    def tip_m(rate_hz: float) -> np.ndarray:
        simulator = Simulator(model, 1, rate_hz, dtype=np.float64)
        simulator.reset(joint_angles_rad=0.1)
        for v, p in zip((0.5, -0.5, 0.8), (5.0, 15.0, 0.0), strict=True):
            simulator.step(v, p, 0.2)
        return simulator.tip_m()[0]

    exact = tip_m(30_000.0)
    errors = [np.linalg.norm(tip_m(rate_hz) - exact) for rate_hz in (300.0, 600.0, 1200.0, 2400.0)]
    assert np.all(np.log2(np.divide(errors[:-1], errors[1:])) > 1.9)


@pytest.mark.parametrize("draw", [commands.smooth, commands.bang_bang])
def test_drive_s_switching_costs_no_accuracy(draw: Callable[..., tuple[np.ndarray, np.ndarray]]) -> None:
    """The drive changes its law within steps, thousands of times here; the error stays docs/training/simulator.md's."""
    model, (velocity, pressure) = Model(cart=Cart(travel_m=100.0)), draw(256, seed=9)
    exact = tips_m(model, velocity, pressure, 9600.0)
    for rate_hz, mean_mm, max_mm in ((240.0, 0.25, 1.5), (1200.0, 0.025, 0.15)):
        error_mm = 1e3 * np.linalg.norm(tips_m(model, velocity, pressure, rate_hz) - exact, axis=1)
        assert error_mm.mean() < mean_mm
        assert error_mm.max() < max_mm


def test_single_precision_costs_nothing() -> None:
    """At 1200 Hz float32 and float64 end 3 s of hard commands within a tenth of the scheme's own error."""
    velocity, pressure = commands.bang_bang(8, seed=4)
    single, double = (tips_m(None, velocity, pressure, 1200.0, dtype) for dtype in (np.float32, np.float64))
    assert np.abs(single - double).max() < 2e-5


def test_pressure_keeps_the_seed_s_share_of_its_old_value_at_30_hz() -> None:
    """0.81 inflating, 0.86 deflating, whatever the physics' rate."""
    for rate_hz in (240.0, 1200.0):
        simulator = Simulator(None, 2, rate_hz)
        simulator.reset(pressure_kpa=[0.0, 20.0])
        for step in range(1, 4):
            simulator.step(0.0, np.array([10.0, 5.0]))
            rising, falling = simulator.pressure_kpa
            assert rising == pytest.approx(10.0 * (1.0 - 0.81**step), rel=1e-5)
            assert falling == pytest.approx(5.0 + 15.0 * 0.86**step, rel=1e-5)


def test_without_lag_pressure_follows_at_once() -> None:
    simulator = Simulator(Model(effects={}))
    simulator.step(0.0, 7.0)
    assert simulator.pressure_kpa[0] == 7.0


@pytest.mark.parametrize("delay_s", [0.01, 1 / 30, 0.06, 0.1])
def test_delay_shifts_the_answer_and_nothing_else(delay_s: float) -> None:
    """Commands at irregular times: what the cart does now, it does without delay that much earlier."""
    rng = np.random.default_rng(6)
    substeps = rng.integers(12, 60, 40)  # 10 to 50 ms each, in 1200ths of a second
    velocity = rng.uniform(-1.0, 1.0, len(substeps)).repeat(substeps)

    def ride(delay_s: float) -> np.ndarray:
        effects = seed_effects() | {"rail.delay": {"delay": delay_s}}
        simulator = Simulator(Model(arm=UNDRIVEN, effects=effects), 1, 1200.0)
        positions = []
        for v in velocity:
            simulator.step(v, 0.0, 1 / 1200)
            positions.append(simulator.cart_position_m[0])
        return np.array(positions)

    shift = round(delay_s * 1200)
    np.testing.assert_allclose(ride(delay_s)[shift:], ride(0.0)[:-shift], atol=1e-6)


@pytest.mark.parametrize("acceleration", [3.0, 6.0])
def test_cart_ramps_at_the_drive_s_acceleration(acceleration: float) -> None:
    """From rest to 0.8 m/s. The arm is soft: the drive pushes against a part of its mass, between none and all."""
    effects = {name: given for name, given in seed_effects().items() if name != "rail.delay"}
    effects |= {"rail.acceleration_limit": {"acceleration": acceleration}}
    cart = Cart(travel_m=10.0)
    simulator = Simulator(Model(cart=cart, effects=effects), 1, 1200.0)
    times, velocities = [], []
    for _ in range(1200):
        simulator.step(0.8, 0.0, 1 / 1200)
        times.append(simulator.time_s)
        velocities.append(simulator.cart_velocity_m_s[0])
    ramp = np.array(velocities) < 0.65
    slope = np.polyfit(np.array(times)[ramp], np.array(velocities)[ramp], 1)[0]
    force_kg = cart.feedforward_mass_kg + cart.acceleration_gain_kg
    moved_kg = cart.mass_kg + cart.acceleration_gain_kg
    assert force_kg / (moved_kg + sum(Arm().link_mass_kg)) < slope / acceleration < force_kg / moved_kg
    assert velocities[-1] == pytest.approx(0.8, abs=0.08)


def test_end_stops_hold_the_cart() -> None:
    for rate_hz in (120.0, 240.0, 1200.0):
        simulator = Simulator(None, 2, rate_hz)
        furthest = 0.0
        for _ in range(240):
            simulator.step(np.array([1.0, -1.0]), 0.0, 1 / 120)
            furthest = max(furthest, np.abs(simulator.cart_position_m).max())
        assert 0.3 <= furthest < 0.302
        right, left = simulator.cart_position_m
        assert right == pytest.approx(0.3, abs=1e-3)
        assert left == pytest.approx(-0.3, abs=1e-3)


def test_tip_velocity_is_the_rate_of_the_tip() -> None:
    simulator = Simulator(None, 3, 1200.0)
    simulator.step(np.array([1.0, -1.0, 0.3]), np.array([0.0, 20.0, 5.0]), 0.3)
    before, velocity = simulator.tip_m(), simulator.tip_velocity_m_s()
    simulator.step(np.array([1.0, -1.0, 0.3]), np.array([0.0, 20.0, 5.0]), 1 / 1200)
    after, later = simulator.tip_m(), simulator.tip_velocity_m_s()
    np.testing.assert_allclose((after - before) * 1200, (velocity + later) / 2, atol=2e-3)
    assert np.abs(velocity).max() > 0.3


def _fastest_link(damping, stiffness, rate_hz):
    """Return the largest rate of any link within 3 s of hard commands, rad/s."""
    velocity, pressure = commands.bang_bang(64, seed=2)
    overrides = {"arm.damping.scale": damping, "arm.stiffness.scale": stiffness}
    simulator = Simulator(robots=64, physics_rate_hz=rate_hz, overrides=overrides)
    simulator.reset(joint_angles_rad=np.random.default_rng(1).uniform(-0.17, 0.17, (64, 5)))
    most = 0.0
    for v, p in zip(velocity, pressure, strict=True):
        simulator.step(v, p)
        most = max(most, float(np.abs(simulator.link_rates_rad_s).max()))
    return most


@pytest.mark.parametrize(("damping", "stiffness"), [(-0.9, 2.0), (-0.9, 0.5), (-0.8, 2.0)])
def test_a_stiff_arm_with_little_damping_gains_no_energy_at_240_hz(damping, stiffness):
    assert _fastest_link(damping, stiffness, 240) < 1.2 * _fastest_link(damping, stiffness, 2400)


def test_only_stiff_and_undamped_arms_take_finer_substeps():
    ordinary = Simulator(robots=2, overrides={"arm.damping.scale": [-0.8, 1.0], "arm.stiffness.scale": [0.0, 2.0]})
    assert ordinary.prepare(1 / 30)[2] == 8
    undamped = Simulator(robots=2, overrides={"arm.damping.scale": [-0.9, 1.0], "arm.stiffness.scale": 2.0})
    assert undamped.prepare(1 / 30)[2] == 15
