"""Recording of the mechanisms of the benchmark: rigid bodies by MuJoCo; actuators, friction and sensors by own laws."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from validation.rigs.laws import Play

MODELS: Final = Path(__file__).parent / "models"


@dataclass(frozen=True, slots=True)
class JointLaw:
    """True laws of one joint, besides the shares by which its model's numbers are off."""

    viscous: float = 1.0  # factor of the model's number, as are the next four
    dry: float = 1.0
    armature: float = 1.0
    gain: float = 1.0  # of the actuator
    stiff: float = 1.0  # of a position loop
    more_viscous: float = 0.0  # N m s/rad or N s/m
    more_dry: float = 0.0  # N m or N
    more_inertia: float = 0.0
    spring: float = 0.0
    torque: float = 0.0  # constant
    limit: float = float("inf")
    delay_s: float = 0.0
    lag_s: float = 0.0
    dead: float = 0.0  # position errors that make no torque
    play: float = 0.0
    cogging: float = 0.0  # amplitude of a torque with eight periods a turn
    tiring: float = 0.0  # share of the torque that is lost within a minute
    uneven: float = 0.0  # more dry friction forwards, less backwards
    bent: float = 0.0  # amplitude of an encoder error with one period a turn
    slip: float = 0.0  # jump of the encoder's zero within each recording
    stop: float = 0.0  # torque of a soft stop at the lower end of the half range
    shaken: float = 0.0  # amplitude of a vibration's torque
    resonance_hz: float = 0.0  # of an elastic drive; 0 if it is rigid


@dataclass(frozen=True, slots=True)
class Robot:
    """Mechanism with its joints' scales, and how it is recorded."""

    name: str
    follows: Mapping[str, float]  # position-controlled joint -> half range of its command
    pushed: Mapping[str, float]  # torque-controlled joint -> half range of the motion that its commands cause
    free: tuple[str, ...] = ()  # joints without an actuator
    moved: Mapping[str, float] = field(default_factory=dict)  # joint moved from outside -> half range
    floats: str = ""  # free joint of a body that flies
    followers: Mapping[str, str] = field(default_factory=dict)  # joint -> the joint that it follows by an equality
    step: Mapping[str, float] = field(default_factory=dict)  # joint -> resolution of its encoder, default 1e-3 rad

    @property
    def model(self) -> Path:
        """Return the MJCF file."""
        return MODELS / f"{self.name}.xml"

    @property
    def judged(self) -> tuple[str, ...]:
        """Return the joints that are diagnosed."""
        return (*self.follows, *self.pushed, *self.free)


ROBOTS: Final[Mapping[str, Robot]] = {
    robot.name: robot
    for robot in (
        Robot(
            "arm",
            {"base": 1.0, "shoulder": 0.7, "elbow": 0.8, "forearm_roll": 1.2, "wrist": 1.0, "tool_roll": 1.4},
            {},
        ),
        Robot("gantry", {"x": 0.25, "y": 0.2}, {}, ("swing",), step={"x": 5e-5, "y": 5e-5}),
        Robot("cartpole", {}, {"rail": 0.2}, ("hinge",), step={"rail": 1e-4}),
        Robot("leg", {}, {"hip": 0.5, "knee": 0.6, "ankle": 0.5}),
        Robot("camera", {"pan": 0.9, "tilt": 0.5}, {}, moved={"track": 0.15}, step={"track": 1e-4}),
        Robot("linkage", {"crank": 0.7}, {}, followers={"coupler": "crank", "rocker": "crank"}),
        Robot("gripper", {"wrist": 0.8, "left": 0.02}, {}, followers={"right": "left"}, step={"left": 1e-5}),
        Robot("drone", {"shoulder": 0.7, "elbow": 0.8, "twist": 1.2}, {}, floats="hull"),
    )
}


Array = NDArray[np.float64]

STEP_S = 5e-4
RATE_HZ = 100.0  # of commands and readings
SLOWEST_HZ, FASTEST_HZ = 0.15, 1.6  # parts of a multisine
GIVE, GIVE_SHARE = 1e-3, 5e-3  # turn after which dry friction has its full value (Dahl), at most this share of a range
GRIP = 0.05  # damping of the friction's bristles, as a share of its stiffness, s
HARMONICS = 7
NOISE = 2e-4  # RMS of a reading, as a share of the half range
HOLD_S = 1.6  # of a commanded level
TURN = 2 * np.pi
POINT_KG_M2 = 1e-9  # inertia of a point mass; MuJoCo refuses zero
HEAVY = 1e7  # armature of a joint that is moved from outside
STIFF_S = 4 * STEP_S  # time constant of an equality
SHAKEN_HZ = 2.3  # frequency of a vibration
SLIPS = 0.6  # share of a recording before the encoder slips
STOPS = 0.3  # share of the half range before the soft stop
RESONANT = 0.1  # damping ratio of an elastic drive
FLIES_M, FLIES_RAD = 0.15, 0.2  # half ranges of a flying body, along and about each axis
POSE_STEP_M, POSE_NOISE = 1e-4, 1e-4  # resolution of its position, and noise of its quaternion, by motion capture


