"""The mechanics of the robot in MuJoCo: a cart, a chain of links, and the forces on them.

MuJoCo integrates (`implicitfast`: velocities implicit, then positions) and computes end stops, dry friction (as a
constraint, not a smooth curve), springs, dampers and air. This module computes all other torques and forces.

The arm model is refined: each of its n links is cut into m pieces. Mass, inertia, static bending and relaxation of the
whole arm stay the same. A joint of the model represents the bending of the beam around it. A triangular weight, as wide
as one link on each side, spreads this bending over the joints of the finer chain, so its amount and its centre stay the
same. Only the first joint, at the clamp, stays whole.

Springs in series add their compliances: with the weights w, 1/k_j = sum_i w_ij / K_i. Muscle gain, torque offset and
relaxation time D/K of a fine joint are means over the model's joints, weighted with w_ij / K_i. With these weights, the
angles under a pressure and their rates add up to the model's. A piece has 1/m of the mass and the length of its link.
Its inertia is chosen so that the inertia of the whole link stays the same.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from softarm.reality.parameters import RobotParameters
from softarm.schemas.model import Arm

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Chain:
    """Properties of the fine links, arrays [m n]; joint j carries link j."""

    length_m: Array
    mass_kg: Array
    inertia_kg_m2: Array  # about the link's centre
    stiffness_nm_rad: Array
    damping_nm_s_rad: Array
    muscle_gain_nm_kpa: Array
    torque_offset_nm: Array
    share: Array  # angle of a fine joint as a share of the model's angle at that place, for non-linear laws


def refine(arm: Arm, pieces: int) -> Chain:
    """Cut every link of an arm into equal pieces.

    Raises:
        ValueError: A joint has no stiffness, or the links have too little inertia for so many pieces.
    """
    stiffness = np.array(arm.stiffness_nm_rad)
    if not (stiffness > 0).all():
        raise ValueError(f"stiffness_nm_rad is {arm.stiffness_nm_rad}; a beam needs every entry above 0")
    compliance = _shares(arm.links, pieces) / stiffness  # [m n, n]
    total = compliance.sum(axis=1)

    def mean(values: tuple[float, ...] | Array) -> Array:
        return np.asarray(compliance @ np.asarray(values) / total)

    k = 1 / total
    length, mass = np.array(arm.link_length_m), np.array(arm.link_mass_kg)
    # Steiner's terms of the pieces about the whole link's centre.
    spread = mass * length**2 * (pieces**2 - 1) / (12 * pieces**2)
    inertia = np.array(arm.link_inertia_kg_m2) - spread
    if not (inertia > 0).all():
        raise ValueError(
            f"link_inertia_kg_m2 is {arm.link_inertia_kg_m2}; {pieces} pieces need more than {spread.tolist()}"
        )
    return Chain(
        length_m=np.repeat(length / pieces, pieces),
        mass_kg=np.repeat(mass / pieces, pieces),
        inertia_kg_m2=np.repeat(inertia / pieces, pieces),
        stiffness_nm_rad=k,
        damping_nm_s_rad=k * mean(np.array(arm.damping_nm_s_rad) / stiffness),
        muscle_gain_nm_kpa=mean(arm.muscle_gain_nm_kpa),
        torque_offset_nm=mean(arm.torque_offset_nm),
        share=total / mean(1 / stiffness),
    )


def _shares(links: int, pieces: int) -> Array:
    """Return the share of each model joint's compliance at each fine joint, [m n, n]; columns add up to 1."""
    fine = np.arange(links * pieces)[:, None]
    distance = np.abs(fine - pieces * np.arange(links))
    shares: Array = np.clip(pieces - distance, 0, None) / pieces**2
    shares[:, 0] = fine[:, 0] == 0
    return shares


# 68 steps per control period, 17 per camera period.
RATE_HZ = 2040.0
# Mass of a clamped cart.
CLAMPED_KG = 1e6
REST_S, REST_DAMPING = 6.0, 10.0
# Radius of the beam ([P]), for the air and a shelf.
RADIUS_M = 0.0381
# The two boards of a shelf ([C]), without friction.
BOARD_DEPTH_M, BOARD_THICKNESS_M, BOARDS_APART_M = 0.4, 0.01, 0.2


