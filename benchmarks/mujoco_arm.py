"""The robot in MuJoCo as an independent oracle, built from the same `Model`, with the same commands."""

import math

import mujoco
import numpy as np

from softarm.schemas.model import Model
from softarm.simulator.effects import value
from softarm.simulator.mjcf import export

IMPLICIT = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
# Effects that the caller applies to the commands or as forces.
APPLIED = ("pressure.lag", "rail.delay", "rail.acceleration_limit", "arm.stiffening", "arm.drag")


def compiled(model: Model, rate_hz: float, integrator: mujoco.mjtIntegrator = IMPLICIT) -> mujoco.MjModel:
    """Return the arm of `softarm model export` without pressure lag and looks.

    Its actuators are controlled by cart velocity (m/s) and pressure (kPa). Of the model's effects it includes payload,
    tilt and dry friction of the joints.
    """
    effects = {name: given for name, given in model.effects.items() if name not in APPLIED}
    spec = mujoco.MjSpec.from_string(export(model.model_copy(update={"effects": effects})).xml)
    for look in (*spec.geoms, *spec.lights, *spec.sensors):
        spec.delete(look)
    physics = spec.compile()
    physics.opt.timestep = 1 / rate_hz
    physics.opt.integrator = integrator
    # Stiffer than the default, which lets a resting joint creep.
    physics.dof_solref[:], physics.dof_solimp[:, :3] = (0.0005, 1.0), (0.99, 0.999, 0.001)
    physics.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    if not physics.dof_frictionloss.any():
        physics.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    return physics


def fly(
    model: Model,
    cart_velocity_m_s: np.ndarray,
    pressure_kpa: np.ndarray,
    period_s: float,
    steps_per_command: int,
) -> np.ndarray:
    """Simulate one robot from rest and return the tip (y, z) after each command, [T, 2].

    The actuators are written out in the simplest form: the drive decides at the start of a step, the lag is an
    exponential. Small steps make that nearly exact.

    Args:
        model: Model of the robot.
        cart_velocity_m_s: Commands, [T].
        pressure_kpa: Commands, [T].
        period_s: Duration of each command.
        steps_per_command: Simulation steps per command.
    """
    arm, cart = model.arm, model.cart
    physics = compiled(model, steps_per_command / period_s)
    physics.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    physics.qpos_spring[:] = 0.0
    data = mujoco.MjData(physics)
    tip, dt = physics.site("tip").id, physics.opt.timestep
    gain, offset = np.array(arm.muscle_gain_nm_kpa), np.array(arm.torque_offset_nm)
    inflate, deflate = (value(model, "pressure.lag", each) for each in ("inflate", "deflate"))
    cubic, drag = value(model, "arm.stiffening", "cubic"), value(model, "arm.drag", "coefficient")
    stiffness, moved = np.array(arm.stiffness_nm_rad), np.zeros(6)
    acceleration = value(model, "rail.acceleration_limit", "acceleration")
    delay_steps = round(value(model, "rail.delay", "delay") / dt)
    pressure, tips = 0.0, []
    for step in range(len(pressure_kpa) * steps_per_command):
        wanted = pressure_kpa[step // steps_per_command]
        issued = step - delay_steps
        rail = cart_velocity_m_s[issued // steps_per_command] if issued >= 0 else 0.0
        before, time = pressure, inflate if wanted > pressure else deflate
        pressure = wanted + (before - wanted) * (math.exp(-dt / time) if time else 0.0)
        mean = (before + pressure) / 2 if time else wanted
        error = rail - data.qvel[0]
        if math.isfinite(acceleration) and abs(error) > cart.tracking_switch_m_s:
            # Feedback of the cart's acceleration acts like additional cart mass.
            physics.dof_armature[0], physics.dof_damping[0] = cart.acceleration_gain_kg, 0.0
            pushed = cart.feedforward_mass_kg + cart.acceleration_gain_kg
            data.qfrc_applied[0] = pushed * math.copysign(acceleration, error)
        else:
            physics.dof_armature[0], physics.dof_damping[0] = 0.0, cart.velocity_gain_n_s_m
            data.qfrc_applied[0] = cart.velocity_gain_n_s_m * rail
        data.qfrc_applied[1:] = -(gain * mean + offset + stiffness * cubic * data.qpos[1:] ** 3)
        for body in range(2, 2 + arm.links if drag else 2):  # the links follow world and cart
            mujoco.mj_objectVelocity(physics, data, mujoco.mjtObj.mjOBJ_BODY, body, moved, 0)
            data.xfrc_applied[body, :3] = -drag * np.linalg.norm(moved[3:]) * moved[3:]
        mujoco.mj_step(physics, data)
        if (step + 1) % steps_per_command == 0:
            mujoco.mj_kinematics(physics, data)
            tips.append((data.site_xpos[tip][0], data.site_xpos[tip][2]))
    return np.array(tips)
