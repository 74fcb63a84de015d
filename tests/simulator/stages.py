"""Replay of commands with their stamps through one stage of the robot, and the energy of the whole.

A stage is driven by measurements of its inputs, so that a fault of the regulator does not appear in the arm.
Parameters are given by column: a Jacobian is a batch of robots under the same commands.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softarm.schemas.model import Model
from softarm.schemas.robot import PHYSICS_RATE_HZ, TRAINING_PHYSICS_RATE_HZ
from softarm.simulator.simulator import Array, Simulator

Overrides = Mapping[str, ArrayLike]

# Events closer than this are one, s.
SAME_S = 1e-9


def pressure_alone(
    model: Model | Sequence[Model],
    times_s: ArrayLike,
    command_kpa: ArrayLike,
    sample_times_s: ArrayLike,
    *,
    robots: int | None = None,
    overrides: Overrides | None = None,
) -> Array:
    """Replay pressure commands through the regulator and return the readings of its sensor, kPa [S, R].

    times_s: [T], ascending, any spacing; commands [T], or [T, R] one a robot, each held until the next.
    sample_times_s: [S], ascending, from times_s[0] on. The rest as in `Simulator`.
    """
    simulator = Simulator(model, robots, overrides=overrides)
    command = _columns(command_kpa)
    looks = []
    for i, duration_s in _walk(times_s, sample_times_s):
        if duration_s > 0:
            simulator.step_pressure(command[i], duration_s)
        else:
            looks.append(simulator.pressure_reading_kpa)
    return np.stack(looks)


def rail_alone(
    model: Model | Sequence[Model],
    times_s: ArrayLike,
    command_m_s: ArrayLike,
    sample_times_s: ArrayLike,
    *,
    arm_force_n: ArrayLike = 0.0,
    robots: int | None = None,
    overrides: Overrides | None = None,
    physics_rate_hz: float = PHYSICS_RATE_HZ,
) -> tuple[Array, Array]:
    """Replay velocity commands through the rail; returns the cart's position (m) and velocity (m/s), [S, R].

    Shapes as in `pressure_alone`. arm_force_n: force of the arm on the cart, scalar, [T] or [T, R]; 0 is a cart
    without an arm. The cart starts at rest.
    """
    simulator = Simulator(model, robots, physics_rate_hz, overrides=overrides)
    command = _columns(command_m_s)
    force = np.broadcast_to(np.asarray(arm_force_n, dtype=np.float64), command.shape)
    looks = []
    for i, duration_s in _walk(times_s, sample_times_s):
        if duration_s > 0:
            simulator.step_cart(command[i], duration_s, force[i])
        else:
            looks.append((simulator.cart_position_m, simulator.cart_velocity_m_s))
    positions, velocities = zip(*looks, strict=True)
    return np.stack(positions), np.stack(velocities)


def arm_alone(
    model: Model | Sequence[Model],
    times_s: ArrayLike,
    cart_position_m: ArrayLike,
    cart_velocity_m_s: ArrayLike,
    pressure_kpa: ArrayLike,
    *,
    robots: int | None = None,
    overrides: Overrides | None = None,
    physics_rate_hz: float = TRAINING_PHYSICS_RATE_HZ,
) -> Array:
    """Move cart and pressure as measured and return the arm's absolute link angles at every stamp, [T, R, n].

    times_s: [T], ascending; measurements [T] or [T, R], smoothed: between stamps the cart follows the cubic through
    positions and velocities, the pressure a straight line.
    """
    simulator = Simulator(model, robots, physics_rate_hz, overrides=overrides)
    times = np.asarray(times_s, dtype=np.float64)
    position, velocity, pressure = map(_columns, (cart_position_m, cart_velocity_m_s, pressure_kpa))
    simulator.reset(cart_position_m=position[0], pressure_kpa=pressure[0])
    looks = [simulator.link_angles_rad]
    for i in range(1, len(times)):
        start = (position[i - 1], velocity[i - 1], pressure[i - 1])
        simulator.step_arm(position[i], velocity[i], pressure[i], times[i] - times[i - 1], start=start)
        looks.append(simulator.link_angles_rad)
    return np.stack(looks)


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


def _columns(values: ArrayLike) -> NDArray[np.float64]:
    """Return [T] or [T, R]; a single column serves all robots."""
    array = np.asarray(values, dtype=np.float64)
    return array[:, 0] if array.ndim == 2 and array.shape[1] == 1 else array


def _walk(times_s: ArrayLike, sample_times_s: ArrayLike) -> Iterator[tuple[int, float]]:
    """Yield what to do next: (command in force, how long to hold it), or (that command, 0.0) to look."""
    times = np.asarray(times_s, dtype=np.float64)
    samples = np.atleast_1d(np.asarray(sample_times_s, dtype=np.float64))
    now, command = times[0], 0
    for sample in samples:
        while now < sample - SAME_S:
            following = times[command + 1] if command + 1 < len(times) else np.inf
            until = min(following, sample)
            if until > now + SAME_S:
                yield command, until - now
            now = until
            if following <= sample + SAME_S and until == following:
                command += 1
        yield command, 0.0
