"""The effect rail.servo: a ramp, a lag, and a loop with feed-forward that saturates."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lsim

from benchmarks import commands
from softarm.reality.parameters import Rail, RobotParameters
from softarm.reality.robot import Robot
from softarm.schemas.model import Cart, Model, seed_effects
from softarm.simulator.kernel.rail import REACH_M
from softarm.simulator.simulator import Simulator
from tests.simulator import stages

PERIOD_S = 1 / 30
# Feed-forward of the bare cart's own mass: what is not pushed from outside is where its reference is.
IDEAL = Cart(travel_m=100.0, feedforward_mass_kg=0.4)
# Seconds, m/s: steps of several sizes, and turns before the ramp has arrived.
TURNS = ((0.0, 0.8), (0.3, -0.6), (0.4, 0.5), (0.47, -1.0), (1.0, 0.2))
END_S = 1.5


def effects(acceleration: float, **others: dict[str, float]) -> dict[str, dict[str, float]]:
    """A servo, the slope of its ramp, and other effects of the rail; no delay."""
    return {"rail.servo": {}, "rail.acceleration_limit": {"acceleration": acceleration}} | {
        f"rail.{name}": values for name, values in others.items()
    }


def ride(model: Model, t: np.ndarray, push_n: float = 0.0, rate_hz: float = 1200.0) -> np.ndarray:
    """Velocities of a cart without an arm under TURNS, at t."""
    times, command = np.array(TURNS).T
    v = stages.rail_alone(model, times, command, t, arm_force_n=push_n, physics_rate_hz=rate_hz)
    return np.asarray(v[:, 0], dtype=float)


def corners(acceleration: float) -> tuple[np.ndarray, np.ndarray]:
    """Times and values of the ramp's corners: a polygon, written out turn by turn."""
    t, r, ends = [0.0], [0.0], [start for start, _ in TURNS[1:]] + [END_S]
    for (start, command), end in zip(TURNS, ends, strict=True):
        arrived = start + abs(command - r[-1]) / acceleration
        if arrived < end:
            t.append(arrived)
            r.append(command)
        t.append(end)
        r.append(r[-1] + np.clip(command - r[-1], -acceleration * (end - start), acceleration * (end - start)))
    return np.array(t), np.array(r)


def lagged(t: np.ndarray, corner_s: np.ndarray, corner_m_s: np.ndarray, lag_s: float) -> np.ndarray:
    """The polygon behind a first-order lag; exact, since its corners are at multiples of the step."""
    fine = np.linspace(0.0, END_S, round(12_000 * END_S) + 1)
    _, behind, _ = lsim(([1.0], [lag_s, 1.0]), np.interp(fine, corner_s, corner_m_s), fine)
    return np.interp(t, fine, behind)


@pytest.mark.parametrize("acceleration", [2.0, 6.0])
@pytest.mark.parametrize("lag_s", [0.0, 1e-4, 0.015, 0.06])
def test_the_reference_ramps_and_then_lags(acceleration: float, lag_s: float) -> None:
    t = np.arange(0.0, END_S, 1 / 120)
    v = ride(Model(cart=IDEAL, effects=effects(acceleration, lag={"time": lag_s})), t)
    corner_s, corner_m_s = corners(acceleration)
    expected = lagged(t, corner_s, corner_m_s, lag_s) if lag_s else np.interp(t, corner_s, corner_m_s)
    np.testing.assert_allclose(v, expected, atol=3e-4)


def test_the_order_counts_a_lag_before_the_ramp_would_be_elsewhere() -> None:
    """The tracker's lag is before its law: its ramp is a ramp still, and the servo's is round."""
    t = np.arange(0.0, END_S, 1 / 120)
    served = effects(3.0, lag={"time": 0.06})
    tracked = {name: values for name, values in served.items() if name != "rail.servo"}
    there, here = (ride(Model(cart=IDEAL, effects=each), t) for each in (served, tracked))
    assert np.abs(there - here).max() > 0.03


@pytest.mark.parametrize("force_n", [0.8, pytest.param(1.4, marks=pytest.mark.prove)])
@pytest.mark.parametrize(("lag_s", "dry_n", "push_n"), [(0.0, 0.0, 0.0), (0.03, 0.0, -0.3), (0.0, 0.4, 0.2)])
def test_a_motor_at_its_limit_lets_the_ramp_run_on(force_n: float, lag_s: float, dry_n: float, push_n: float) -> None:
    """Against a solver of ordinary differential equations: m v' = clip(loop and feed-forward) - friction + push.

    Dry friction gives by a hair before it slips, as in `numerics.grip`.
    """
    cart = Cart(travel_m=100.0)
    t = np.arange(0.0, END_S, 1 / 240)
    others = {"force_limit": {"force": force_n}, "lag": {"time": lag_s}, "coulomb_friction": {"force": dry_n}}
    v = ride(Model(cart=cart, effects=effects(6.0, **others)), t, push_n)
    corner_s, corner_m_s = corners(6.0)

    def slope(now: float, state: np.ndarray) -> list[float]:
        speed, s, z = state
        ramp = float(np.interp(now, corner_s, corner_m_s))
        piece = min(max(int(np.searchsorted(corner_s, now, "right")) - 1, 0), len(corner_s) - 2)
        rise = (corner_m_s[piece + 1] - corner_m_s[piece]) / (corner_s[piece + 1] - corner_s[piece])
        behind, change = (s, (ramp - s) / lag_s) if lag_s else (ramp, rise)
        drive = cart.velocity_gain_n_s_m * (behind - speed) + cart.feedforward_mass_kg * change
        pushed = float(np.clip(drive, -force_n, force_n)) - dry_n * float(np.clip(z / REACH_M, -1, 1)) + push_n
        return [pushed / cart.mass_kg, change if lag_s else 0.0, 0.0 if abs(z) > REACH_M and z * speed > 0 else speed]

    solved = solve_ivp(slope, (0.0, END_S), [0.0] * 3, t_eval=t, max_step=3e-3, rtol=1e-6, atol=1e-9)
    assert np.abs(v - np.interp(t, corner_s, corner_m_s)).max() > 0.3  # the ramp did run on
    np.testing.assert_allclose(v, solved.y[0], atol=6e-3)
    assert np.sqrt(np.mean((v - solved.y[0]) ** 2)) < 1e-3