@dataclass(frozen=True, slots=True)
class Truth:
    """A mechanism as it really is."""

    laws: Mapping[str, JointLaw]
    masses: Mapping[str, float] = field(default_factory=dict)  # body -> factor
    tilt_rad: tuple[float, float] = (0.0, 0.0)  # of the base, about the model's x axis, then about its y axis
    load: float = 0.0  # extra point mass at the last body's centre, as a share of its mass
    load_at_m: tuple[float, float, float] = (0.0, 0.0, 0.0)  # from that centre, in the body's frame


def write(columns: Mapping[str, Array], path: Path) -> None:
    """Write the columns of a recording as CSV."""
    rows = np.column_stack(list(columns.values()))
    np.savetxt(path, rows, "%.7g", delimiter=",", newline="\r\n", header=",".join(columns), comments="")


def record(robot: Robot, truth: Truth, kind: str, duration_s: float, random: np.random.Generator) -> dict[str, Array]:
    """Record one motion of a kind, "multisine" or "holds"; columns [T] are t, cmd_JOINT, and q_JOINT of every joint."""
    plant = _Plant(robot, truth)
    count, each = round(duration_s * RATE_HZ), round(1 / RATE_HZ / STEP_S)
    t = np.asarray(np.arange(count * each) * STEP_S, dtype=np.float64)
    wanted = {name: _motion(kind, t, half, random) for name, half in {**robot.follows, **robot.pushed}.items()}
    carried = {name: _motion("multisine", t, half, random) for name, half in robot.moved.items()}
    flight = _Flight(t, plant.nominal.qpos0[:3], random) if robot.floats else None
    rows, sent = plant.run(t, wanted, carried, flight, each)
    columns: dict[str, Array] = {"t": t[::each]}
    columns |= {f"cmd_{name}": values for name, values in sent.items()}
    columns |= flight.seen(robot.floats, each, random) if flight is not None else {}
    halves = {**robot.follows, **robot.pushed, **robot.moved}
    for name, values in rows.items():
        step = robot.step.get(name, 1e-3)
        noisy = values + NOISE * halves.get(name, 0.5) * random.normal(size=count)
        columns[f"q_{name}"] = np.asarray(np.round(noisy / step) * step)
    return columns


def _motion(kind: str, t: Array, half: float, random: np.random.Generator) -> Array:
    """Return positions within a half range, [T]; they begin at rest in the middle."""
    rise = np.minimum(t / 1.0, 1.0)
    if kind == "holds":
        levels = random.uniform(-half, half, int(t[-1] / HOLD_S) + 2)
        steps = levels[(t / HOLD_S).astype(int)]
        # A planner turns steps into ramps.
        kept = np.exp(-STEP_S / 0.12)
        return np.asarray(lfilter([(1 - kept) ** 2], np.convolve([1, -kept], [1, -kept]), steps * rise))
    frequency = np.geomspace(SLOWEST_HZ, FASTEST_HZ, HARMONICS)
    size = (frequency / frequency[0]) ** -0.6
    phase = random.uniform(0, TURN, HARMONICS)
    waves = (size[:, None] * np.sin(TURN * frequency[:, None] * t + phase[:, None])).sum(axis=0)
    return np.asarray(half * rise * waves / np.abs(waves).max())


def actuator_of(model: Any, joint: str) -> int:
    """Return the number of the first actuator of a joint, or of a tendon that begins at it."""
    number, tendon = model.joint(joint).id, int(mujoco.mjtTrn.mjTRN_TENDON)
    for i in range(model.nu):
        at = int(model.actuator_trnid[i, 0])
        if model.actuator_trntype[i] == tendon and model.wrap_objid[model.tendon_adr[at]] == number:
            return i
        if model.actuator_trntype[i] == int(mujoco.mjtTrn.mjTRN_JOINT) and at == number:
            return i
    raise KeyError(joint)


def loaded(path: Path, truth: Truth) -> Any:
    """Return a model with the extra mass of a truth."""
    spec = mujoco.MjSpec.from_file(str(path))
    if truth.load:
        last = spec.bodies[-1]
        place = last.ipos + truth.load_at_m
        extra = last.add_body(name="load", pos=place, mass=truth.load * last.mass, inertia=[POINT_KG_M2] * 3)
        extra.explicitinertial = True
    return spec.compile()


