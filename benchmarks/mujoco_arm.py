"""The same robot in MuJoCo, an independent oracle: built from the same `Model`, given the same commands."""

import math

import mujoco
import numpy as np

from schemas.model import Model


def mjcf(model: Model, rate_hz: float, integrator: str = "implicitfast", actuators: bool = False) -> str:
    """The arm as MJCF: x is the model's y; joint angles are positive towards +y.

    With `actuators`, the cart's velocity tracker and the muscle are MuJoCo's own, controlled by cart velocity
    (m/s) and pressure (kPa); the torque offset moves the springs' rest. Without, the caller applies all forces.
    """
    arm, cart = model.arm, model.cart
    opening, closing, height = "", "", arm.base_height_m
    for i in range(arm.links):
        inertia, half = arm.link_inertia_kg_m2[i], arm.link_length_m[i] / 2
        opening += (
            f'<body pos="0 0 {height!r}"><joint name="joint{i}" type="hinge" axis="0 -1 0" '
            f'stiffness="{arm.stiffness_nm_rad[i]!r}" damping="{arm.damping_nm_s_rad[i]!r}" '
            f'springref="{-arm.torque_offset_nm[i] / arm.stiffness_nm_rad[i] if actuators else 0.0!r}"/>'
            f'<inertial pos="0 0 {-half!r}" mass="{arm.link_mass_kg[i]!r}" '
            f'diaginertia="{inertia!r} {inertia!r} {inertia!r}"/>'
        )
        closing += "</body>"
        height = -2 * half
    muscle = "".join(f'<joint joint="joint{i}" coef="{-gain!r}"/>' for i, gain in enumerate(arm.muscle_gain_nm_kpa))
    drives = (
        f'<tendon><fixed name="muscle">{muscle}</fixed></tendon><actuator>'
        f'<velocity joint="cart" kv="{cart.velocity_gain_n_s_m!r}"/><motor tendon="muscle"/></actuator>'
    )
    return (
        f'<mujoco><compiler angle="radian" inertiafromgeom="false"/>'
        f'<option timestep="{1 / rate_hz!r}" gravity="0 0 {-arm.gravity_m_s2!r}" integrator="{integrator}">'
        '<flag contact="disable" constraint="disable"/></option><worldbody><body>'
        '<joint name="cart" type="slide" axis="1 0 0"/>'
        f'<inertial pos="0 0 0" mass="{cart.mass_kg!r}" diaginertia="1 1 1"/>'
        f'{opening}<site name="tip" pos="0 0 {height!r}"/>{closing}</body></worldbody>'
        f"{drives if actuators else ''}</mujoco>"
    )


def fly(
    model: Model,
    cart_velocity_m_s: np.ndarray,
    pressure_kpa: np.ndarray,
    period_s: float,
    steps_per_command: int,
) -> np.ndarray:
    """Fly one robot from rest, commands [T] held for period_s each. Returns the tip (y, z) after each, [T, 2].

    The actuators are written out once more, in the plainest way: the drive decides at the start of a step, the
    lag is the textbook exponential. Small steps make that as good as exact.
    """
    arm, cart, effects = model.arm, model.cart, model.effects
    physics = mujoco.MjModel.from_xml_string(mjcf(model, steps_per_command / period_s))
    data = mujoco.MjData(physics)
    tip, dt = physics.site("tip").id, physics.opt.timestep
    gain, offset = np.array(arm.muscle_gain_nm_kpa), np.array(arm.torque_offset_nm)
    lag, limit = effects.pressure_lag, effects.rail_acceleration_limit
    delay_steps = round(effects.rail_delay.delay / dt) if effects.rail_delay else 0
    pressure, tips = 0.0, []
    for step in range(len(pressure_kpa) * steps_per_command):
        wanted = pressure_kpa[step // steps_per_command]
        issued = step - delay_steps
        rail = cart_velocity_m_s[issued // steps_per_command] if issued >= 0 else 0.0
        if lag is None:
            mean = pressure = wanted
        else:
            before = pressure
            pressure = wanted + (before - wanted) * math.exp(-dt / (lag.inflate if wanted > before else lag.deflate))
            mean = (before + pressure) / 2
        error = rail - data.qvel[0]
        if limit is not None and abs(error) > cart.tracking_switch_m_s:
            # Feedback on the cart's own acceleration is as if the cart were heavier by the gain.
            physics.dof_armature[0], physics.dof_damping[0] = cart.acceleration_gain_kg, 0.0
            pushed = cart.feedforward_mass_kg + cart.acceleration_gain_kg
            data.qfrc_applied[0] = pushed * math.copysign(limit.acceleration, error)
        else:
            physics.dof_armature[0], physics.dof_damping[0] = 0.0, cart.velocity_gain_n_s_m
            data.qfrc_applied[0] = cart.velocity_gain_n_s_m * rail
        data.qfrc_applied[1:] = -(gain * mean + offset)
        mujoco.mj_step(physics, data)
        if (step + 1) % steps_per_command == 0:
            mujoco.mj_kinematics(physics, data)
            tips.append((data.site_xpos[tip][0], data.site_xpos[tip][2]))
    return np.array(tips)
