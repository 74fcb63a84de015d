"""Mechanism of a MuJoCo model: its joints, their actuators, and the rigid-body terms along a measured motion."""

import copy
import re
from collections.abc import Collection, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from softarm.common import files
from softarm.common.words import did_you_mean
from softarm.diagnosis.data.mjcf import load
from softarm.diagnosis.data.poses import Motion, pose_joints
from softarm.diagnosis.data.trials import TrialError
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.laws import joint as law
from softarm.diagnosis.rigs.mjcf.actuators import Actuator, Actuators
from softarm.diagnosis.rigs.mjcf.closure import Closure, State
from softarm.diagnosis.rigs.mjcf.contacts import Contacts
from softarm.diagnosis.rigs.mjcf.links import Link, Links
from softarm.diagnosis.rigs.mjcf.loads import Bodies
from softarm.diagnosis.rigs.mjcf.shapes import Shapes
from softarm.diagnosis.rigs.mjcf.stepping import stepping

# Steps of the numerical derivatives of the load, rad or m, and 1/s of these.
NUDGE, NUDGE_SPEED = 0.05, 0.1
_INCLUDED = re.compile(r"""<include\s+file\s*=\s*["'](.*?)["']""")


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
    parts: Mapping[str, tuple[str, ...]]  # first body of each part that moves as one -> its bodies
    problem: str = ""  # why the model's actuators cannot be used
    followers: tuple[str, ...] = ()  # joints that the model's equalities make follow
    followers_dry: float = 0.0  # their dry friction, felt at the joint
    softness: float = 0.0  # regulariser of MuJoCo's dry friction, 1 / inertia
    yields_per_s: float = 0.0  # rate at which that friction stops a joint

    @property
    def follows(self) -> bool:
        """Return whether a position loop drives the joint."""
        return self.actuator is not None and self.actuator.kp > 0

    @property
    def back_emf(self) -> bool:
        """Return whether the damping is its motor's: that of a position loop without a derivative part."""
        return self.actuator is not None and self.actuator.kp > 0 and self.actuator.kd == 0

    @property
    def friction(self) -> float:
        """Return the dry friction of the joint and its followers."""
        return self.dry + self.followers_dry


class Changes(NamedTuple):
    """Changes of a joint's rigid-body terms [law.ROWS, T] along a measured motion; they add up."""

    parts: Mapping[str, Array]  # per share of the mass of each part, by its first body
    point: Array  # [10, law.ROWS, T] per kg of a payload, for each of `powers` of its place in the last link's frame
    tilted: Mapping[str, Array]  # per rad of a small rotation of the base, by the axes of `level_axes`


class Course(NamedTuple):
    """Measured motion of a model, and the same with another position and speed of one joint."""

    own: tuple[Array, Array]  # position and speed of the joint, [T] each
    centre: State  # without the joint's own acceleration, as the others
    faster: State  # by NUDGE_SPEED
    above: State  # by NUDGE
    below: State

    @property
    def states(self) -> tuple[State, ...]:
        """Return the motion in five states, the second with an acceleration of the joint of 1."""
        accelerated = self.centre._replace(acceleration=self.centre.acceleration + self.centre.along)
        return self.centre, accelerated, self.faster, self.above, self.below

    def rows(self, forces: Array) -> Array:
        """Return rigid-body terms [law.ROWS, T] from the projected forces in the five states, [5, T]."""
        (position, speed), (load, more, moving, over, under) = self.own, forces
        by_position, by_speed = (over - under) / (2 * NUDGE), (moving - load) / NUDGE_SPEED
        found = np.empty((law.ROWS, len(position)))
        found[law.INERTIA], found[law.BY_POSITION], found[law.BY_SPEED] = more - load, by_position, by_speed
        found[law.LOAD] = load - by_position * position - by_speed * speed
        return found


class Inertial(NamedTuple):
    """Mass and inertia of a body; `at` and `quat` give the frame of its principal axes in the frame of the body."""

    mass_kg: float
    at: Array  # [3], m
    quat: Array  # [4]
    inertia: Array  # [3], kg m^2