class _Plant:
    """Mechanism in MuJoCo, with joint torques from outside."""

    def __init__(self, robot: Robot, truth: Truth) -> None:
        self.robot, self.truth = robot, truth
        self.nominal = mujoco.MjModel.from_xml_path(str(robot.model))
        model = self.model = loaded(robot.model, truth)
        model.opt.timestep, model.opt.integrator = STEP_S, int(mujoco.mjtIntegrator.mjINT_EULER)
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
        model.dof_damping[:] = 0.0
        model.dof_frictionloss[:] = 0.0
        if model.neq:
            model.eq_solref[:] = STIFF_S, 1.0
        self.names = [model.joint(i).name for i in range(model.njnt) if model.joint(i).name != robot.floats]
        self.dofs = np.array([model.joint(name).dofadr[0] for name in self.names])
        self.places = np.array([model.joint(name).qposadr[0] for name in self.names])
        for i, name in zip(self.dofs, self.names, strict=True):
            law = truth.laws.get(name, JointLaw())
            model.dof_armature[i] = law.armature * self.nominal.dof_armature[i] + law.more_inertia
        for name in robot.moved:
            model.dof_armature[model.joint(name).dofadr] = HEAVY
        if robot.floats:
            model.dof_armature[:6] = HEAVY
        for body, factor in truth.masses.items():
            number = model.body(body).id
            model.body_mass[number] *= factor
            model.body_inertia[number] *= factor
        model.opt.gravity[:] = Rotation.from_euler("XY", truth.tilt_rad).inv().apply(model.opt.gravity)
        mujoco.mj_setConst(model, mujoco.MjData(model))

    def run(
        self,
        t: Array,
        wanted: Mapping[str, Array],
        carried: Mapping[str, Array],
        flight: "_Flight | None",
        each: int,
    ) -> tuple[dict[str, Array], dict[str, Array]]:
        """Return readings of every joint and commands, [T / each] each."""
        model, robot = self.model, self.robot
        data, n = mujoco.MjData(model), len(self.names)
        law = {key: self._values(key) for key in JointLaw.__slots__}
        damping = law["viscous"] * self.nominal.dof_damping[self.dofs] + law["more_viscous"]
        dry = law["dry"] * self.nominal.dof_frictionloss[self.dofs] + law["more_dry"]
        drives = [_Drive(self, name, t, each) for name in (*robot.follows, *robot.pushed)]
        bend, count = np.zeros(n), len(t) // each
        halves = {**robot.follows, **robot.pushed}
        ranges = np.array([halves.get(robot.followers.get(name, name), 1.0) for name in self.names])
        give, shake = np.minimum(GIVE, GIVE_SHARE * ranges), np.sin(TURN * SHAKEN_HZ * t)
        true, sent = np.empty((len(t), n)), {d.name: np.empty(count) for d in drives}
        carry = [self._carried(name, path) for name, path in carried.items()]
        for k in range(len(t)):
            for i, path, speed, _ in carry:
                data.qpos[self.places[i]], data.qvel[self.dofs[i]] = path[k], speed[k]
            if flight is not None:
                flight.carry(k, data)
            q, v = data.qpos[self.places], data.qvel[self.dofs]
            true[k] = q
            bend = np.minimum(np.maximum(bend + STEP_S * v, -give), give)  # half the time of np.clip
            level = dry + law["uneven"] * np.sign(v)
            torque = -damping * v - law["spring"] * q + law["torque"]
            torque -= level / give * (bend + GRIP * STEP_S * v) - law["cogging"] * np.sin(8 * q)
            beyond = np.maximum(-q / ranges - STOPS, 0)
            torque += law["stop"] / (1 - STOPS) * beyond - law["shaken"] * shake[k]
            for drive in drives:
                torque[drive.index] += drive.step(k, wanted[drive.name], q, v, sent)
            for i, _, _, force in carry:
                torque[i] = force[k]
            data.qfrc_applied[self.dofs] = torque
            mujoco.mj_step(model, data)
        return {name: self._reading(name, true[:, i])[::each] for i, name in enumerate(self.names)}, sent

    def _carried(self, name: str, path: Array) -> tuple[int, Array, Array, Array]:
        """Return index, path, speed and force of a joint that is moved from outside, whatever its load."""
        i = self.names.index(name)
        return i, path, np.gradient(path, STEP_S), HEAVY * np.gradient(np.gradient(path, STEP_S), STEP_S)

    def _values(self, key: str) -> Array:
        return np.array([getattr(self.truth.laws.get(name, JointLaw()), key) for name in self.names])

    def _reading(self, name: str, q: Array) -> Array:
        """Return what the encoder shows at every step, [T]."""
        law = self.truth.laws.get(name, JointLaw())
        if law.play:
            play = Play(np.asarray(law.play), q[0])
            q = np.array([play.step(x) for x in q])
        slipped = np.arange(len(q)) > SLIPS * len(q)
        return np.asarray(q + law.bent * np.sin(q) + law.slip * slipped)


