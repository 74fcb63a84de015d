"""A model as MJCF, for MuJoCo and its viewer: https://mujoco.readthedocs.io/en/stable/XMLreference.html.

MuJoCo's x is the model's y, its z the model's z; joint angles are positive towards +y. The muscle is one actuator
(control: pressure in kPa) on a tendon over all joints, the cart's drive a velocity servo (control: m/s).
"""

import math
from typing import NamedTuple

from softarm.schemas.model import Model
from softarm.schemas.robot import CART_VELOCITY_MAX_M_S, PHYSICS_RATE_HZ, PRESSURE_MAX_KPA, PRESSURE_MIN_KPA
from softarm.simulator import effects
from softarm.simulator.effects import REGISTRY

RADIUS_M = 0.0381  # of the beam ([P] SM-E); looks alone, nothing collides

# Effects that the file holds at any value.
_EXPRESSED = {
    "pressure.gain",
    "pressure.ceiling",
    "rail.lag",
    "rail.gain",
    "rail.coulomb_friction",
    "rail.force_limit",
    "arm.stiffness",
    "arm.damping",
    "arm.muscle_gain",
    "arm.torque_offset",
    "arm.coulomb_friction",
    "arm.payload",
    "arm.tilt",
}


class Export(NamedTuple):
    """Text of an MJCF file, and a sentence for each part of the model that it does not hold."""

    xml: str
    left_out: tuple[str, ...]


def export(model: Model) -> Export:
    """Write a model as MJCF. Raises EffectError for invalid effects."""
    effects.validate(model.effects)
    left_out = tuple(_left_out(model))
    lines = [
        '<mujoco model="softarm">',
        *(f"  <!-- Left out: {sentence.replace('--', '- -')} -->" for sentence in left_out),
        '  <compiler angle="radian" inertiafromgeom="false"/>',
        f'  <option timestep="{1 / PHYSICS_RATE_HZ!r}" integrator="implicitfast" gravity="{_gravity(model)}"/>',
        '  <default><geom contype="0" conaffinity="0"/></default>',
        "  <worldbody>",
        '    <light pos="0 -2 3" dir="0 0.5 -1"/>',
        '    <geom name="floor" type="plane" size="2 1 0.1" rgba="0.8 0.8 0.8 1"/>',
        *(f"    {line}" for line in _bodies(model)),
        "  </worldbody>",
        *(f"  {line}" for line in _actuators(model)),
        '  <sensor><framepos name="tip" objtype="site" objname="tip"/><jointpos name="cart" joint="cart"/></sensor>',
        "</mujoco>",
    ]
    return Export("\n".join(lines) + "\n", left_out)


def _gravity(model: Model) -> str:
    g, tilt = model.arm.gravity_m_s2, effects.value(model, "arm.tilt", "angle")
    return f"{-g * math.sin(tilt) + 0.0!r} 0 {-g * math.cos(tilt)!r}"


def _bodies(model: Model) -> list[str]:
    """Return the elements of rail, cart and links, each within the one before."""
    arm, cart = model.arm, model.cart
    dry, viscous = (effects.value(model, "rail.coulomb_friction", name) for name in ("force", "viscous"))
    lines = [
        f'<geom type="box" size="{cart.travel_m + 0.1!r} 0.02 0.01" pos="0 0 {arm.base_height_m + 0.05!r}"/>',
        f'<body name="cart" pos="0 0 {arm.base_height_m!r}">',
        f'  <joint name="cart" type="slide" axis="1 0 0" range="{-cart.travel_m!r} {cart.travel_m!r}" limited="true"'
        f' damping="{viscous!r}" frictionloss="{dry!r}"/>',
        f'  <inertial pos="0 0 0" mass="{cart.mass_kg!r}" diaginertia="1e-3 1e-3 1e-3"/>',
        '  <geom type="box" size="0.05 0.04 0.02" pos="0 0 0.02" rgba="0.2 0.2 0.25 1"/>',
    ]
    stiffer, damped, offset, friction = (
        1.0 + effects.value(model, "arm.stiffness", "scale"),
        1.0 + effects.value(model, "arm.damping", "scale"),
        1.0 + effects.value(model, "arm.torque_offset", "scale"),
        effects.value(model, "arm.coulomb_friction", "torque"),
    )
    for i in range(arm.links):
        stiffness, length = stiffer * arm.stiffness_nm_rad[i], arm.link_length_m[i]
        inertia = arm.link_inertia_kg_m2[i]
        rest = -offset * arm.torque_offset_nm[i] / stiffness if stiffness else 0.0
        above = 0.0 if i == 0 else -arm.link_length_m[i - 1]
        lines += [
            f'<body name="link{i + 1}" pos="0 0 {above!r}">',
            f'  <joint name="joint{i + 1}" type="hinge" axis="0 -1 0" stiffness="{stiffness!r}" springref="{rest!r}"'
            f' damping="{damped * arm.damping_nm_s_rad[i]!r}" frictionloss="{friction!r}"/>',
            f'  <inertial pos="0 0 {-length / 2!r}" mass="{arm.link_mass_kg[i]!r}"'
            f' diaginertia="{inertia!r} {inertia!r} {inertia!r}"/>',
            f'  <geom type="cylinder" size="{RADIUS_M}" fromto="0 0 0 0 0 {-length!r}" rgba="0.9 0.5 0.2 0.8"/>',
        ]
    tip = -arm.link_length_m[-1]
    lines.append(f'<site name="tip" pos="0 0 {tip!r}" size="0.015" rgba="1 0 0 1"/>')
    if payload := effects.value(model, "arm.payload", "mass"):
        lines.append(
            f'<body name="payload" pos="0 0 {tip!r}">'
            f'<inertial pos="0 0 0" mass="{payload!r}" diaginertia="1e-9 1e-9 1e-9"/></body>'
        )
    return [*lines, "</body>" * (arm.links + 1)]