class Plant:
    """Mechanical state of the robot, with one integration step; `held` clamps the cart at its start position."""

    def __init__(
        self,
        parameters: RobotParameters,
        cart_position_m: float,
        held: bool,
        motor_kg: float,
        shelf_m: tuple[float, float] | None = None,
    ) -> None:
        """Build the robot at a cart position, straight and at rest.

        Args:
            motor_kg: Part of the cart's mass that the rail models itself.
            shelf_m: y of a shelf's front edge and z of the top of its lower board.
        """
        arm = parameters.arm
        self.chain = refine(parameters.body, arm.pieces)
        self.model = mujoco.MjModel.from_xml_string(_mjcf(parameters, self.chain, motor_kg, shelf_m))
        self.data = mujoco.MjData(self.model)
        self._parameters, self._motor_kg, self._shelf_m = parameters, motor_kg, shelf_m
        self._arm, self._base_m = arm, parameters.body.base_height_m
        self._muscle = self.chain.muscle_gain_nm_kpa * (1 + arm.muscle_gain)
        self._offset = self.chain.torque_offset_nm * (1 + arm.torque_offset)
        self._stiffness = self.model.jnt_stiffness[1:].copy()
        self._cubic = arm.stiffening_1_rad2 * self._stiffness / self.chain.share**2
        self._crept = np.zeros(len(self._stiffness))
        self._plays = [0.0, 0.0, 0.0]
        self.model.dof_frictionloss[1:] = arm.friction_nm
        if held:
            self.model.dof_armature[0] = CLAMPED_KG
        self.dt_s = float(self.model.opt.timestep)
        self.data.qpos[0] = cart_position_m

    @property
    def cart_position_m(self) -> float:
        """Return the cart's position along the rail."""
        return float(self.data.qpos[0])

    @property
    def cart_velocity_m_s(self) -> float:
        """Return the cart's velocity along the rail."""
        return float(self.data.qvel[0])

    def step(self, force_n: float, friction_n: float, pressure_kpa: float) -> None:
        """Integrate one step with a force on the cart, its dry friction, and the pressure in the muscle."""
        data = self.data
        data.qfrc_applied[0] = force_n
        data.qfrc_applied[1:] = self._torques(pressure_kpa)
        self.model.dof_frictionloss[0] = friction_n
        mujoco.mj_step(self.model, data)

    def hang(self) -> None:
        """Place the arm in its rest position without pressure; the robot's time does not advance."""
        # Without a shelf the position of the cart does not change the angles.
        cart_m = 0.0 if self._shelf_m is None else self.cart_position_m
        self.data.qpos[1:] = _rest_angles_rad(self._parameters, self._motor_kg, cart_m, self._shelf_m)

    def links(self) -> tuple[Array, Array]:
        """Return the far ends (y, z) of the model's links, m [5, 2], and their chords' absolute angles, rad [5]."""
        angles = np.cumsum(self.data.qpos[1:])
        step = self.chain.length_m * np.array((np.sin(angles), -np.cos(angles)))
        hinge = np.array((self.cart_position_m, self._base_m))
        ends = hinge + np.cumsum(step, axis=1).T[self._arm.pieces - 1 :: self._arm.pieces]
        chords = np.diff(ends, axis=0, prepend=hinge[None])
        # A chord's angle is known up to whole turns: take the turn of its pieces.
        near = angles.reshape(len(ends), -1).mean(axis=1)
        turned = np.arctan2(chords[:, 0], -chords[:, 1]) - near
        return ends, near + np.remainder(turned + math.pi, 2 * math.pi) - math.pi

    def end_velocity_m_s(self, link: int) -> tuple[float, float]:
        """Return the velocity (y, z) of the far end of one of the model's links (1 to 5)."""
        last = link * self._arm.pieces
        angles = np.cumsum(self.data.qpos[1 : last + 1])
        rates = np.cumsum(self.data.qvel[1 : last + 1]) * self.chain.length_m[:last]
        vy, vz = self.cart_velocity_m_s + np.cos(angles) @ rates, np.sin(angles) @ rates
        return float(vy), float(vz)

    def _torques(self, pressure_kpa: float) -> Array:
        arm, angles = self._arm, self.data.qpos[1:]
        effective = self._effective_pressure(pressure_kpa)
        if arm.fatigue:
            effective *= 1 - arm.fatigue * (1 - math.exp(-self.data.time / arm.fatigue_s))
        torques = -effective * self._muscle - self._offset
        if arm.stiffening_1_rad2:
            torques -= self._cubic * angles**3
        if arm.softening:
            warm = 1 - math.exp(-self.data.time / arm.softening_s)
            self.model.jnt_stiffness[1:] = self._stiffness * (1 - arm.softening * warm)
        if arm.creep:
            elastic = angles - self._crept
            self._crept = self._crept + (arm.creep * elastic - self._crept) * (self.dt_s / arm.creep_s)
            torques += self._stiffness * self._crept
        return torques

    def _effective_pressure(self, pressure_kpa: float) -> float:
        """Return the pressure after hysteresis (three Prandtl play operators) and saturation."""
        arm = self._arm
        if arm.hysteresis:
            for i, play in enumerate(self._plays):
                half = arm.hysteresis_kpa * (i + 1) / 6
                self._plays[i] = min(max(play, pressure_kpa - half), pressure_kpa + half)
            pressure_kpa += arm.hysteresis * (sum(self._plays) / 3 - pressure_kpa)
        if math.isfinite(arm.saturation_kpa):
            pressure_kpa /= (1 + abs(pressure_kpa / arm.saturation_kpa) ** 3) ** (1 / 3)
        return pressure_kpa


