"""Where names and units end: a `Model` becomes one column of numbers for the kernel."""

import numpy as np
from numpy.typing import NDArray

from schemas.model import Model
from simulator import kernel

# The rail's end stops. Nothing is published of them: stiff enough that a cart at 1 m/s overruns by about 1 mm,
# damped so that it does not come back.
STOP_STIFFNESS_N_M = 2e5
STOP_DAMPING_N_S_M = 600.0
# Without rail.acceleration_limit the velocity tracker acts at any error.
NEVER_M_S = 1e30


def pack(model: Model) -> NDArray[np.float64]:
    """Return the kernel's parameters for one robot, in the order of `kernel.Rows`.

    Shape [parameter]; put it into the parameter rows of as many lanes as there are robots like it. An effect
    that is absent is packed as its neutral value: no lag, no delay, and in place of the acceleration tracker
    the velocity tracker alone, at any error (a drive that takes what acceleration it likes).
    """
    arm, cart, effects = model.arm, model.cart, model.effects
    n = arm.links
    at = kernel.rows.py_func(n)
    length, mass = np.array(arm.link_length_m), np.array(arm.link_mass_kg)
    beyond = np.cumsum(mass[::-1])[::-1] - mass  # what each link carries
    moment = length * (mass / 2 + beyond)
    coupling = np.outer(np.ones(n), length) * moment[:, None]  # l_j S_i, right where i > j
    np.fill_diagonal(coupling, np.array(arm.link_inertia_kg_m2) + length**2 * (mass / 4 + beyond))

    column = np.zeros(at.q)
    column[at.mass] = cart.mass_kg + mass.sum()
    column[at.velocity_gain] = cart.velocity_gain_n_s_m
    column[at.switch] = NEVER_M_S
    if limit := effects.rail_acceleration_limit:
        column[at.switch] = cart.tracking_switch_m_s
        column[at.drive_inertia] = cart.acceleration_gain_kg
        column[at.drive_force] = (cart.feedforward_mass_kg + cart.acceleration_gain_kg) * limit.acceleration
    column[at.travel] = cart.travel_m
    column[at.stop_stiffness], column[at.stop_damping] = STOP_STIFFNESS_N_M, STOP_DAMPING_N_S_M
    if delay := effects.rail_delay:
        column[at.rail_delay] = delay.delay
    if lag := effects.pressure_lag:
        column[at.inflate], column[at.deflate] = lag.inflate, lag.deflate
    column[at.base_height] = arm.base_height_m
    for row, values in (
        (at.length, length),
        (at.moment, moment),
        (at.weight, arm.gravity_m_s2 * moment),
        (at.stiffness, arm.stiffness_nm_rad),
        (at.damping, arm.damping_nm_s_rad),
        (at.muscle, arm.muscle_gain_nm_kpa),
        (at.offset, arm.torque_offset_nm),
    ):
        column[row : row + n] = values
    column[at.coupling : at.q] = coupling.ravel()
    return column
