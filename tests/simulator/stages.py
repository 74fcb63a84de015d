"""Replay of commands with their stamps through one stage of the robot, and the energy of the whole.

A stage is driven by measurements of its inputs, so that a fault of the regulator does not appear in the arm.
Parameters are given by column: a Jacobian is a batch of robots under the same commands.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softarm.schemas.model import Arm, Model
from softarm.schemas.robot import PHYSICS_RATE_HZ, TRAINING_PHYSICS_RATE_HZ
from softarm.simulator.simulator import Array, Simulator
from softarm.simulator.stage_simulator import StageSimulator

Overrides = Mapping[str, ArrayLike]

# Without muscle and offset it hangs straight and at rest.
UNDRIVEN = Arm(muscle_gain_nm_kpa=(0.0,) * 5, torque_offset_nm=(0.0,) * 5)
# Events closer than this are one, s.
SAME_S = 1e-9


def pressure_alone(
    model: Model,
    times_s: NDArray[np.float64],
    command_kpa: NDArray[np.float64],
    stamps_s: NDArray[np.float64],
    *,
    robots: int = 1,
    overrides: Overrides | None = None,
) -> Array:
    """Replay pressure commands through the regulator and return the readings of its sensor, kPa [S, R].

    times_s and command_kpa: [T], ascending; each is held until the next. stamps_s: [S], evenly spaced from times_s[0]
    on, with at most one command from a stamp to the next.
    """
    simulator = StageSimulator(model, robots, overrides=overrides)
    newest, late_s, step_s = _issued(times_s, stamps_s)
    commands, late = (np.tile(each[:, None], robots) for each in (command_kpa[newest], late_s))
    bias_kpa = simulator.pressure_reading_kpa - simulator.pressure_kpa
    return simulator.fly_pressure(commands, late, step_s) + bias_kpa


def rail_alone(
    model: Model,
    times_s: NDArray[np.float64],
    command_m_s: NDArray[np.float64],
    stamps_s: NDArray[np.float64],
    *,
    arm_force_n: ArrayLike = 0.0,
    robots: int = 1,
    overrides: Overrides | None = None,
    physics_rate_hz: float = PHYSICS_RATE_HZ,
) -> Array:
    """Replay velocity commands through the rail and return the cart's velocity, m/s [S, R]; it starts at rest.

    Shapes as in `pressure_alone`. arm_force_n: force of the arm on the cart, scalar or [S]; 0 is a cart without an arm.
    """
    simulator = StageSimulator(model, robots, physics_rate_hz, overrides=overrides)
    newest, late_s, step_s = _issued(times_s, stamps_s)
    force = np.broadcast_to(arm_force_n, stamps_s.shape)
    inputs = (np.tile(each[:, None], robots) for each in (command_m_s[newest], force, late_s))
    return simulator.fly_cart(*inputs, step_s)


def arm_alone(
    model: Model,
    measured: Sequence[NDArray[np.float64]],
    step_s: float,
    *,
    robots: int = 1,
    overrides: Overrides | None = None,
    physics_rate_hz: float = TRAINING_PHYSICS_RATE_HZ,
) -> Array:
    """Move cart and pressure as measured and return y, then z of the links' ends at every stamp, m [T, 2 n, R].

    measured: position (m) and velocity (m/s) of the cart and pressure (kPa), each [T], every step_s. Between stamps the
    cart follows the cubic through positions and velocities, the pressure a straight line.
    """
    simulator = StageSimulator(model, robots, physics_rate_hz, overrides=overrides)
    inputs = [np.tile(each[:, None], robots) for each in measured]
    simulator.reset(cart_position_m=inputs[0][0], pressure_kpa=inputs[2][0])
    return simulator.fly_arm(*inputs, step_s)


def _issued(
    times_s: NDArray[np.float64], stamps_s: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64], float]:
    """Return the command of the step at each stamp, its delay from the stamp (s), and the length of a step (s)."""
    step_s = float(stamps_s[1] - stamps_s[0])
    newest = np.searchsorted(times_s, stamps_s + step_s - SAME_S) - 1
    return newest, np.maximum(times_s[newest] - stamps_s, 0.0), step_s


def tips_m(
    model: Model | None, velocity_m_s: Array, pressure_kpa: Array, rate_hz: float, dtype: type = np.float32
) -> Array:
    """Run commands [T, R], each held for a control period, and return where the tips are afterwards, [R, 2]."""
    simulator = Simulator(model, velocity_m_s.shape[1], rate_hz, dtype=dtype)
    for v, p in zip(velocity_m_s, pressure_kpa, strict=True):
        simulator.step(v, p)
    return simulator.tip_m()


def energies_j(simulator: Simulator, shelf: tuple[float, float] = (100.0, 0.0), stiffness: float = 0.0) -> np.ndarray:
    """Kinetic, gravity's, springs' and the shelf's energy of every robot, [R], without the kernel's formulas.

    The shelf's is that of a spring on the depth of the arm's bars in the boards, sampled along both.
    """
    arm, cart = simulator.model.arm, simulator.model.cart
    length, mass = np.array(arm.link_length_m), np.array(arm.link_mass_kg)
    angle, rate = simulator.link_angles_rad.astype(float), simulator.link_rates_rad_s.astype(float)
    start = np.stack((simulator.cart_position_m, np.full(simulator.robots, arm.base_height_m)), axis=1).astype(float)
    moving = np.stack((simulator.cart_velocity_m_s, np.zeros(simulator.robots)), axis=1).astype(float)
    energy = 0.5 * cart.mass_kg * moving[:, 0] ** 2
    joints = np.diff(angle, axis=1, prepend=0.0)
    energy += 0.5 * (np.array(arm.stiffness_nm_rad) * joints**2).sum(axis=1)
    edge, top = shelf[0] - 0.005, shelf[1] - 0.005
    for i in range(arm.links):
        along = length[i] * np.stack((np.sin(angle[:, i]), -np.cos(angle[:, i])), axis=1)
        turning = length[i] * rate[:, [i]] * np.stack((np.cos(angle[:, i]), np.sin(angle[:, i])), axis=1)
        velocity, centre = moving + turning / 2, start + along / 2
        energy += 0.5 * mass[i] * (velocity**2).sum(axis=1) + 0.5 * arm.link_inertia_kg_m2[i] * rate[:, i] ** 2
        energy += mass[i] * arm.gravity_m_s2 * centre[:, 1]
        span = 1.0 if i < arm.links - 1 else 1.0 - 0.0381 / length[i]
        for height in (top, top + 0.21):
            end = start + span * along
            aside = end[:, 0] - np.clip(end[:, 0], edge - 0.39, edge)
            depth = 0.0431 - np.hypot(aside, end[:, 1] - height)
            energy += 0.5 * stiffness * np.maximum(depth, 0.0) ** 2
            share = ((np.array([edge, height]) - start) * along).sum(axis=1) / (length[i] ** 2)
            beside = start + np.clip(share, 0.0, span)[:, None] * along
            depth = 0.0431 - np.hypot(beside[:, 0] - edge, beside[:, 1] - height)
            energy += np.where((share > 0) & (share < span), 0.5 * stiffness * np.maximum(depth, 0.0) ** 2, 0.0)
        start, moving = start + along, moving + turning
    return energy
