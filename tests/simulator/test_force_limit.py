"""The effect rail.force_limit: the remaining force and external forces move the cart."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks import commands
from softarm.schemas.model import Arm, Cart, Model, seed_effects
from softarm.simulator.simulator import Simulator
from tests.simulator import stages

CART, ARM = Cart(), Arm()
ENDLESS = Cart(travel_m=100.0)
PERIOD_S = 1 / 30


def limited(force_n: float) -> dict[str, dict[str, float]]:
    """The seed's effects and this one."""
    return seed_effects() | {"rail.force_limit": {"force": force_n}}


def ride(effects: dict[str, dict[str, float]], command: float, push: float) -> np.ndarray:
    """Velocities of a cart without an arm, at 1200 Hz."""
    t = np.arange(360) / 1200
    model = Model(cart=ENDLESS, effects=effects)
    v = stages.rail_alone(model, t, np.full(len(t), command), t, arm_force_n=push, physics_rate_hz=1200.0)
    return np.asarray(v[:, 0], dtype=float)


@pytest.mark.parametrize("force_n", [0.8, 1.6])
@pytest.mark.parametrize("push_n", [-0.5, 0.0, 0.5])
def test_at_its_limit_the_drive_pushes_with_that_and_what_else_pushes_counts(force_n: float, push_n: float) -> None:
    """Newton: the slope is the sum of forces over the cart's mass, whatever acceleration is commanded."""
    v = ride(limited(force_n), 2.0, push_n)
    t = np.arange(len(v)) / 1200
    late = t > PERIOD_S + 0.01
    slope = np.polyfit(t[late], v[late], 1)[0]
    assert slope == pytest.approx((force_n + push_n) / CART.mass_kg, rel=1e-3)


def test_only_a_force_above_the_limit_moves_the_cart() -> None:
    away, held = (ride(limited(1.5), 0.0, push) for push in (2.0, 1.2))
    assert away[-1] == pytest.approx(0.5 / CART.mass_kg * 0.3, rel=0.1)
    assert held[-1] == pytest.approx(1.2 / CART.velocity_gain_n_s_m, rel=0.02)  # no stiffer than its gain


def test_a_drive_with_an_acceleration_limit_answers_a_push_with_its_gain() -> None:
    """Unlike a motor at its force limit, which has nothing left to answer with."""
    tracking = seed_effects() | {"rail.acceleration_limit": {"acceleration": 2.2}}
    pushed, alone = ((v[-1] - v[-121]) * 10 for v in (ride(tracking, 2.0, push_n) for push_n in (-0.4, 0.0)))
    assert pushed - alone == pytest.approx(-0.4 / (CART.mass_kg + CART.acceleration_gain_kg), rel=1e-2)


@settings(deadline=None, max_examples=40, derandomize=True)
@given(
    seed=st.integers(0, 2**16),
    force_n=st.floats(0.5, 10.0),
    rate_hz=st.sampled_from([240.0, 480.0, 1200.0]),
    gap_m=st.sampled_from([0.0, 0.004]),
    lag_s=st.sampled_from([0.0, 0.04]),
    acceleration=st.sampled_from([2.0, 6.0, 40.0, np.inf]),
)
def test_no_substep_gives_a_cart_more_than_the_limit(
    seed: int, force_n: float, rate_hz: float, gap_m: float, lag_s: float, acceleration: float
) -> None:
    """Mass times the change of velocity, less what was pushed: the drive's own share of every single substep."""
    random = np.random.default_rng(seed)
    steps = 120
    t = np.arange(steps + 1) / rate_hz
    command = random.uniform(-2.0, 2.0, steps // 8 + 1).repeat(8)[: steps + 1]
    push = random.uniform(-8.0, 8.0, steps + 1)
    effects = {
        "rail.force_limit": {"force": force_n},
        "rail.acceleration_limit": {"acceleration": acceleration},
        "rail.delay": {"delay": float(random.uniform(0.0, 0.05))},
        "rail.backlash": {"gap": gap_m},
        "rail.lag": {"time": lag_s},
    }
    model = Model(cart=ENDLESS, effects=effects)
    v = stages.rail_alone(model, t, command, t, arm_force_n=push, physics_rate_hz=rate_hz)
    given_n = CART.mass_kg * np.diff(v[:, 0].astype(float)) * rate_hz - push[:-1]
    assert np.abs(given_n).max() <= force_n + 2e-4 * (1.0 + np.abs(v).max() * rate_hz / 240.0)


def momentum_n_s(simulator: Simulator) -> np.ndarray:
    """Along the rail, of cart and links, from the motion of the links' centres; [R]."""
    v = simulator.cart_velocity_m_s.astype(float)
    total, end = CART.mass_kg * v, v.copy()
    for i, (length, mass) in enumerate(zip(ARM.link_length_m, ARM.link_mass_kg, strict=True)):
        turning = length * np.cos(simulator.link_angles_rad[:, i]) * simulator.link_rates_rad_s[:, i]
        total, end = total + mass * (end + turning / 2), end + turning
    return total


def test_a_swinging_arm_on_its_cart_gains_no_more_momentum_than_the_limit_gives() -> None:
    limits = np.array([0.8, 1.2, 1.6, 2.2, np.inf, 50.0])
    model = Model(cart=ENDLESS, effects=seed_effects())
    simulator = Simulator(model, 6, 2400.0, dtype=np.float64, overrides={"rail.force_limit.force": limits})
    velocity, pressure = commands.bang_bang(1, seed=3)
    forces = []
    for v, p in zip(velocity[:30, 0], pressure[:30, 0], strict=True):
        for _ in range(80):
            before = momentum_n_s(simulator)
            simulator.step(v, p, 1 / 2400)
            forces.append((momentum_n_s(simulator) - before) * 2400)
    most = np.abs(forces).max(axis=0)
    assert (most[:4] < limits[:4] * 1.01).all()
    assert (most[:4] > limits[:4] * 0.99).all()  # and it does reach them
    assert most[4] > 3.0
    assert most[5] == most[4]  # a limit that is never reached is none


def test_a_cart_that_is_held_or_given_has_no_drive_to_limit() -> None:
    free, bound = (Simulator(Model(effects=limited(force)), 1, fixed_base=True) for force in (200.0, 0.5))
    for simulator in (free, bound):
        simulator.reset(joint_angles_rad=0.2)
        for _ in range(20):
            simulator.step(0.5, 10.0)
    np.testing.assert_array_equal(free.link_angles_rad, bound.link_angles_rad)
    assert abs(bound.cart_position_m[0]) < 1e-9
