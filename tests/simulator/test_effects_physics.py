"""Effects against mechanics, and the promises of each way to drive the simulator."""

import math

import numpy as np
import pytest

from benchmarks import commands
from softarm.schemas.model import Arm, Cart, Model
from softarm.schemas.robot import PRESSURE_MAX_KPA, PRESSURE_MIN_KPA, RAIL_LIMIT_M
from softarm.simulator.effects import REGISTRY, exemplars
from softarm.simulator.simulator import Simulator
from tests.simulator import stages


@pytest.mark.parametrize("rate_hz", [240.0, 1200.0])
def test_contact_never_injects_energy(rate_hz: float) -> None:
    """An arm without muscle or drive swings into a board's edge: what energy it has becomes less with every step."""
    model = Model(arm=stages.UNDRIVEN, effects={})
    robots, shelf = 64, (-0.06, 0.56)
    starts = np.random.default_rng(7).uniform(0.1, 0.5, (robots, 1)) * np.linspace(0.2, 1.0, 5)
    friction = {"contact.friction.coefficient": np.arange(robots) % 2 * 0.4}
    free, hit = (Simulator(model, robots, rate_hz, fixed_base=True, overrides=friction) for _ in range(2))
    hit.place_shelf(*shelf)
    for simulator in (free, hit):
        simulator.reset(joint_angles_rad=starts)
    have = have_free = stages.energies_j(hit, shelf, 2000.0)
    gain = gain_free = 0.0
    apart = np.zeros(robots)
    for _ in range(160):
        for simulator in (free, hit):
            simulator.step(0.0, 0.0, 1 / 120)
        had, had_free = have, have_free
        have, have_free = stages.energies_j(hit, shelf, 2000.0), stages.energies_j(free)
        gain, gain_free = max(gain, np.max(have - had)), max(gain_free, np.max(have_free - had_free))
        apart = np.maximum(apart, np.abs(hit.tip_m() - free.tip_m()).max(axis=1))
    assert (apart > 0.02).mean() > 0.9
    assert gain_free < 1e-6
    assert gain < 1e-6


def test_tip_rests_on_a_board_by_its_weight() -> None:
    """An arm bent over a board presses it by what the springs leave of the tip's weight, and lies there."""
    simulator = Simulator(None, 1, 1200.0, fixed_base=True, overrides={"contact.stiffness.stiffness": 5000.0})
    simulator.place_shelf(-0.05, 0.6)
    simulator.reset(joint_angles_rad=[-0.1, -0.4, -0.5, -0.5, -0.3], pressure_kpa=18.0)
    for _ in range(150):
        simulator.step(0.0, 2.0)
    depth_m = 0.0381 - (simulator.link_ends_m()[0, :, 1].min() - 0.6)
    assert np.abs(simulator.link_rates_rad_s).max() < 1e-3
    assert -0.0381 < depth_m < 0.0382
    lying = simulator.link_ends_m()[0]
    simulator.place_shelf(-1e3, 0.0)
    simulator.step(0.0, 2.0, 1.0)
    assert np.abs(simulator.link_ends_m()[0] - lying).max() > 0.03  # it was the board that held it