class Mechanism:
    """Joints of a model, by name, and their rigid-body terms."""

    def __init__(self, path: Path, measured: Collection[str] = (), moved: Collection[str] = ()) -> None:
        """Load an MJCF or URDF file.

        Args:
            path: the file.
            measured: joints to diagnose; others depend on these where the model has equalities.
            moved: other joints with a column, likewise.

        Raises:
            TrialError: MuJoCo is missing, or the file is invalid.
        """
        self.path = path
        self._mujoco, self.model = load(path)
        self.step_s = float(self.model.opt.timestep)
        self.stepping = stepping(self._mujoco, self.model)
        self._links = Links(self._mujoco, self.model)
        self._contacts = Contacts(self._mujoco, self.model)
        self._closure = Closure(self._mujoco, self.model, self._order(measured, moved))
        self._ratios, self._follows = self._closure.ratios(self._closure.zero()), self._closure.follows
        self._moved_by = [{*self._moved(int(dof))} for dof in self._closure.independent]
        self._bodies = copy.copy(self.model)  # without everything but rigid bodies, gravity, fluid and tendons
        flags, option = self._mujoco.mjtDisableBit, self._bodies.opt
        option.disableflags |= int(flags.mjDSBL_CONSTRAINT) | int(flags.mjDSBL_ACTUATION)
        self._bodies.jnt_actgravcomp[:] = 0  # else carried weight would be left out with the actuation
        self.actuators = Actuators(self._mujoco, self.model, self._closure, self._name)
        kinds = (int(self._mujoco.mjtJoint.mjJNT_HINGE), int(self._mujoco.mjtJoint.mjJNT_SLIDE))
        single = [i for i in range(self.model.njnt) if self.model.jnt_type[i] in kinds]
        self.joints: Mapping[str, Joint] = {each.name: each for each in map(self._joint, single)}
        self.poses = tuple(pose_joints(self._mujoco, self.model).values())

    def mjcf(self) -> str:
        """Return the text of the MJCF file; else the MJCF that MuJoCo makes of it, if it is not one file of strict XML.

        A URDF becomes an MJCF. Files with an `include` become one.
        """
        try:
            root = ElementTree.parse(self.path).getroot()
        except ElementTree.ParseError:  # MuJoCo reads comments with "--"
            root = None
        if root is not None and root.tag == "mujoco" and root.find(".//include") is None:
            return self.path.read_text()
        spec = self._mujoco.MjSpec.from_file(str(self.path))
        spec.compile()
        return re.sub("<!--.*?-->", "", str(spec.to_xml()), flags=re.DOTALL)

    def inertial(self, name: str) -> Inertial | None:
        """Return mass and inertia of a body, or None if those of its geoms override its own."""
        body, overrides = self._body(name), self._mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
        spec, m = self._mujoco.MjSpec.from_file(str(self.path)), self.model
        if spec.compiler.inertiafromgeom == int(overrides) and m.body_geomnum[body]:
            return None
        return Inertial(float(m.body_mass[body]), m.body_ipos[body], m.body_iquat[body], m.body_inertia[body])

    def with_damping_ratio(self) -> list[Joint]:
        """Return the joints whose position loop has a damper that MuJoCo computes from the inertia (`dampratio`)."""
        spec = self._mujoco.MjSpec.from_file(str(self.path))
        names = {self._name("actuator", i) for i, each in enumerate(spec.actuators) if each.biasprm[2] > 0}
        return [each for each in self.joints.values() if each.actuator and each.actuator.name in names]

    def joint(self, name: str) -> Joint:
        """Return a joint; raise TrialError with the known names if there is none."""
        if "." in name:
            raise TrialError(
                f"{self.path}: joint {name}: its name holds a dot, which separates the parts of an effect's name; "
                "rename the joint in the model and the column"
            )
        if name not in self.joints:
            near = did_you_mean(name, [*self.joints, *(column for pose in self.poses for column in pose.columns)])
            raise TrialError(
                f"{self.path}: no hinge or slide joint {name}; {near}the model has {', '.join(self.joints)}; "
                "name the column after its joint"
            )
        return self.joints[name]

    def leader(self, joint: Joint) -> str:
        """Return the joint that a joint follows by the model's equalities, or an empty string."""
        return next((each.name for each in self.joints.values() if joint.name in each.followers), "")

    def course(self, joint: Joint, motion: Motion) -> Course:
        """Return the motion of the whole model, for `terms`.

        Args:
            joint: the joint; its own acceleration is left out, since the law computes it.
            motion: column of a joint -> position, speed and acceleration [T each]; other joints stay at their zero, or
                follow by the model's equalities.
        """
        size = len(motion[joint.name][0])
        qpos = np.tile(self.model.qpos0, (size, 1))
        qvel, qacc = np.zeros((size, self.model.nv)), np.zeros((size, self.model.nv))
        for name in motion.keys() & self.joints.keys():
            other = self.joints[name]
            qpos[:, other.position], qvel[:, other.dof], qacc[:, other.dof] = motion[name]
        for pose in self.poses:
            pose.write(motion, qpos, qvel, qacc)
        qacc[:, joint.dof] = 0.0
        dof, shift, speed = joint.dof, np.zeros(self.model.nq), np.zeros(self.model.nv)
        shift[joint.position], speed[dof] = NUDGE, NUDGE_SPEED
        complete = self._closure.complete
        centre = complete(qpos, qvel, qacc, dof)
        if joint.followers:
            faster = complete(qpos, qvel + speed, qacc, dof, centre.position)
            above, below = (complete(qpos + way, qvel, qacc, dof, centre.position) for way in (shift, -shift))
        else:  # no other joint moves with it
            faster = centre._replace(speed=centre.speed + speed)
            above, below = (centre._replace(position=centre.position + way) for way in (shift, -shift))
        return Course((qpos[:, joint.position], qvel[:, dof]), centre, faster, above, below)

    def points(self, joint: Joint, motion: Motion) -> Array:
        """Return points on the bodies along a motion, [T, G, P, 3], m; see `course` and `Shapes.points`."""
        return self._shapes.points(self.course(joint, motion).centre.position)

    @cached_property
    def _shapes(self) -> Shapes:
        return Shapes(self._mujoco, self.model)

    def terms(self, joint: Joint, course: Course, longer: float = 0.0) -> Array:
        """Return the rigid-body terms of a joint along a measured motion, [law.ROWS, T].

        Args:
            joint: the joint.
            course: result of `course` for the joint.
            longer: share by which the link from the joint to the next one is longer, with the same mass.
        """
        mujoco, model = self._mujoco, self._changed(joint, longer)
        data, stage, states = mujoco.MjData(model), mujoco.mjtStage, course.states
        new, same_speed, same_position = map(int, (stage.mjSTAGE_NONE, stage.mjSTAGE_VEL, stage.mjSTAGE_POS))
        known = new, same_speed, same_position, new, new  # stages whose results the evaluation before has left

        forces, inverse = data.qfrc_inverse, mujoco.mj_inverseSkip
        needed = np.empty((len(course.centre.position), len(states), model.nv))
        steps = [*zip(range(len(states)), known, self._writes(data, states), strict=True)]
        for k, rows in enumerate(needed):
            for i, stages, writes in steps:
                for target, values in writes:
                    target[:] = values[k]
                inverse(model, data, stages, 1)
                rows[i] = forces
        along = np.stack([each.along for each in states], axis=1)
        return course.rows(np.einsum("tsv,tsv->st", needed, along))

    def changes(self, joint: Joint, course: Course) -> Changes:
        """Return how the rigid-body terms of a joint change with the bodies that it moves and with the base."""
        bodies = Bodies(self._mujoco, self._bodies, self._moved(joint.dof), self.last_link(joint).number)
        forces = bodies.forces(course.states)
        own = dict(zip(joint.bodies, forces.own, strict=True))
        parts = {first: course.rows(sum(own[name] for name in names)) for first, names in joint.parts.items()}
        tilted = {axis: course.rows(np.tensordot(way, forces.gravity, 1)) for axis, way in self.level_axes.items()}
        return Changes(parts, np.array([course.rows(each) for each in forces.point]), tilted)

    @staticmethod
    def _writes(data: Any, states: Sequence[State]) -> list[list[tuple[Array, Array]]]:
        """Return, for each state, the arrays of MuJoCo's data that differ from the state before, and their values."""
        targets = data.qpos, data.qvel, data.qacc
        values = [(each.position, each.speed, each.acceleration) for each in states]
        return [
            [(t, new) for t, new, old in zip(targets, own, before, strict=True) if new is not old]
            for own, before in zip(values, [(None, None, None), *values], strict=False)
        ]

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

    def still(self, joint: Joint, measured: Mapping[str, object]) -> list[str]:
        """Return the joints that carry a joint or are carried by it and count as still, free and ball joints included.

        Args:
            joint: the joint.
            measured: columns of the measured joints.
        """
        own, found = {*self._moved(joint.dof)}, list[str]()
        for pose in self.poses:
            lacking, depends = pose.lacking(measured), pose.dof in self._closure.dependent
            if lacking and not depends and own & {*self._behind(pose.dof)}:
                found += [pose.name] if lacking == pose.columns else lacking
        for name, other in self.joints.items():
            if name not in measured and other.dof not in self._closure.dependent and own & {*self._moved(other.dof)}:
                found.append(name)
        return [name for name in found if name != joint.name]

    def last_link(self, joint: Joint) -> Link:
        """Return the link at the end of the mechanism behind a joint."""
        return self._links.last(self._moved(joint.dof))

    def held(self, joint: Joint, course: Course) -> NDArray[np.bool_]:
        """Return whether something unknown acts on a joint at each sample of a measured motion, [T].

        That is a contact of a body that the joint moves, a limit of a joint that follows it or of a tendon that it
        moves, or a position that the model's equalities do not allow. A contact between two bodies that it moves has no
        torque about it.
        """
        position = course.centre.position
        found = ~course.centre.closed | ~course.above.closed | ~course.below.closed
        for other in (self.joints[name] for name in joint.followers):
            low, high = other.range
            found |= (position[:, other.position] <= low) | (position[:, other.position] >= high)
        joints = self.model.dof_jntid[np.flatnonzero(self._follows[:, joint.dof])]
        return found | self._contacts.act(position, self._moved(joint.dof), joints)

    def touching(self, joint: Joint, course: Course) -> tuple[str, str, int] | None:
        """Return the two bodies whose contact acts on a joint most often, and in how many samples; None without one."""
        return self._contacts.most(course.centre.position, self._moved(joint.dof))

    def _changed(self, joint: Joint, longer: float) -> Any:
        """Return the rigid bodies without the joint's own spring, damper and friction; see `terms`."""
        model = copy.copy(self._bodies)
        number = self.model.dof_jntid[joint.dof]
        model.dof_damping[joint.dof], model.dof_armature[joint.dof] = 0.0, joint.armature
        model.jnt_stiffness[number] = 0.0
        if longer:
            self._links.stretch(model, int(self.model.dof_bodyid[joint.dof]), 1 + longer)
        self._mujoco.mj_setConst(model, self._mujoco.MjData(model))
        return model

    def moving_kg(self, joint: Joint) -> float:
        """Return the mass of the mechanism that a joint belongs to, without its fixed base, kg."""
        model = self.model
        own = model.body_rootid == model.body_rootid[model.dof_bodyid[joint.dof]]
        return float(model.body_mass[own & (model.body_weldid != 0)].sum())

    def carries(self, joint: Joint) -> bool:
        """Return whether another joint follows behind a hinge of an open chain, so that its link's length matters."""
        links = {*self.model.body_weldid[self._moved(joint.dof)]}
        return joint.turns and not joint.followers and len(links) > 1

    def _behind(self, dof: int) -> list[int]:
        """Return the bodies that a joint moves."""
        found = [int(self.model.dof_bodyid[dof])]
        for body in range(found[0] + 1, self.model.nbody):
            if self.model.body_parentid[body] in found:
                found.append(body)
        return found

    def _moved(self, dof: int) -> list[int]:
        """Return the bodies that a joint moves, with those of the joints that follow it."""
        followers = np.flatnonzero(self._follows[:, dof])
        return sorted({body for each in followers for body in self._behind(int(each))})

    def _parts(self, dof: int, apart: bool) -> dict[str, tuple[str, ...]]:
        """Return the parts that a joint moves: first body -> all bodies of the part.

        A part consists of the bodies that the same joints move. If `apart`, it is one rigid link, since followers of
        the joint itself move differently.
        """
        bodies, found = self._moved(dof), dict[Hashable, list[str]]()
        for body in bodies:
            key = int(self.model.body_weldid[body]) if apart else tuple(body in each for each in self._moved_by)
            found.setdefault(key, []).append(self._name("body", body))
        return {names[0]: tuple(names) for names in found.values()}

    def _order(self, measured: Collection[str], moved: Collection[str]) -> list[int]:
        """Return all degrees of freedom, the last joint of the model first and measured joints last."""
        names = [self._name("joint", int(number)) for number in self.model.dof_jntid]
        return sorted(range(len(names)), key=lambda dof: (names[dof] in measured, names[dof] in moved, -dof))

    def _body(self, name: str) -> int:
        return next(i for i in range(self.model.nbody) if self._name("body", i) == name)

    def _name(self, kind: str, number: int) -> str:
        return str(getattr(self.model, kind)(number).name) or f"{kind}{number}"

    def _joint(self, number: int) -> Joint:
        m, dof = self.model, int(self.model.jnt_dofadr[number])
        ratios = self._ratios[:, dof]
        actuator, problem = (None, "") if dof in self._closure.dependent else self.actuators.of(dof)
        followers = [int(each) for each in np.flatnonzero(self._follows[:, dof]) if each != dof]
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
            actuator=actuator,
            bodies=tuple(self._name("body", i) for i in self._moved(dof)),
            parts=self._parts(dof, bool(followers)),
            problem=f"{self.path}: {problem}" if problem else "",
            followers=tuple(dict.fromkeys(self._name("joint", int(m.dof_jntid[each])) for each in followers)),
            followers_dry=float(np.abs(ratios[followers]) @ m.dof_frictionloss[followers]),
            **self._soft_friction(dof),
        )

    def _soft_friction(self, dof: int) -> dict[str, float]:
        """Return how soft MuJoCo's dry friction is; see its documentation, Computation: Constraint parameters."""
        ends = self._mujoco.mjMINIMP, self._mujoco.mjMAXIMP
        least, most = (float(each) for each in np.clip(self.model.dof_solimp[dof, :2], *ends))
        time, damping = (float(each) for each in self.model.dof_solref[dof])
        rate = 2 / (most * max(time, 2 * self.step_s)) if time > 0 else -damping / most
        return {"softness": (1 - least) / least * float(self.model.dof_invweight0[dof]), "yields_per_s": rate}


def mechanism(path: Path, measured: Iterable[str] = (), moved: Iterable[str] = ()) -> Mechanism:
    """Return the mechanism of a model file, loaded again only after a change of the file; see `Mechanism`."""
    return _mechanism(path, frozenset(measured), frozenset(moved), _changes(path))


@lru_cache(maxsize=8)
def _mechanism(path: Path, measured: frozenset[str], moved: frozenset[str], changes: frozenset[object]) -> Mechanism:
    return Mechanism(path, measured, moved)


def _changes(path: Path) -> frozenset[object]:
    """Return the last changes of a model file and of all files that it includes."""
    found, todo = dict[Path, int](), [path]
    while todo:
        each = todo.pop()
        if each not in found and files.is_file(each):
            found[each] = each.stat().st_mtime_ns
            names = _INCLUDED.findall(each.read_text(encoding="utf-8", errors="replace"))
            todo += [path.parent / name for name in names]
    return frozenset(found.items())
