"""The mechanics in MuJoCo: a cart, a chain of links, and what acts on them at every step.

MuJoCo integrates (`implicitfast`: velocities implicit, positions after them) and does the end stops, dry friction
(a constraint, not a smooth curve), springs, dampers and air. Everything else is a torque or force written here.
"""

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from softarm.reality.chain import Chain, refine
from softarm.reality.parameters import RobotParameters

Array = NDArray[np.float64]

RATE_HZ = 2040.0  # 68 steps in a control period, 17 in a camera's
CLAMPED_KG = 1e6  # the cart of a robot that is held
REST_S, REST_DAMPING = 6.0, 10.0
RADIUS_M = 0.0381  # of the beam ([P]), for air and shelf
# Of the shelf's two boards, m ([C]); nothing rubs on them.
BOARD_DEPTH_M, BOARD_THICKNESS_M, BOARDS_APART_M = 0.4, 0.01, 0.2


class Plant:
    """State and one step. `held` clamps the cart where it stands."""

    def __init__(
        self,
        parameters: RobotParameters,
        cart_position_m: float,
        held: bool,
        motor_kg: float,
        shelf_m: tuple[float, float] | None = None,
    ) -> None:
        """Put it there, straight and at rest. `motor_kg` is the part of the cart's mass that the rail models itself.

        shelf_m: y of a shelf's front edge and z of its lower board's top.
        """
        arm = parameters.arm
        self.chain = refine(parameters.body, arm.pieces)
        self.model = mujoco.MjModel.from_xml_string(_mjcf(parameters, self.chain, motor_kg, shelf_m))
        self.data = mujoco.MjData(self.model)
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
        """Along the rail."""
        return float(self.data.qpos[0])

    @property
    def cart_velocity_m_s(self) -> float:
        """Along the rail."""
        return float(self.data.qvel[0])

    def step(self, force_n: float, friction_n: float, pressure_kpa: float) -> None:
        """One step under a force on the cart, dry friction on it, and the muscle's pressure."""
        data = self.data
        data.qfrc_applied[0] = force_n
        data.qfrc_applied[1:] = self._torques(pressure_kpa)
        self.model.dof_frictionloss[0] = friction_n
        mujoco.mj_step(self.model, data)

    def hang(self) -> None:
        """Let the arm come to rest where it is with no pressure, on a clamped cart; takes no time."""
        model, data = self.model, self.data
        armature, damping, cart_m = float(model.dof_armature[0]), model.dof_damping.copy(), self.cart_position_m
        model.dof_armature[0] = CLAMPED_KG
        model.dof_damping[1:] *= REST_DAMPING  # about critical for the slow swing
        data.qfrc_applied[:] = (0.0, *-self._offset)
        mujoco.mj_step(model, data, round(REST_S * RATE_HZ))
        model.dof_armature[0], model.dof_damping[:] = armature, damping
        data.qpos[0], data.time = cart_m, 0.0
        data.qvel[:] = data.qacc_warmstart[:] = 0.0

    def links(self) -> tuple[Array, Array]:
        """The model's links: far ends (y, z) [5, 2] and the chords' absolute angles [5]."""
        angles = np.cumsum(self.data.qpos[1:])
        step = self.chain.length_m * np.array((np.sin(angles), -np.cos(angles)))
        hinge = np.array((self.cart_position_m, self._base_m))
        ends = hinge + np.cumsum(step, axis=1).T[self._arm.pieces - 1 :: self._arm.pieces]
        chords = np.diff(ends, axis=0, prepend=hinge[None])
        # The chord's direction, on the turn on which its pieces are.
        near = angles.reshape(len(ends), -1).mean(axis=1)
        turned = np.arctan2(chords[:, 0], -chords[:, 1]) - near
        return ends, near + np.remainder(turned + math.pi, 2 * math.pi) - math.pi

    def end_velocity_m_s(self, link: int) -> tuple[float, float]:
        """Of the far end of one of the model's links (1 to 5)."""
        last = link * self._arm.pieces
        angles = np.cumsum(self.data.qpos[1 : last + 1])
        rates = np.cumsum(self.data.qvel[1 : last + 1]) * self.chain.length_m[:last]
        vy, vz = self.cart_velocity_m_s + np.cos(angles) @ rates, np.sin(angles) @ rates
        return float(vy), float(vz)

    def _torques(self, pressure_kpa: float) -> Array:
        arm, angles = self._arm, self.data.qpos[1:]
        effective = self._bend(pressure_kpa)
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

    def _bend(self, pressure_kpa: float) -> float:
        """The pressure as the muscle's torque knows it: through three plays (Prandtl), then levelling off."""
        arm = self._arm
        if arm.hysteresis:
            for i, play in enumerate(self._plays):
                half = arm.hysteresis_kpa * (i + 1) / 6
                self._plays[i] = min(max(play, pressure_kpa - half), pressure_kpa + half)
            pressure_kpa += arm.hysteresis * (sum(self._plays) / 3 - pressure_kpa)
        if math.isfinite(arm.saturation_kpa):
            pressure_kpa /= (1 + abs(pressure_kpa / arm.saturation_kpa) ** 3) ** (1 / 3)
        return pressure_kpa


def _mjcf(
    parameters: RobotParameters, chain: Chain, motor_kg: float, shelf_m: tuple[float, float] | None = None
) -> str:
    """The robot as MJCF; its x is our y. Only a shelf makes contact: the links pass through each other.

    To MuJoCo's air a body is a box as large as its inertia: the cart has none.
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
            f"{_skin(length, i == len(places) - 1) if shelf_m else ''}{body}</body>"
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


def _skin(length_m: float, last: bool) -> str:
    """What of a link meets a shelf: a capsule around it, whose round end lies within the last link."""
    end = max(length_m - RADIUS_M, 1e-3) if last else length_m
    return (
        f'<geom type="capsule" size="{RADIUS_M}" fromto="0 0 0 0 0 {-end}" contype="1" conaffinity="0" condim="1" '
        'mass="0" fluidshape="none"/>'
    )


def _boards(edge_m: float, board_m: float) -> str:
    """A shelf's two boards, open towards +x."""
    x, thick = edge_m - BOARD_DEPTH_M / 2, BOARD_THICKNESS_M / 2
    heights = (board_m - thick, board_m + BOARDS_APART_M + thick)
    return "".join(
        f'<geom type="box" size="{BOARD_DEPTH_M / 2} 0.2 {thick}" pos="{x} 0 {z}" contype="0" conaffinity="1" '
        'condim="1" solref="0.004 1"/>'
        for z in heights
    )


def _point(mass_kg: float) -> str:
    """A point mass; MuJoCo takes a body welded to its parent without any, too."""
    return f'<inertial pos="0 0 0" mass="{mass_kg}" diaginertia="1e-9 1e-9 1e-9"/>' if mass_kg else ""


def energy_j(plant: Plant) -> float:
    """Kinetic and potential energy, springs included."""
    before = plant.model.opt.enableflags
    plant.model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    mujoco.mj_forward(plant.model, plant.data)
    plant.model.opt.enableflags = before
    return float(plant.data.energy.sum())