class _Flight:
    """Pose of a body that flies as it likes, whatever hangs from it: the first six degrees of freedom of a model."""

    def __init__(self, t: Array, start: Array, random: np.random.Generator) -> None:
        self.place = start + np.stack([_motion("multisine", t, FLIES_M, random) for _ in range(3)], axis=1)
        angles = np.stack([_motion("multisine", t, FLIES_RAD, random) for _ in range(3)], axis=1)
        turn = Rotation.from_euler("xyz", angles)
        self.turn = turn.as_quat(scalar_first=True)
        # The path begins and ends at rest.
        rates = np.pad((turn[:-2].inv() * turn[2:]).as_rotvec() / (2 * STEP_S), ((1, 1), (0, 0)), "edge")
        self.speed = np.concatenate((np.gradient(self.place, STEP_S, axis=0), rates), axis=1)
        self.force = HEAVY * np.gradient(self.speed, STEP_S, axis=0)

    def carry(self, k: int, data: Any) -> None:
        """Move the body of a simulation to a step, where its path goes on."""
        data.qpos[:3], data.qpos[3:7] = self.place[k], self.turn[k]
        data.qvel[:6], data.qfrc_applied[:6] = self.speed[k], self.force[k]

    def seen(self, name: str, each: int, random: np.random.Generator) -> dict[str, Array]:
        """Return position and quaternion by motion capture, [T / each] each."""
        place = np.round(self.place[::each] / POSE_STEP_M) * POSE_STEP_M
        turn = self.turn[::each] + POSE_NOISE * random.normal(size=self.turn[::each].shape)
        turn /= np.linalg.norm(turn, axis=1, keepdims=True)
        found = {f"{name}_{axis}": values for axis, values in zip("xyz", place.T, strict=True)}
        return found | {f"{name}_{part}": v for part, v in zip(("qw", "qx", "qy", "qz"), turn.T, strict=True)}


class _Drive:
    """Actuator of one joint: a position loop, or a motor whose commands follow a motion from outside."""

    def __init__(self, plant: _Plant, name: str, t: Array, each: int) -> None:
        model = plant.nominal
        self.name, self.index, self.each = name, plant.names.index(name), each
        self.law = plant.truth.laws.get(name, JointLaw())
        number = actuator_of(model, name)
        self.follows = name in plant.robot.follows
        self.gain, self.gear = float(model.actuator_gainprm[number, 0]), float(model.actuator_gear[number, 0])
        self.kd = -float(model.actuator_biasprm[number, 2])
        limited = model.actuator_forcelimited[number]
        self.limit = float(model.actuator_forcerange[number, 1]) if limited else np.inf
        ctrl = model.actuator_ctrllimited[number]
        self.most = float(model.actuator_ctrlrange[number, 1]) if ctrl else self.limit / self.gear
        self.inertia = float(np.ravel(plant.model.dof_M0)[plant.dofs[self.index]])
        self.queue = [0.0] * (round(self.law.delay_s / STEP_S) + 1)
        self.filtered, self.command = 0.0, 0.0
        self.kept = np.exp(-STEP_S / self.law.lag_s) if self.law.lag_s else 0.0
        self.tired = 1 - self.law.tiring * t / 60.0
        self.rate, self.swing = TURN * self.law.resonance_hz, 0.0  # rad/s; speed of the filtered command

    def step(self, k: int, wanted: Array, q: Array, v: Array, sent: Mapping[str, Array]) -> float:
        """Return the joint torque of a step; a new command is sent with every sample."""
        i = self.index
        if k % self.each == 0:
            self.command = float(wanted[k])
            if not self.follows:  # a tracking controller outside, as a user's script has one
                ahead = min(k + self.each, len(wanted) - 1)
                speed = (wanted[ahead] - wanted[k]) / (self.each * STEP_S)
                stiff = self.inertia * 60.0
                torque = stiff * (wanted[k] - q[i]) + 2 * 0.5 * np.sqrt(stiff * self.inertia) * (speed - v[i])
                self.command = float(min(max(torque / self.gear, -self.most), self.most))
            sent[self.name][k // self.each] = self.command
        self.queue.append(self.command)
        late = self.queue.pop(0)
        if self.rate:
            pull = self.rate * (late - self.filtered) - 2 * RESONANT * self.swing
            self.swing += STEP_S * self.rate * pull
            self.filtered += STEP_S * self.swing
        else:
            self.filtered = late + (self.filtered - late) * self.kept
        if not self.follows:
            torque = self.gear * self.filtered
        else:
            error = self.filtered - q[i]
            error -= min(max(error, -self.law.dead), self.law.dead)
            torque = self.law.stiff * self.gain * error - self.kd * v[i]
        limit = min(self.limit, self.law.limit)
        return float(min(max(self.law.gain * self.tired[k] * torque, -limit), limit))
