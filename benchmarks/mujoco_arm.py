"""The robot in MuJoCo as an independent oracle, built from the same `Model`, with the same commands."""

import math

import mujoco
import numpy as np

from softarm.schemas.model import Model
from softarm.simulator.effects import value


def mjcf(model: Model, rate_hz: float, integrator: str = "implicitfast", actuators: bool = False) -> str:
    """Return the arm as MJCF: x is the model's y; joint angles are positive towards +y.

    With `actuators`, the cart's velocity tracker and the muscle are MuJoCo's own, controlled by cart velocity
    (m/s) and pressure (kPa), and the torque offset shifts the rest of the springs. Without, the caller applies
    all forces.
    Of the model's effects it includes payload, tilt and dry friction, which MJCF can express.
    """
    arm, cart = model.arm, model.cart
    friction, payload, tilt = (
        value(model, f"arm.{effect}", parameter)
        for effect, parameter in (("coulomb_friction", "torque"), ("payload", "mass"), ("tilt", "angle"))
    )
    down = (-arm.gravity_m_s2 * math.sin(tilt), -arm.gravity_m_s2 * math.cos(tilt))
    opening, closing, height = "", "", arm.base_height_m
    for i in range(arm.links):
        inertia, half = arm.link_inertia_kg_m2[i], arm.link_length_m[i] / 2
        opening += (
            f'<body pos="0 0 {height!r}"><joint name="joint{i}" type="hinge" axis="0 -1 0" '
            f'stiffness="{arm.stiffness_nm_rad[i]!r}" damping="{arm.damping_nm_s_rad[i]!r}" '
            # Stiffer than the default, which lets a resting joint creep.
            f'frictionloss="{friction!r}" solreffriction="0.0005 1" solimpfriction="0.99 0.999 0.001" '
            f'springref="{-arm.torque_offset_nm[i] / arm.stiffness_nm_rad[i] if actuators else 0.0!r}"/>'
            f'<inertial pos="0 0 {-half!r}" mass="{arm.link_mass_kg[i]!r}" '
            f'diaginertia="{inertia!r} {inertia!r} {inertia!r}"/>'
        )
        closing += "</body>"
        height = -2 * half
    load = f'<body pos="0 0 {height!r}"><inertial pos="0 0 0" mass="{payload!r}" diaginertia="1e-9 1e-9 1e-9"/></body>'
    muscle = "".join(f'<joint joint="joint{i}" coef="{-gain!r}"/>' for i, gain in enumerate(arm.muscle_gain_nm_kpa))
    drives = (
        f'<tendon><fixed name="muscle">{muscle}</fixed></tendon><actuator>'
        f'<velocity joint="cart" kv="{cart.velocity_gain_n_s_m!r}"/><motor tendon="muscle"/></actuator>'
    )
    return (
        f'<mujoco><compiler angle="radian" inertiafromgeom="false"/>'
        f'<option timestep="{1 / rate_hz!r}" gravity="{down[0]!r} 0 {down[1]!r}" integrator="{integrator}">'
        f'<flag contact="disable" constraint="{"enable" if friction else "disable"}"/></option><worldbody><body>'
        '<joint name="cart" type="slide" axis="1 0 0"/>'
        f'<inertial pos="0 0 0" mass="{cart.mass_kg!r}" diaginertia="1 1 1"/>'
        f'{opening}<site name="tip" pos="0 0 {height!r}"/>{load if payload else ""}{closing}</body></worldbody>'
        f"{drives if actuators else ''}</mujoco>"
    )


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
    physics = mujoco.MjModel.from_xml_string(mjcf(model, steps_per_command / period_s))
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
