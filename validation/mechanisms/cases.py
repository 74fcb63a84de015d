"""Cases of the mechanisms' benchmark: a robot, its faults and recordings, all drawn from one seed."""

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import mujoco
import numpy as np

from validation.mechanisms.record import RATE_HZ, ROBOTS, JointLaw, Robot, Truth, actuator_of, record, write

TRIALS = ("multisine", "holds", "multisine")
DURATION_S = 20.0
FOLLOWED = 6  # degree of the polynomial of a follower's position by its leader's
ANY = "*"  # instead of the joint in the name of a size that all joints share
LEAST_REACH_M = 0.03  # from the last joint to a load
OFF = 0.02  # largest share by which a healthy model's numbers are off


@dataclass(frozen=True, slots=True)
class Scale:
    """Usual sizes of one joint."""

    torque: float
    inertia: float
    speed: float
    half: float


@dataclass(frozen=True, slots=True)
class Passive:
    """Terms of one joint in its model."""

    viscous: float
    dry: float
    armature: float


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault of a joint: the names that are right, and its law at a strength of one."""

    names: tuple[str, ...]
    law: Callable[[JointLaw, Scale, float], JointLaw]
    needs: str = ""  # "follows", "driven" or "" for any joint


def _changed(**more: Callable[[Scale, float], float]) -> Callable[[JointLaw, Scale, float], JointLaw]:
    return lambda law, scale, share: replace(law, **{name: of(scale, share) for name, of in more.items()})


FAULTS: Final[Mapping[str, Fault]] = {
    "friction": Fault(("coulomb_friction",), _changed(more_dry=lambda s, x: 0.25 * x * s.torque)),
    "damping": Fault(("damping",), _changed(more_viscous=lambda s, x: 0.3 * x * s.torque / s.speed)),
    "rotor": Fault(("armature",), _changed(more_inertia=lambda s, x: 0.5 * x * s.inertia)),
    "weak": Fault(("gain",), _changed(gain=lambda s, x: 1 - 0.3 * x), "driven"),
    "soft": Fault(("position_gain",), _changed(stiff=lambda s, x: 1 - 0.4 * x), "follows"),
    "late": Fault(("dead_time", "latency"), _changed(delay_s=lambda s, x: 0.05 * x), "driven"),
    "slow": Fault(("lag",), _changed(lag_s=lambda s, x: 0.08 * x), "driven"),
    "dead": Fault(("deadband",), _changed(dead=lambda s, x: 0.03 * x * s.half), "follows"),
    "play": Fault(("backlash",), _changed(play=lambda s, x: 0.04 * x * s.half)),
    "limit": Fault(("ceiling",), _changed(limit=lambda s, x: s.torque * (0.9 - 0.3 * x)), "driven"),
    "spring": Fault(("spring",), _changed(spring=lambda s, x: 0.4 * x * s.torque / s.half)),
    # More friction one way than the other is friction and a constant torque.
    "uneven": Fault(("torque_offset", "command_bias"), _changed(uneven=lambda s, x: 0.25 * x * s.torque), "driven"),
    "pull": Fault(("torque_offset", "command_bias"), _changed(torque=lambda s, x: 0.3 * x * s.torque), "driven"),
}
# Fault -> effect.parameter and its true value, by the joint's law and the model's own terms.
SIZES: Final[Mapping[str, tuple[str, Callable[[JointLaw, Passive], float]]]] = {
    "friction": ("coulomb_friction.torque", lambda law, own: law.dry * own.dry + law.more_dry),
    "damping": ("damping.viscous", lambda law, own: law.viscous * own.viscous + law.more_viscous),
    "rotor": ("armature.inertia", lambda law, own: law.armature * own.armature + law.more_inertia),
    "weak": ("gain.scale", lambda law, own: law.gain - 1),
    "soft": ("position_gain.scale", lambda law, own: law.stiff - 1),
    "late": ("dead_time.delay", lambda law, own: law.delay_s),
    "slow": ("lag.time", lambda law, own: law.lag_s),
    "dead": ("deadband.width", lambda law, own: law.dead),
    "play": ("backlash.gap", lambda law, own: law.play),
    "limit": ("ceiling.limit", lambda law, own: law.limit),
    "spring": ("spring.stiffness", lambda law, own: law.spring),
    "pull": ("torque_offset.torque", lambda law, own: law.torque),
}
UNKNOWNS: Final[Mapping[str, Fault]] = {
    "cogging": Fault((), _changed(cogging=lambda s, x: 0.25 * x * s.torque)),
    "tiring": Fault((), _changed(tiring=lambda s, x: 0.9 * x), "driven"),
    "bent": Fault((), _changed(bent=lambda s, x: 0.05 * x * s.half)),
    "slips": Fault((), _changed(slip=lambda s, x: 0.05 * x * s.half)),
    "stopped": Fault((), _changed(stop=lambda s, x: x * s.torque)),
    "shaken": Fault((), _changed(shaken=lambda s, x: 0.25 * x * s.torque)),
    "elastic": Fault((), _changed(resonance_hz=lambda s, x: 4.0 / x), "follows"),
}


@dataclass(frozen=True, slots=True)
class Whole:
    """One fault of the whole mechanism: what is true with it, the joints that show it and the names that are right."""

    truth: Truth
    joints: tuple[str, ...]
    names: tuple[str, ...]
    sizes: Mapping[str, float]  # by effect.parameter, the same for all joints


def _tilted(robot: Robot, truth: Truth, random: np.random.Generator) -> Whole:
    """Tilt the base by up to four degrees."""
    x, y = _angles(random)
    return Whole(replace(truth, tilt_rad=(x, y)), robot.judged, ("tilt",), {"tilt.x": x, "tilt.y": y})


def _loaded(robot: Robot, truth: Truth, random: np.random.Generator) -> Whole:
    """Load the centre of the last body."""
    return _with_load(robot, replace(truth, load=random.uniform(0.4, 1.0)))


def _with_load(robot: Robot, truth: Truth) -> Whole:
    """Return the fault of an extra mass."""
    last_kg = float(mujoco.MjModel.from_xml_path(str(robot.model)).body_mass[-1])
    return Whole(truth, robot.judged, ("payload",), {"payload.mass": truth.load * last_kg})


def _beside(robot: Robot, truth: Truth, random: np.random.Generator) -> Whole:
    """Load the last body beside its centre, as far away as that centre is from the joint."""
    *_, (_, _, reach_m) = _bodies(robot)
    direction = random.normal(size=3)
    x, y, z = map(float, max(reach_m, LEAST_REACH_M) * direction / np.linalg.norm(direction))
    return _with_load(robot, replace(truth, load=random.uniform(0.4, 1.0), load_at_m=(x, y, z)))


def _heavier(robot: Robot, truth: Truth, random: np.random.Generator) -> Whole:
    """Make one body heavier that several joints move; the last body alone is loaded alike by a payload."""
    bodies = [(body, joints) for body, joints, _ in _bodies(robot)]
    several = [(body, joints) for body, joints in bodies if len(joints) > 1]
    body, joints = several[random.integers(len(several))]
    masses = {**truth.masses, body: truth.masses.get(body, 1.0) * random.uniform(1.4, 2.0)}
    alike = ("mass", "payload") if body == bodies[-1][0] else ()
    sizes = {f"mass_{body}.scale": masses[body] - 1}
    return Whole(replace(truth, masses=masses), joints, (f"mass_{body}", *alike), sizes)


# Faults of the whole mechanism, which several joints show.
WHOLE: Final[Mapping[str, Callable[[Robot, Truth, np.random.Generator], Whole]]] = {
    "tilted": _tilted,
    "loaded": _loaded,
    "beside": _beside,
    "heavier": _heavier,
}


@dataclass(frozen=True, slots=True)
class MechanismCase:
    """One case of the benchmark, which is drawn while it is recorded."""

    seed: int
    index: int  # robots take turns with it
    category: str  # "single", "half", "two", "whole", "none" or "unknown"

    @property
    def name(self) -> str:
        """Return the name of its files."""
        return f"mechanism-{self.seed}-{self.index:03d}"

    @property
    def truth(self) -> dict[str, Any]:
        """Return the part of the truth that is known before the draw."""
        return {"case": self.name, "category": self.category}


def draw_and_write(case: MechanismCase, data: Path, truths: Path) -> None:
    """Record one case: its input in `data/NAME` and its causes in `truths/NAME.json`."""
    random, category = np.random.default_rng((case.seed, case.index)), case.category
    robot = list(ROBOTS.values())[case.index % len(ROBOTS)]
    laws, masses = _healthy(robot, random)
    strength = 0.5 if category == "half" else 1.0
    count = {"none": 0, "two": 2, "whole": 0}.get(category, 1)
    table, causes = UNKNOWNS if category == "unknown" else FAULTS, []
    scales = scales_of(robot) if count else {}
    for joint in map(str, random.permutation(robot.judged)[:count]):
        fits = [key for key, fault in table.items() if _fits(robot, joint, fault)]
        key = str(random.choice(fits))
        laws[joint] = table[key].law(laws[joint], scales[joint], strength * random.uniform(0.8, 1.25))
        sizes = sizes_of(robot, joint, key, laws[joint])
        causes.append({"fault": key, "joints": [joint], "names": list(table[key].names), "sizes": sizes})
    truth = Truth(laws, masses)
    if category == "whole":
        several = any(len(joints) > 1 for _, joints, _ in _bodies(robot))
        key = str(random.choice([key for key in WHOLE if several or key != "heavier"]))
        fault = WHOLE[key](robot, truth, random)
        truth = fault.truth
        sizes = {f"{ANY}.{path}": size for path, size in fault.sizes.items()}
        causes.append({"fault": key, "joints": list(fault.joints), "names": list(fault.names), "sizes": sizes})
    place = data / case.name
    place.mkdir(parents=True, exist_ok=True)
    for number, kind in enumerate(TRIALS):
        write(record(robot, truth, kind, DURATION_S, random), place / f"{kind}-{number}.csv")
    shutil.copy(robot.model, place / "robot.xml")
    (place / "stage.yaml").write_text(stage_text(robot), encoding="utf-8")
    about = {**case.truth, "robot": robot.name, "causes": causes}
    truths.mkdir(exist_ok=True)
    (truths / f"{case.name}.json").write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")


def sizes_of(robot: Robot, joint: str, fault: str, law: JointLaw) -> dict[str, float]:
    """Return the true size of a fault, by joint.effect.parameter; none of a joint with followers, which add theirs."""
    if fault not in SIZES or joint in robot.followers.values():
        return {}
    path, value = SIZES[fault]
    model = mujoco.MjModel.from_xml_path(str(robot.model))
    dof = model.joint(joint).dofadr[0]
    passive = Passive(*(float(x[dof]) for x in (model.dof_damping, model.dof_frictionloss, model.dof_armature)))
    return {f"{joint}.{path}": value(law, passive)}


def stage_text(robot: Robot) -> str:
    """Return the stage.yaml of a robot's recordings."""
    model = mujoco.MjModel.from_xml_path(str(robot.model))
    slides = {model.joint(i).name for i in range(model.njnt) if model.jnt_type[i] == int(mujoco.mjtJoint.mjJNT_SLIDE)}

    def channel(name: str, columns: Sequence[tuple[str, str, str]]) -> list[str]:
        head = [f"  {name}:", "    time: {source: t, unit: s}", "    columns:"]
        return head + [f"      {own}: {{source: {source}, unit: {unit}}}" for own, source, unit in columns]

    def unit(joint: str) -> str:
        return "m" if joint in slides else "rad"

    lines = ["kind: mujoco", "channels:"]
    lines += channel("measured", [(j, f"q_{j}", unit(j)) for j in robot.judged])
    commands = []
    for joint in (*robot.follows, *robot.pushed):
        torque = "N" if joint in slides else "N m"
        name = model.actuator(actuator_of(model, joint)).name
        commands.append((name, f"cmd_{joint}", unit(joint) if joint in robot.follows else torque))
    lines += channel("command", commands)
    base = [(j, f"q_{j}", unit(j)) for j in robot.moved]
    if robot.floats:
        base += [(f"{robot.floats}_{axis}", f"{robot.floats}_{axis}", "m") for axis in "xyz"]
        base += [(f"{robot.floats}_q{part}", f"{robot.floats}_q{part}", "1") for part in "wxyz"]
    if base:
        lines += channel("base", base)
    lines += ["model: {mjcf: robot.xml}", "trials:"]
    lines += [f"  - {{files: {kind}-*.csv, kind: {kind}}}" for kind in dict.fromkeys(TRIALS)]
    return "\n".join(lines) + "\n"