def test_the_arm_alone_reproduces_the_robot_from_measurements() -> None:
    """Pressure and cart of a flight, sampled at 240 Hz, move the arm as they did in it."""
    velocity, pressure = (commanded[:45, 0] for commanded in commands.smooth(1, seed=3))
    stamps, fine = np.arange(45) / 30, np.arange(0, 356) / 240
    simulator, looks = Simulator(None, 1, 1200.0), []
    for k in range(356):
        cart = simulator.cart_position_m, simulator.cart_velocity_m_s
        looks.append(np.concatenate((*cart, simulator.pressure_kpa, *simulator.link_ends_m()[0].T)))
        simulator.step(velocity[k // 8], pressure[k // 8], 1 / 240)
    measured, flown = np.split(np.stack(looks, axis=1), [3])
    assert np.ptp(flown[4]) > 0.2  # y of the tip
    found = stages.arm_alone(Model(), measured, 1 / 240, physics_rate_hz=1200.0)
    np.testing.assert_allclose(found[..., 0], flown.T, atol=5e-4)
    np.testing.assert_allclose(stages.pressure_alone(Model(), stamps, pressure, fine)[:, 0], measured[2], atol=1e-3)


@pytest.mark.parametrize("rate_limit", [math.inf, 20.0])
def test_a_leak_drains_the_muscle_by_the_flow_balance(rate_limit: float) -> None:
    """The flow balance is integrated step by step: what the valve lets in or out, less what leaks."""
    rate, inflate, deflate = 0.8, 0.2, 0.3
    effects = {"pressure.lag": {"inflate": inflate, "deflate": deflate}, "pressure.leak": {"rate": rate}}
    if math.isfinite(rate_limit):
        effects["pressure.rate_limit"] = {"rate": rate_limit}
    stamps = np.arange(60) / 30
    command = np.where(stamps < 1.0, 15.0, 3.0)
    fine, expected, p = 400, [0.0], 0.0
    for target in command[:-1]:
        for _ in range(fine):
            valve = (target - p) / (inflate if target > p else deflate)
            p += (min(max(valve, -rate_limit), rate_limit) - rate * p) / (30 * fine)
        expected.append(p)
    found = stages.pressure_alone(Model(effects=effects), stamps, command, stamps)
    np.testing.assert_allclose(found[:, 0], expected, atol=0.03)
    assert found[:, 0].max() < 15.0 / (1.0 + rate * inflate) + 0.01


def test_every_robot_has_its_own_model() -> None:
    models = [Model(), Model(effects={}), Model(arm=Arm(stiffness_nm_rad=(1.0,) * 5))]
    together = Simulator(models)
    alone = [Simulator(model) for model in models]
    for v, p in zip(*(sets[:20, 0] for sets in commands.bang_bang(1, seed=6)), strict=True):
        together.step(v, p)
        for simulator in alone:
            simulator.step(v, p)
    for i, simulator in enumerate(alone):
        np.testing.assert_array_equal(simulator.tip_m()[0], together.tip_m()[i])
    with pytest.raises(ValueError, match="2 models for 3 robots"):
        Simulator(models[:2], 3)
    with pytest.raises(ValueError, match=r"one entry a robot, \(3,\)"):
        Simulator(models, overrides={"rail.delay.delay": [0.0, 0.1]})
    with pytest.raises(ValueError, match=r"arm.payload.mass: is 7; allowed 0 to 0.5 kg"):
        Simulator(models, overrides={"arm.payload.mass": [0.0, 0.1, 7.0]})
    with pytest.raises(ValueError, match=r"pressure.ceiling.limit: is 5000; allowed"):
        Simulator(models, overrides={"pressure.ceiling.limit": [10.0, 5000.0, np.inf]})


SYMMETRIC = ("arm.coulomb_friction", "arm.drag", "arm.stiffening", "arm.creep", "rail.backlash")


@pytest.mark.parametrize("mirrored", SYMMETRIC)
def test_mirrored_inputs_give_mirrored_motion(mirrored: str) -> None:
    both = (mirrored, "rail.coulomb_friction")
    effects = {name: exemplars()[name] for name in both}
    simulator = Simulator(Model(arm=Arm(torque_offset_nm=(0.0,) * 5), effects=effects), 2)
    simulator.reset(joint_angles_rad=np.array([[0.3, -0.2, 0.1, 0.2, 0.1]]) * [[1.0], [-1.0]])
    for v, p in zip(*(sets[:40, 0] for sets in commands.smooth(1, seed=5)), strict=True):
        simulator.step(np.array([v, -v]), np.array([p, -p]))
    np.testing.assert_allclose(simulator.link_angles_rad[0], -simulator.link_angles_rad[1], atol=2e-4)


def test_single_precision_at_240_hz_is_near_the_reference_with_all_effects() -> None:
    """Against the same flight in float64 at 9.6 kHz; the effects' kinks cost some of the smooth scheme's accuracy."""
    effects = {
        name: strong
        for name, strong in exemplars().items()
        if REGISTRY[name].stage in ("pressure", "rail", "arm") and strong
    }
    model = Model(cart=Cart(travel_m=100.0), effects=effects)
    flown = [commanded[:60] for commanded in commands.smooth(8, seed=8)]
    exact = stages.tips_m(model, *flown, 9_600.0, np.float64)
    coarse, fine = (1e3 * np.linalg.norm(stages.tips_m(model, *flown, hz) - exact, axis=1) for hz in (240.0, 1200.0))
    assert coarse.mean() < 3.0
    assert fine.mean() < 0.5


def drawn(rng: np.random.Generator, robots: int) -> dict[str, np.ndarray]:
    """Return overrides with each parameter independently at neutral, uniform, or uniform in its magnitude."""
    values = {}
    for effect in REGISTRY.values():
        for p in effect.parameters if effect.stage in ("pressure", "rail", "arm", "contact") else ():
            even = rng.uniform(p.low, p.high, robots)
            small = p.low + (p.high - p.low) * 10 ** rng.uniform(-4, 0, robots)
            kind = rng.integers(0, 5, robots)
            values[f"{effect.name}.{p.name}"] = np.select([kind < 2, kind < 4], [even, small], p.neutral)
    return values


@pytest.mark.parametrize("rate_hz", [120.0, 240.0])
def test_random_parameters_within_bounds_stay_finite(rate_hz: float) -> None:
    """Full-range commands every tenth of a second, and a shelf within reach."""
    robots, rng = 1024, np.random.default_rng(round(rate_hz))
    simulator = Simulator(None, robots, rate_hz, overrides=drawn(rng, robots))
    simulator.place_shelf(rng.uniform(-0.6, -0.25, robots), rng.uniform(0.55, 0.7, robots))
    simulator.reset(
        cart_position_m=rng.uniform(-0.025, RAIL_LIMIT_M, robots),
        joint_angles_rad=rng.uniform(-0.17, 0.17, (robots, 5)),
        pressure_kpa=rng.uniform(0.0, PRESSURE_MAX_KPA, robots),
    )
    for step in range(100):
        if step % 3 == 0:
            velocity = rng.uniform(-1.0, 1.0, robots)
            pressure = rng.choice([PRESSURE_MIN_KPA, PRESSURE_MAX_KPA], robots)
        simulator.step(velocity, pressure)
    assert np.isfinite(simulator.link_angles_rad).all()
    assert np.isfinite(simulator.cart_position_m).all()