def test_without_a_ramp_a_command_is_followed_at_once_and_a_lag_alone_is_first_order() -> None:
    t = np.arange(0.0, 0.3, 1 / 240)
    prompt, late = (
        ride(Model(cart=IDEAL, effects={"rail.servo": {}, "rail.lag": {"time": lag_s}}), t) for lag_s in (0.0, 0.05)
    )
    np.testing.assert_allclose(prompt[1:], 0.8, atol=1e-3)
    np.testing.assert_allclose(late, -0.8 * np.expm1(-t / 0.05), atol=5e-4)


def test_small_lags_and_wide_limits_change_little_so_that_a_descent_sees_no_step() -> None:
    """Gaps to neither, by lag: they grow in proportion; a motor that is never at its limit is one without."""
    t = np.arange(0.0, END_S, 1 / 120)
    lags = np.array([1e-4, 1e-3, 5e-3])
    plain = ride(Model(effects=effects(6.0)), t, rate_hz=480.0)
    gaps = [
        np.sqrt(np.mean((ride(Model(effects=effects(6.0, lag={"time": x})), t, rate_hz=480.0) - plain) ** 2))
        for x in lags
    ]
    np.testing.assert_allclose(gaps / lags, gaps[0] / lags[0], rtol=0.25)
    wide = ride(Model(effects=effects(6.0, force_limit={"force": 100.0})), t, rate_hz=480.0)
    np.testing.assert_array_equal(wide, plain)


@pytest.mark.parametrize("effect", [{"rail.servo": {}}, {"rail.force_limit": {"force": 1.0}}])
def test_a_robot_without_an_effect_of_the_drive_is_as_alone_bit_for_bit(effect: dict[str, dict[str, float]]) -> None:
    velocity, pressure = commands.bang_bang(1, seed=7)
    seed, changed = Model(), Model(effects=seed_effects() | effect)
    alone, beside = Simulator(seed, 1), Simulator([changed, seed, changed])
    for v, p in zip(velocity[:60, 0], pressure[:60, 0], strict=True):
        alone.step(v, p)
        beside.step(v, p)
    np.testing.assert_array_equal(beside.link_angles_rad[1], alone.link_angles_rad[0])
    np.testing.assert_array_equal(beside.cart_position_m[1], alone.cart_position_m[0])
    assert abs(beside.cart_position_m[0] - beside.cart_position_m[1]) > 1e-3


@pytest.mark.parametrize(
    ("rail", "others"),
    [
        (Rail(), {}),
        (Rail(lag_s=0.05), {"rail.lag": {"time": 0.05}}),
        (Rail(force_limit_n=1.4), {"rail.force_limit": {"force": 1.4}}),
        (Rail(coulomb_n=3.0), {"rail.coulomb_friction": {"force": 3.0, "viscous": 0.0}}),
        (Rail(acceleration_m_s2=2.5), {"rail.acceleration_limit": {"acceleration": 2.5}}),
    ],
)
def test_the_servo_equals_the_independent_robots_drive(rail: Rail, others: dict[str, dict[str, float]]) -> None:
    """Through turn after turn, by the velocity that counts; the tracker with the same effects is elsewhere."""
    robot = Robot(RobotParameters(rail=rail), hanging=True)
    tracked = seed_effects() | others
    served = tracked | {"rail.servo": {}}
    ours, tracker = (Simulator(Model(effects=each), 1, 480.0) for each in (served, tracked))
    for simulator in (ours, tracker):
        simulator.reset(joint_angles_rad=np.diff(robot.truth.link_angles_rad, prepend=0.0))
    apart = []
    for tick in range(60):
        velocity = (0.4, -0.4, 0.25, -0.5, 0.3)[tick // 6 % 5]
        robot.command(tick * PERIOD_S, velocity, 0.0)
        robot.advance((tick + 1) * PERIOD_S)
        there = robot.truth.cart_velocity_m_s
        for simulator in (ours, tracker):
            simulator.step(velocity, 0.0)
        apart.append([simulator.cart_velocity_m_s[0] - there for simulator in (ours, tracker)])
    near, far = np.sqrt(np.mean(np.square(apart), axis=0))
    assert near < 0.004
    assert far > 2 * near