def _actuators(model: Model) -> list[str]:
    """Return the elements of drive and muscle."""
    arm, cart = model.arm, model.cart
    gain = 1.0 + effects.value(model, "arm.muscle_gain", "scale")
    coefficients = "".join(
        f'<joint joint="joint{i + 1}" coef="{-gain * b!r}"/>' for i, b in enumerate(arm.muscle_gain_nm_kpa)
    )
    most = effects.value(model, "rail.force_limit", "force")
    limit = f' forcelimited="true" forcerange="{-most!r} {most!r}"' if math.isfinite(most) else ""
    kv, feed = cart.velocity_gain_n_s_m, 1.0 + effects.value(model, "rail.gain", "scale")
    reached, zero = (
        1.0 + effects.value(model, "pressure.gain", "scale"),
        effects.value(model, "pressure.gain", "offset"),
    )
    lowest, highest = PRESSURE_MIN_KPA, (effects.value(model, "pressure.ceiling", "limit") - zero) / reached
    highest = min(max(highest, lowest + 1e-3), PRESSURE_MAX_KPA)
    return [
        f'<tendon><fixed name="muscle">{coefficients}</fixed></tendon>',
        "<actuator>",
        f'  <general name="cart_velocity" joint="cart" {_filter(effects.value(model, "rail.lag", "time"))}'
        f' gainprm="{kv * feed!r}" biastype="affine" biasprm="0 0 {-kv!r}"'
        f' ctrllimited="true" ctrlrange="{-CART_VELOCITY_MAX_M_S} {CART_VELOCITY_MAX_M_S}"{limit}/>',
        f'  <general name="pressure" tendon="muscle" {_filter(_mean_lag(model))}'
        f' gainprm="{reached!r}" biastype="affine" biasprm="{zero!r} 0 0"'
        f' ctrllimited="true" ctrlrange="{lowest!r} {highest!r}"/>',
        "</actuator>",
    ]


def _filter(time_s: float) -> str:
    return f'dyntype="filterexact" dynprm="{time_s!r}"' if time_s else 'dyntype="none"'


def _mean_lag(model: Model) -> float:
    return sum(effects.value(model, "pressure.lag", name) for name in ("inflate", "deflate")) / 2


def _left_out(model: Model) -> list[str]:
    """Return a sentence for each part of a model that the file does not hold."""
    found = []
    for name in model.effects:
        if name == "pressure.lag":
            inflate, deflate = (effects.value(model, name, each) for each in ("inflate", "deflate"))
            if inflate != deflate:
                mean = _mean_lag(model)
                both = f"{inflate:.4g} s up and {deflate:.4g} s down"
                found.append(f"{name}: one time constant, {mean:.4g} s, in place of {both}")
        elif name == "rail.acceleration_limit":
            found.append(f"{name}: the drive is the velocity tracker alone, at any error")
        elif name not in _EXPRESSED:
            found.append(f"{name}: {REGISTRY[name].meaning}")
    for i, (stiffness, offset) in enumerate(zip(model.arm.stiffness_nm_rad, model.arm.torque_offset_nm, strict=True)):
        if offset and not stiffness:
            found.append(f"arm.torque_offset_nm[{i}]: it is the rest angle of a spring, and this joint has none")
    return found