def scales_of(robot: Robot) -> dict[str, Scale]:
    """Return the usual sizes of a robot's joints, from a recording of its model as it is."""
    found = record(robot, Truth({}), "multisine", 8.0, np.random.default_rng(0))
    model = mujoco.MjModel.from_xml_path(str(robot.model))
    data = mujoco.MjData(model)
    names = [model.joint(i).name for i in range(model.njnt) if model.joint(i).name != robot.floats]
    places = [model.joint(name).qposadr[0] for name in names]
    dofs = [model.joint(name).dofadr[0] for name in names]
    q = np.stack([found[f"q_{name}"] for name in names], axis=1)
    kernel = np.ones(9) / 9
    q = np.stack([np.convolve(np.convolve(x, kernel, "same"), kernel, "same") for x in q.T], axis=1)
    v = np.gradient(q, 1 / RATE_HZ, axis=0)
    a = np.gradient(v, 1 / RATE_HZ, axis=0)
    flags = mujoco.mjtDisableBit
    model.opt.disableflags |= int(flags.mjDSBL_ACTUATION) | int(flags.mjDSBL_EQUALITY)
    torques = np.empty_like(q)
    for k in range(len(q)):
        data.qpos[places], data.qvel[dofs], data.qacc[dofs] = q[k], v[k], a[k]
        mujoco.mj_inverse(model, data)
        torques[k] = data.qfrc_inverse[dofs]
    inner, inertia = slice(20, -20), np.ravel(model.dof_M0)[dofs]
    for follower, leader in robot.followers.items():
        i, j = names.index(follower), names.index(leader)
        ratio = np.polynomial.Polynomial.fit(q[:, j], q[:, i], FOLLOWED).deriv()(q[:, j])
        torques[:, j] += ratio * torques[:, i]
        inertia[j] += np.mean(ratio**2) * inertia[i]
    return {
        name: Scale(
            torque=float(np.sqrt(np.mean((torques[inner, i] - np.mean(torques[inner, i])) ** 2)))
            or float(model.dof_frictionloss[dofs[i]]),
            inertia=float(inertia[i]),
            speed=float(np.sqrt(np.mean(v[inner, i] ** 2))),
            half=float(np.ptp(q[inner, i])) / 2,
        )
        for i, name in enumerate(names)
    }