@lru_cache(maxsize=8)
def _rest_angles_rad(
    parameters: RobotParameters, motor_kg: float, cart_m: float, shelf_m: tuple[float, float] | None
) -> Array:
    """Return the angles of the joints of an arm that hangs at rest on a clamped cart."""
    plant = Plant(parameters, cart_m, True, motor_kg, shelf_m)
    # About critical damping for the slow swing.
    plant.model.dof_damping[1:] *= REST_DAMPING
    plant.data.qfrc_applied[1:] = -plant._offset
    mujoco.mj_step(plant.model, plant.data, round(REST_S * RATE_HZ))
    angles: Array = plant.data.qpos[1:].copy()
    return angles


def _mjcf(parameters: RobotParameters, chain: Chain, motor_kg: float, shelf_m: tuple[float, float] | None) -> str:
    """Return the robot as MJCF; its x is our y. Links collide with a shelf only, not with each other.

    MuJoCo derives the air's drag from a body's inertia; the cart has a negligible one and so no drag.
    """
    arm, cart, gravity = parameters.arm, parameters.cart, parameters.body.gravity_m_s2
    lean, down = gravity * math.sin(arm.tilt_rad), -gravity * math.cos(arm.tilt_rad)
    contact = "enable" if shelf_m else "disable"
    body = f'<body name="payload" pos="0 0 {-chain.length_m[-1]}">{_point(arm.payload_kg)}</body>'
    places = (parameters.body.base_height_m, *(-chain.length_m[:-1]))
    for i in reversed(range(len(places))):
        length, inertia = chain.length_m[i], chain.inertia_kg_m2[i]
        body = (
            f'<body pos="0 0 {places[i]}">'
            f'<joint type="hinge" axis="0 -1 0" stiffness="{chain.stiffness_nm_rad[i] * (1 + arm.stiffness)}" '
            f'damping="{chain.damping_nm_s_rad[i] * (1 + arm.damping)}" solreffriction="0.002 1"/>'
            f'<inertial pos="0 0 {-length / 2}" mass="{chain.mass_kg[i]}" diaginertia="{inertia} {inertia} {inertia}"/>'
            f'<geom type="ellipsoid" size="{RADIUS_M} {RADIUS_M} {length / 2}" pos="0 0 {-length / 2}" '
            f'fluidshape="ellipsoid" contype="0" conaffinity="0"/>'
            f"{_capsule(length, i == len(places) - 1) if shelf_m else ''}{body}</body>"
        )
    return (
        f'<mujoco><compiler inertiafromgeom="false"/><option timestep="{1 / RATE_HZ}" gravity="{lean} 0 {down}" '
        f'integrator="implicitfast" density="{arm.air_kg_m3}"><flag contact="{contact}" autoreset="disable"/></option>'
        f"<worldbody>{_boards(*shelf_m) if shelf_m else ''}"
        f'<body><joint type="slide" axis="1 0 0" limited="true" range="{-cart.travel_m} {cart.travel_m}" '
        'solreflimit="0.004 1" solreffriction="0.002 1"/>'
        f'<inertial pos="0 0 0" mass="{cart.mass_kg - motor_kg}" diaginertia="1e-6 1e-6 1e-6"/>'
        f"{body}</body></worldbody></mujoco>"
    )


def _capsule(length_m: float, last: bool) -> str:
    """Return the collision capsule of a link; its round end lies within the last link."""
    end = max(length_m - RADIUS_M, 1e-3) if last else length_m
    return (
        f'<geom type="capsule" size="{RADIUS_M}" fromto="0 0 0 0 0 {-end}" contype="1" conaffinity="0" condim="1" '
        'mass="0" fluidshape="none"/>'
    )


def _boards(edge_m: float, board_m: float) -> str:
    """Return the two boards of a shelf, open towards +x."""
    x, thick = edge_m - BOARD_DEPTH_M / 2, BOARD_THICKNESS_M / 2
    heights = (board_m - thick, board_m + BOARDS_APART_M + thick)
    return "".join(
        f'<geom type="box" size="{BOARD_DEPTH_M / 2} 0.2 {thick}" pos="{x} 0 {z}" contype="0" conaffinity="1" '
        'condim="1" solref="0.004 1"/>'
        for z in heights
    )


def _point(mass_kg: float) -> str:
    """Return a point mass, or nothing for zero: a body welded to its parent needs no mass."""
    return f'<inertial pos="0 0 0" mass="{mass_kg}" diaginertia="1e-9 1e-9 1e-9"/>' if mass_kg else ""
