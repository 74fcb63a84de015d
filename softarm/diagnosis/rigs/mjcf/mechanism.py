"""Mechanism of a MuJoCo model: its joints, their actuators, and the rigid-body terms along a measured motion."""

import copy
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softarm.common import files
from softarm.common.words import did_you_mean
from softarm.diagnosis.data.trials import TrialError
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.laws import joint as law

INSTALL = "needs MuJoCo; install it with: pip install 'softarm[mujoco]'"
# Steps of the numerical derivatives of the load, rad or m, and 1/s of these.
NUDGE, NUDGE_SPEED = 0.05, 0.1
# Distance of a link's centre of mass from its joint below which the link is balanced.
LINK_SHORTEST_M = 1e-3


@dataclass(frozen=True, slots=True)
class Actuator:
    """Affine actuator of one joint: joint torque = scale command + offset - kp position - kd speed, clipped.

    Units are those of the joint's torque (N m or N) and position (rad or m).
    """

    name: str
    scale: float = 1.0
    offset: float = 0.0
    kp: float = 0.0
    kd: float = 0.0
    low: float = -np.inf  # without a limit
    high: float = np.inf
    command_low: float = -np.inf
    command_high: float = np.inf
    lag_s: float = 0.0
    delay_s: float = 0.0
    gear: float = 1.0  # joint torque per torque of the actuator, and actuator's length per position


@dataclass(frozen=True, slots=True)
class Joint:
    """Joint with its nominal passive terms, in rad and N m (a hinge) or m and N (a slide)."""

    name: str
    turns: bool  # hinge
    position: int  # index in qpos
    dof: int  # index in qvel
    viscous: float
    dry: float
    spring: float
    rest: float
    armature: float
    range: tuple[float, float]  # -inf, inf without a limit
    actuator: Actuator | None
    bodies: tuple[str, ...]  # that the joint moves

    @property
    def end(self) -> str:
        """Return the body at the end of the mechanism."""
        return self.bodies[-1]


@dataclass(frozen=True, slots=True)
class Change:
    """Change of the rigid bodies behind a joint, or of the whole mechanism's base."""

    mass_share: float = 0.0  # of all masses and inertias behind the joint
    payload_kg: float = 0.0  # point mass on the line of the joint's last link
    payload_m: float = 0.0  # its distance from the start of that link
    length_share: float = 0.0  # of the link between the joint and the next one, with its mass as it is
    body: str = ""  # mass_share is that of this body alone
    tilts_rad: Mapping[str, float] = field(default_factory=dict)  # small rotations of the base about `level_axes`


@dataclass(frozen=True, slots=True)
class Link:
    """Rigid link at the end of a mechanism, in the frame of the body that its joint carries."""

    body: str
    start: Array  # [3] place of the joint, m
    direction: Array  # [3] unit vector towards the link's centre of mass
    centre_m: float  # distance of the centre of mass from the start; 0 for a balanced link

    def place(self, distance_m: float) -> Array:
        """Return the place at a distance from the start, [3]."""
        return self.start + distance_m * self.direction


