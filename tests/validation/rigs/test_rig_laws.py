"""Each machine against a closed-form solution."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

from validation.rigs.cart import SPRING_ZETA, Controller, cart
from validation.rigs.follower import ATMOSPHERE_KPA, INNER_SHARE, LONGER_SHARE, axis, chamber
from validation.rigs.laws import Bristles, orifice
from validation.rigs.links import Links, swing

ONE = np.zeros(1)


@pytest.mark.slow
def test_bristles_slip_at_their_level_and_hold_weaker_forces():
    rub = Bristles(np.array([2.0]), np.array([3.0]), 1.0, 1e-4, 1e-4)
    for _ in range(1500):
        up = rub.force(np.array([0.1]))
    for _ in range(1500):
        down = rub.force(np.array([-0.1]))
    assert up[0] == pytest.approx(2.0, rel=1e-6)
    assert down[0] == pytest.approx(-3.0, rel=1e-6)
    x, v = 0.0, 0.0
    rub = Bristles(np.array([2.0]), np.array([2.0]), 1.0, 1e-4, 3e-4)
    for i in range(10000):  # pushed with 1.9 at last against 2
        v += 3e-4 * (1.9 * min(i / 9000, 1) - rub.force(np.array([v]))[0])
        x += 3e-4 * v
    assert x == pytest.approx(1e-4 * math.log(20), rel=0.1)  # how far bristles creep that bear 95 % of their level
    assert abs(v) < 1e-6


def test_the_flow_through_an_orifice_is_choked():
    assert orifice(np.array([500.0]), np.array([100.0]))[0] == pytest.approx(500 * 0.6847, rel=1e-3)
    assert orifice(np.array([500.0]), np.array([50.0]))[0] == orifice(np.array([500.0]), np.array([200.0]))[0]
    assert orifice(np.array([500.0]), np.array([500.0]))[0] == 0.0
    assert 0 < orifice(np.array([500.0]), np.array([450.0]))[0] < 300


@pytest.mark.parametrize("velocity", [True, False])
def test_an_axis_answers_a_step_as_two_lags(velocity):
    tau, dt = 0.1, 2e-4
    steps = 2500
    command = np.ones((steps, 1))
    command[0] = 0.0
    out = axis(command, [{"lag_s": tau}], ONE, dt, velocity)[:, 0]
    t = dt * np.arange(1, steps + 1)
    inner = tau * INNER_SHARE
    root = np.roots([tau * inner, tau, 1.0])  # of the closed loop, both modes alike
    want = 1 + (root[1] * np.exp(root[0] * t) - root[0] * np.exp(root[1] * t)) / (root[0] - root[1])
    assert np.max(np.abs(out - want)) < 4e-3
    assert -1 / root.max() == pytest.approx(LONGER_SHARE * tau)


@pytest.mark.slow
def test_an_axis_with_weak_torque_speeds_up_on_a_ramp_and_friction_leaves_an_error():
    dt, steps = 4e-4, 3000
    command = np.full((steps, 2), 1.0)
    command[0] = 0.0
    out = axis(command[:501], [{"lag_s": 0.02, "acceleration": 2.0}, {"lag_s": 0.02}], np.zeros(2), dt, True)
    assert np.diff(out[125:500, 0]).mean() / dt == pytest.approx(2.0, rel=0.02)
    hold = 0.05  # what friction holds of a position error, as a level: error / (outer inner)
    held_back = {"lag_s": 0.1, "friction_up": hold / (0.01 * INNER_SHARE), "friction_down": 1.0}
    out = axis(command, [held_back, {}], np.zeros(2), dt, False)
    assert 1 - out[-1, 0] == pytest.approx(hold, rel=0.03)
    assert out[-1, 1] == pytest.approx(1.0, abs=1e-4)


@pytest.mark.slow
def test_a_chamber_fills_and_vents_with_its_lags_and_no_faster_than_its_orifice():
    dt, slow = 4e-4, {"lag_s": 0.3, "lag_down_s": 0.6, "supply_kpa": 80.0}
    command = np.tile((30.0, 30.0, 10.0), (1501, 1))
    command[0] = 10.0, 10.0, 30.0
    lanes = [slow, {"lag_s": 0.02, "orifice_1_s": 0.2, "supply_kpa": 300.0}, slow]
    out = chamber(command, lanes, np.zeros(3), dt)
    at = round(0.3 / dt)
    assert (out[at, 0] - 10) / 20 == pytest.approx(1 - math.exp(-1), abs=0.03)  # less the spool's
    choked = 0.2 * orifice(np.array([300 + ATMOSPHERE_KPA]), np.array([ATMOSPHERE_KPA]))[0]
    assert np.diff(out[50:400, 1]).mean() / dt == pytest.approx(choked / 1.0, rel=0.01) or out[400, 1] > 29
    assert (out[round(0.6 / dt), 2] - 10) / 20 == pytest.approx(math.exp(-1), abs=0.03)


def test_a_cart_reaches_its_terminal_speed():
    controller = Controller(1.0, 1e-6, 1e9, 1e-9)
    dt, steps = 4e-3, 1500
    lanes = [
        {"mass_kg": 2.0, "slope_rad": 0.1, "viscous_n_s_m": 4.0},
        {"mass_kg": 2.0, "slope_rad": 0.1, "drag_n_s2_m2": 4.0},
        {"mass_kg": 2.0, "slope_rad": 0.1, "viscous_n_s_m": 4.0, "friction_up_n": 1.0, "friction_down_n": 1.0},
    ]
    out, _ = cart(np.zeros((steps, 3)), lanes, np.zeros(3), dt, 10, controller)
    weight = 2 * 9.81 * math.sin(0.1)
    speed = (out[-1] - out[-251]) / 1.0
    assert speed == pytest.approx([weight / 4, math.sqrt(weight / 4), (weight - 1) / 4], rel=1e-3)


def test_a_cart_follows_its_path_and_its_variants_are_reset():
    controller = Controller(2.0, 20.0, 1e3, 1e-6)
    dt, steps = 1e-3, 4000
    path = -0.1 * np.cos(2 * np.pi * 0.5 * dt * np.arange(steps))[:, None]
    out, asked = cart(path, [{"mass_kg": 2.0}, {"mass_kg": 1.0}], np.zeros(2), dt, 2, controller, window_s=1.0)
    assert np.max(np.abs(out[1000:, 0] - path[1000:, 0])) < 3e-3
    assert np.max(np.abs(asked[500:-1])) == pytest.approx(2.0 * 0.1 * (2 * np.pi * 0.5) ** 2, rel=0.15)
    apart = np.abs(out[:, 1] - out[:, 0])
    assert apart[1001] < 0.05 * apart[999] < apart[999]


def test_a_cart_feels_its_force_after_the_exact_delay_and_lag():
    controller = Controller(2.0, 20.0, 1e3, 1e-6)
    dt, each, steps, fine = 1e-3, 2, 2000, 50
    path = -0.1 * np.cos(2 * np.pi * dt * np.arange(steps))[:, None] * np.ones(2)
    delay_s, lag_s = 0.0137, 0.02  # no multiple of the step
    lanes = [{"mass_kg": 2.0, "delay_s": delay_s}, {"mass_kg": 2.0, "lag_s": lag_s}]
    out, asked = cart(path, lanes, np.zeros(2), dt, each, controller)
    t = dt / fine * (np.arange(steps * fine) + 0.5)  # middles of small steps
    sample = np.floor((t - delay_s) / (each * dt)).astype(int)
    late = np.where(t < delay_s, 0.0, asked[np.maximum(sample, 0), 0])
    kept = math.exp(-dt / fine / lag_s)
    lagging = lfilter([1 - kept], [1.0, -kept], asked[(t / (each * dt)).astype(int), 1])
    for lane, force in enumerate((late, lagging)):
        speed = np.cumsum(force) * dt / fine / 2.0
        want = path[0, 0] + np.concatenate(([0.0], np.cumsum(speed) * dt / fine))[: steps * fine : fine]
        assert np.max(np.abs(out[:, lane] - want)) < 2e-4, lane


def test_a_load_on_a_spring_swings_at_its_frequency():
    controller = Controller(1.0, 1e-6, 1e9, 1e-9)
    lanes = [{"mass_kg": 1.0, "spring_rad_s": 30.0, "force_n": 1.0}]
    out, _ = cart(np.zeros((2500, 1)), lanes, ONE, 2e-4, 5, controller)
    t = 2e-4 * np.arange(2500)
    # Two free bodies, by the reduced mass.
    w, decay = 30.0 / math.sqrt(1 - 0.35), SPRING_ZETA * 30.0 / (1 - 0.35)
    turn = math.sqrt(w * w - decay * decay)
    stretch = 1 - np.exp(-decay * t) * (np.cos(turn * t) + decay / turn * np.sin(turn * t))
    want = t * t / 2 + 0.35 / 0.65 / w**2 * stretch
    assert np.max(np.abs(out[:, 0] - want)) < 2e-4


@pytest.mark.slow
def test_a_small_pendulum_decays_as_the_closed_forms_say():
    link = {"mass_kg": 1.0, "centre_m": 0.5, "inertia_kg_m2": 0.05}
    inertia, moment = 0.05 + 0.25, 9.81 * 0.5
    w = math.sqrt(moment / inertia)
    dt, steps = 3e-3, 2000
    lanes = [link | {"viscous_nm_s": 0.06}, link | {"friction_nm": 0.01}, link]
    out = swing(np.full((3, 1), 0.05), lanes, np.zeros(3), dt, steps, 3)[:, :, 0]
    t = dt * np.arange(steps)
    rate = 0.06 / (2 * inertia)
    turn = math.sqrt(w * w - rate * rate)
    want = 0.05 * np.exp(-rate * t) * (np.cos(turn * t) + rate / turn * np.sin(turn * t))
    assert np.max(np.abs(out[:, 0] - want)) < 3e-4
    peaks = [out[round(k * 2 * math.pi / w / dt), 1] for k in range(4)]
    assert np.diff(peaks) == pytest.approx([-4 * 0.01 / moment] * 3, rel=0.05)
    assert np.max(out[-600:, 2]) == pytest.approx(0.05, rel=1e-3)


def energy_j(lane, q, v):
    """Return the energy of a chain, link by link."""
    total, joint_m, joint_m_s = 0.0, np.zeros(2), np.zeros(2)
    for i in range(len(q)):
        down, turning = np.array((np.sin(q[i]), -np.cos(q[i]))), v[i] * np.array((np.cos(q[i]), np.sin(q[i])))
        centre_m, centre_m_s = joint_m + lane["centre_m"][i] * down, joint_m_s + lane["centre_m"][i] * turning
        total += lane["mass_kg"][i] * (9.81 * centre_m[1] + centre_m_s @ centre_m_s / 2)
        total += lane["inertia_kg_m2"][i] * v[i] ** 2 / 2
        joint_m, joint_m_s = joint_m + lane["length_m"][i] * down, joint_m_s + lane["length_m"][i] * turning
    return total + lane["payload_kg"] * (9.81 * joint_m[1] + joint_m_s @ joint_m_s / 2)


def test_three_links_keep_their_energy_and_agree_with_an_integrator_of_high_order():
    lane = {"mass_kg": (1.0, 0.7, 0.4), "centre_m": (0.2, 0.15, 0.1), "inertia_kg_m2": (0.01, 0.006, 0.002)}
    lane |= {"length_m": (0.4, 0.3, 0.2), "payload_kg": 0.1, "payload_m": 0.2}
    chain = Links([lane], ONE, 1e-3, 3)
    chain.state[0] = (0.9, 0.3, -0.4)
    before = energy_j(lane, *chain.state[:, 0])

    def flow(t, y):
        return np.concatenate((y[3:], chain.accelerations(y[None, :3], y[None, 3:], np.zeros((1, 3)), ONE)[0]))

    exact = solve_ivp(flow, (0, 0.5), (0.9, 0.3, -0.4, 0, 0, 0), rtol=1e-10, atol=1e-12).y[:3, -1]
    for i in range(500):
        chain.step(i * 1e-3, np.zeros((1, 3)), (ONE, ONE, ONE))
    assert energy_j(lane, *chain.state[:, 0]) == pytest.approx(before, rel=1e-6)
    assert chain.state[0, 0] == pytest.approx(exact, abs=1e-5)


@pytest.mark.slow
def test_a_base_that_speeds_up_tilts_a_pendulum_and_a_hanging_arm_stays_where_its_torque_says():
    lanes = [{"viscous_nm_s": 2.0}]
    base = np.full((2 * 1000 + 1, 1), 1.0)
    out = swing(np.zeros((1, 1)), lanes, ONE, 6e-3, 1000, 1, base=base)
    assert out[-1, 0, 0] == pytest.approx(-math.atan2(1.0, 9.81), abs=1e-3)
    loaded = swing(np.zeros((1, 1)), lanes, ONE, 6e-3, 1000, 1, torques=lambda i, q, v: np.full((1, 1), 1.0))
    assert loaded[-1, 0, 0] == pytest.approx(math.asin(1.0 / (9.81 * 0.5)), abs=1e-3)