def _healthy(robot: Robot, random: np.random.Generator) -> tuple[dict[str, JointLaw], dict[str, float]]:
    """Return laws whose numbers are off by one to two per cent, and factors of the masses."""
    model = mujoco.MjModel.from_xml_path(str(robot.model))

    def off() -> float:
        return 1 + float(random.choice((-1, 1)) * random.uniform(OFF / 2, OFF))

    laws = {name: JointLaw(viscous=off(), dry=off(), armature=off(), gain=off()) for name in robot.judged}
    return laws, {model.body(i).name: off() for i in range(1, model.nbody)}


def _bodies(robot: Robot) -> list[tuple[str, tuple[str, ...], float]]:
    """Return every body with the judged joints that move it and its centre's distance from its own frame, m."""
    model = mujoco.MjModel.from_xml_path(str(robot.model))
    found: list[tuple[str, tuple[str, ...], float]] = []
    for i in range(1, model.nbody):
        above, joints = i, []
        while above:
            first = model.body_jntadr[above]
            joints += [model.joint(j).name for j in range(first, first + model.body_jntnum[above])]
            above = model.body_parentid[above]
        judged = tuple(name for name in robot.judged if name in joints)
        found.append((model.body(i).name, judged, float(np.linalg.norm(model.body_ipos[i]))))
    return found


def _angles(random: np.random.Generator) -> tuple[float, float]:
    """Return tilts of two to four degrees about both axes, rad."""
    x, y = random.choice((-1, 1), 2) * np.radians(random.uniform(2.0, 4.0, 2))
    return float(x), float(y)


def _fits(robot: Robot, joint: str, fault: Fault) -> bool:
    if fault.needs == "follows":
        return joint in robot.follows
    return fault.needs == "" or joint not in robot.free