class Mechanism:
    """Joints of a model, by name, and their rigid-body terms."""

    def __init__(self, path: Path) -> None:
        """Load an MJCF or URDF file.

        Raises:
            TrialError: MuJoCo is missing, the file is invalid, or the model has closed chains or muscles.
        """
        self.path, self._mujoco = path, _mujoco(path)
        self.model = _loaded(self._mujoco, path)
        self.step_s = float(self.model.opt.timestep)
        self._refuse_loops()
        self._refuse_actuators()
        self._bodies = copy.copy(self.model)  # without everything but rigid bodies, gravity, fluid and tendons
        flags, option = self._mujoco.mjtDisableBit, self._bodies.opt
        option.disableflags |= int(flags.mjDSBL_CONSTRAINT) | int(flags.mjDSBL_ACTUATION)
        self._bodies.jnt_actgravcomp[:] = 0  # else carried weight would be left out with the actuation
        kinds = (int(self._mujoco.mjtJoint.mjJNT_HINGE), int(self._mujoco.mjtJoint.mjJNT_SLIDE))
        single = (i for i in range(self.model.njnt) if self.model.jnt_type[i] in kinds)
        self.joints: Mapping[str, Joint] = {each.name: each for each in map(self._joint, single)}
        self.actuators = tuple(self._name("actuator", i) for i in range(self.model.nu))

    def joint(self, name: str) -> Joint:
        """Return a joint; raise TrialError with the known names if there is none."""
        if "." in name:
            raise TrialError(
                f"{self.path}: joint {name}: its name holds a dot, which separates the parts of an effect's name; "
                "rename the joint in the model and the column"
            )
        if name not in self.joints:
            near = did_you_mean(name, self.joints)
            raise TrialError(
                f"{self.path}: no hinge or slide joint {name}; {near}the model has {', '.join(self.joints)}; "
                "name the column after its joint"
            )
        return self.joints[name]

    def terms(self, joint: Joint, motion: Mapping[str, Sequence[Array]], change: Change = Change()) -> Array:
        """Return the rigid-body terms of a joint along a measured motion, [law.ROWS, T].

        Args:
            joint: the joint; its own acceleration is left out, since the law computes it.
            motion: joint name -> position, speed and acceleration [T each]; other joints stay at their zero.
            change: change of the bodies behind the joint.
        """
        mujoco, model = self._mujoco, self._changed(joint, change)
        data, dof, at = mujoco.MjData(model), joint.dof, joint.position
        size = len(motion[joint.name][0])
        qpos, qvel, qacc = np.tile(model.qpos0, (size, 1)), np.zeros((size, model.nv)), np.zeros((size, model.nv))
        for name, (position, speed, acceleration) in motion.items():
            other = self.joints[name]
            qpos[:, other.position], qvel[:, other.dof], qacc[:, other.dof] = position, speed, acceleration
        qacc[:, dof] = 0.0

        q, v, a, forces = data.qpos, data.qvel, data.qacc, data.qfrc_inverse

        def needed(known: int) -> float:
            mujoco.mj_inverseSkip(model, data, known, 1)
            return float(forces[dof])

        stage = mujoco.mjtStage
        unknown, same_position, same_speed = map(int, (stage.mjSTAGE_NONE, stage.mjSTAGE_POS, stage.mjSTAGE_VEL))
        found = np.empty((law.ROWS, size))
        for k in range(size):
            q[:], v[:], a[:] = qpos[k], qvel[k], qacc[k]
            load = needed(unknown)
            a[dof] = 1.0
            inertia = needed(same_speed) - load
            a[dof] = 0.0
            v[dof] += NUDGE_SPEED
            by_speed = (needed(same_position) - load) / NUDGE_SPEED
            v[dof] = qvel[k, dof]
            q[at] += NUDGE
            above = needed(unknown)
            q[at] -= 2 * NUDGE
            by_position = (above - needed(unknown)) / (2 * NUDGE)
            zero = load - by_position * qpos[k, at] - by_speed * qvel[k, dof]
            found[:, k] = inertia, zero, by_position, by_speed
        return found

    @property
    def level_axes(self) -> Mapping[str, Array]:
        """Horizontal axes of the model, x, y or z, with the change of gravity per rad of the base's rotation, [3]."""
        gravity = np.array(self.model.opt.gravity)
        upright = int(np.argmax(np.abs(gravity)))
        axes = {name: np.cross(gravity, np.eye(3)[i]) for i, name in enumerate("xyz") if i != upright}
        return axes if gravity.any() else {}

    def coupled(self, joint: Joint, names: Iterable[str]) -> frozenset[str]:
        """Return which of some other joints carry a joint or are carried by it."""
        return frozenset(n for n in names if n != joint.name and {*joint.bodies} & {*self.joint(n).bodies})

    def still(self, joint: Joint, measured: Collection[str]) -> list[str]:
        """Return the joints that carry a joint or are carried by it and count as still, free and ball joints included.

        Args:
            joint: the joint.
            measured: names of the joints with a column.
        """
        own, dofs = {*self._behind(joint.dof)}, map(int, self.model.jnt_dofadr)
        names = [self._name("joint", i) for i, dof in enumerate(dofs) if own & {*self._behind(dof)}]
        return [name for name in names if name != joint.name and name not in measured]

    def tied(self, joint: Joint) -> list[str]:
        """Return the joints that an active equality `joint` of the model ties to a joint."""
        m, own = self.model, int(self.model.dof_jntid[joint.dof])
        ties = (i for i in range(m.neq) if m.eq_type[i] == int(self._mujoco.mjtEq.mjEQ_JOINT) and m.eq_active0[i])
        pairs = [{int(m.eq_obj1id[i]), int(m.eq_obj2id[i])} for i in ties]
        return [self._name("joint", i) for pair in pairs if own in pair for i in sorted(pair - {own, -1})]

    def last_link(self, joint: Joint) -> Link:
        """Return the link at the end of the mechanism behind a joint."""
        model, data = self.model, self._mujoco.MjData(self.model)
        self._mujoco.mj_forward(model, data)
        root = int(model.body_weldid[self._body(joint.end)])
        parts = [i for i in range(model.nbody) if model.body_weldid[i] == root]
        mass = model.body_mass[parts]
        centre = mass @ data.xipos[parts] / max(float(mass.sum()), 1e-12)
        start = model.jnt_pos[model.body_jntadr[root] + model.body_jntnum[root] - 1]
        reach = data.xmat[root].reshape(3, 3).T @ (centre - data.xpos[root]) - start
        distance = float(np.linalg.norm(reach))
        if distance < LINK_SHORTEST_M:
            return Link(self._name("body", root), start + reach, np.zeros(3), 0.0)
        return Link(self._name("body", root), start.copy(), reach / distance, distance)

    def touching(self, motion: Mapping[str, Sequence[Array]]) -> NDArray[np.bool_]:
        """Return whether bodies touch at each sample of a measured motion, [T]."""
        mujoco, model = self._mujoco, self.model
        size = len(next(iter(motion.values()))[0])
        found = np.zeros(size, dtype=bool)
        if not (model.ngeom and (model.geom_contype | model.geom_conaffinity).any()):
            return found
        data = mujoco.MjData(model)
        for k in range(size):
            data.qpos[:] = model.qpos0
            for name, (position, *_) in motion.items():
                data.qpos[self.joints[name].position] = position[k]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_collision(model, data)
            found[k] = data.ncon > 0
        return found

    def _changed(self, joint: Joint, change: Change) -> Any:
        """Return the rigid bodies with a change, without the joint's own spring, damper and friction."""
        model = copy.copy(self._bodies)
        number = self.model.dof_jntid[joint.dof]
        model.dof_damping[joint.dof], model.dof_armature[joint.dof] = 0.0, joint.armature
        model.jnt_stiffness[number] = 0.0
        bodies = [self._body(change.body)] if change.body else self._behind(joint.dof)
        model.body_mass[bodies] *= 1 + change.mass_share
        model.body_inertia[bodies] *= 1 + change.mass_share
        if change.length_share:
            self._stretch(model, int(self.model.dof_bodyid[joint.dof]), 1 + change.length_share)
        if change.payload_kg:
            link = self.last_link(joint)
            self._load(model, self._body(link.body), change.payload_kg, link.place(change.payload_m))
        for axis, angle in change.tilts_rad.items():
            model.opt.gravity[:] += angle * self.level_axes[axis]
        self._mujoco.mj_setConst(model, self._mujoco.MjData(model))
        return model

    def carries(self, joint: Joint) -> bool:
        """Return whether another joint follows behind a hinge, so that the length of its link matters."""
        return joint.turns and len({int(self.model.body_weldid[self._body(name)]) for name in joint.bodies}) > 1

    def _stretch(self, model: Any, body: int, factor: float) -> None:
        """Move everything on the rigid link of a body, the next joints included, away from its joint."""
        start = model.jnt_pos[model.body_jntadr[body] + model.body_jntnum[body] - 1]
        for i in range(body, model.nbody):
            if model.body_weldid[model.body_parentid[i]] == body:
                model.body_pos[i] = start + factor * (model.body_pos[i] - start)
            if model.body_weldid[i] == body:
                origin = start if i == body else 0.0
                model.body_ipos[i] = origin + factor * (model.body_ipos[i] - origin)
                model.body_inertia[i] *= factor**2
                model.body_sameframe[i] = model.body_simple[i] = 0
        model.dof_simplenum[:] = 0

    def _load(self, model: Any, body: int, mass_kg: float, place: Array) -> None:
        """Add a point mass to a body of a model, at a place in the body's frame, [3]."""
        axes, own, centre = np.zeros(9), float(model.body_mass[body]), model.body_ipos[body].copy()
        self._mujoco.mju_quat2Mat(axes, model.body_iquat[body])
        frame = axes.reshape(3, 3)
        inertia = frame @ np.diag(model.body_inertia[body]) @ frame.T
        common = (own * centre + mass_kg * place) / (own + mass_kg)
        for mass, arm in ((own, centre - common), (mass_kg, place - common)):
            inertia += mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        principal, frame = np.linalg.eigh(inertia)
        frame[:, 0] *= np.sign(np.linalg.det(frame))
        model.body_mass[body], model.body_ipos[body], model.body_inertia[body] = own + mass_kg, common, principal
        self._mujoco.mju_mat2Quat(model.body_iquat[body], frame.ravel())
        # The body's inertia is no longer aligned with its frame.
        model.body_sameframe[body] = model.body_simple[body] = 0
        model.dof_simplenum[:] = 0

    def _behind(self, dof: int) -> list[int]:
        """Return the bodies that a joint moves."""
        found = [int(self.model.dof_bodyid[dof])]
        for body in range(found[0] + 1, self.model.nbody):
            if self.model.body_parentid[body] in found:
                found.append(body)
        return found

    def _body(self, name: str) -> int:
        return next(i for i in range(self.model.nbody) if self._name("body", i) == name)

    def _name(self, kind: str, number: int) -> str:
        return str(getattr(self.model, kind)(number).name) or f"{kind}{number}"

    def _refuse_loops(self) -> None:
        kinds = self._mujoco.mjtEq
        loops = (int(kinds.mjEQ_CONNECT), int(kinds.mjEQ_WELD))
        if any(kind in loops for kind in self.model.eq_type):
            raise TrialError(
                f"{self.path}: the model closes a loop (an equality `connect` or `weld`), which is not supported; "
                "allowed are open trees; describe one branch without the equality"
            )

    def _joint(self, number: int) -> Joint:
        m, dof = self.model, int(self.model.jnt_dofadr[number])
        low, high = m.jnt_range[number] if m.jnt_limited[number] else (-np.inf, np.inf)
        position = int(m.jnt_qposadr[number])
        return Joint(
            name=self._name("joint", number),
            turns=bool(m.jnt_type[number] == int(self._mujoco.mjtJoint.mjJNT_HINGE)),
            position=position,
            dof=dof,
            viscous=float(m.dof_damping[dof]),
            dry=float(m.dof_frictionloss[dof]),
            spring=float(m.jnt_stiffness[number]),
            rest=float(m.qpos_spring[position]),
            armature=float(m.dof_armature[dof]),
            range=(float(low), float(high)),
            actuator=self._actuator(number),
            bodies=tuple(self._name("body", i) for i in self._behind(dof)),
        )

    def _actuator(self, number: int) -> Actuator | None:
        """Return the actuator of a joint, or None; raise TrialError if there are several."""
        m, mujoco = self.model, self._mujoco
        own = [i for i in range(m.nu) if m.actuator_trnid[i, 0] == number]
        if not own:
            return None
        name, i = self._name("actuator", own[0]), own[0]
        if len(own) > 1:
            others = ", ".join(self._name("actuator", k) for k in own)
            raise TrialError(
                f"{self.path}: joint {self._name('joint', number)} has {len(own)} actuators ({others}); allowed is "
                "one; join them, or remove them from the model and give the joint's torque under `torque`"
            )
        gear = float(m.actuator_gear[i, 0])
        bias = m.actuator_biasprm[i] * (m.actuator_biastype[i] != int(mujoco.mjtBias.mjBIAS_NONE))
        low, high = -np.inf, np.inf
        if m.actuator_forcelimited[i]:
            low, high = sorted(gear * float(x) for x in m.actuator_forcerange[i])
        if m.jnt_actfrclimited[number]:
            low, high = max(low, float(m.jnt_actfrcrange[number, 0])), min(high, float(m.jnt_actfrcrange[number, 1]))
        ctrl = m.actuator_ctrlrange[i] if m.actuator_ctrllimited[i] else (-np.inf, np.inf)
        delay = getattr(m, "actuator_delay", None)
        return Actuator(
            name=name,
            scale=gear * float(m.actuator_gainprm[i, 0]),
            offset=gear * float(bias[0]),
            kp=-gear * gear * float(bias[1]),
            kd=-gear * gear * float(bias[2]),
            low=low,
            high=high,
            command_low=float(ctrl[0]),
            command_high=float(ctrl[1]),
            lag_s=float(m.actuator_dynprm[i, 0]) if m.actuator_dyntype[i] != int(mujoco.mjtDyn.mjDYN_NONE) else 0.0,
            delay_s=0.0 if delay is None else float(delay[i]),
            gear=gear,
        )

    def _refuse_actuators(self) -> None:
        """Raise TrialError for an actuator that is not affine in its command, or that acts on no single joint."""
        m, gain, bias, dyn = self.model, self._mujoco.mjtGain, self._mujoco.mjtBias, self._mujoco.mjtDyn
        at_joint = (int(self._mujoco.mjtTrn.mjTRN_JOINT), int(self._mujoco.mjtTrn.mjTRN_JOINTINPARENT))
        for i in range(m.nu):
            affine = m.actuator_gaintype[i] == int(gain.mjGAIN_FIXED)
            affine &= m.actuator_biastype[i] in map(int, (bias.mjBIAS_NONE, bias.mjBIAS_AFFINE))
            affine &= m.actuator_dyntype[i] in map(int, (dyn.mjDYN_NONE, dyn.mjDYN_FILTER, dyn.mjDYN_FILTEREXACT))
            if not affine or m.actuator_trntype[i] not in at_joint:
                raise TrialError(
                    f"{self.path}: actuator {self._name('actuator', i)} is neither a motor, position, velocity nor "
                    "general actuator of one joint with fixed gain and affine bias; write it as one of these, or "
                    "remove it from the model and give the torques of its joints under `torque`"
                )


def mechanism(path: Path) -> Mechanism:
    """Return the mechanism of a model file, loaded again only after a change of the file."""
    return _mechanism(path, path.stat().st_mtime_ns if files.is_file(path) else 0)


@lru_cache(maxsize=8)
def _mechanism(path: Path, changed_ns: int) -> Mechanism:
    return Mechanism(path)


def _mujoco(path: Path) -> Any:
    try:
        import mujoco
    except ImportError:
        raise TrialError(f"{path}: {INSTALL}") from None
    return mujoco


def _loaded(mujoco: Any, path: Path) -> Any:
    if not files.is_file(path):
        raise TrialError(f"{path}: does not exist; write the path of the MJCF or URDF file under `model: mjcf`")
    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        said = " ".join(str(error).split())
        raise TrialError(f"{path}: MuJoCo cannot read the model ({said}); correct the file") from None
