"""Actuators that are more than one motor at one joint: muscles, antagonistic pairs, tendons over several joints."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import mujoco
import numpy as np
import pytest
import yaml

from softarm.diagnosis.data import tables
from softarm.diagnosis.data.trials import TrialError
from softarm.diagnosis.rigs.diagnose import diagnose_table
from softarm.diagnosis.rigs.mjcf import patch
from softarm.diagnosis.rigs.mjcf.mechanism import Mechanism
from softarm.diagnosis.rigs.mjcf.runtime import RuntimeEffects, Simulation
from tests.cli.invoke import succeed
from tests.diagnosis.rigs.recordings import recorded, rms, simulate, view_of_joint
from tests.diagnosis.verdicts import with_parameters

ARM = """<mujoco><compiler angle="radian"/><option timestep="0.001" integrator="implicitfast"/>
<default><joint axis="0 1 0" damping="0.2" armature="0.001"/><geom size=".03" contype="0" conaffinity="0"/></default>
<worldbody><site name="a" pos=".05 0 .1"/><site name="b" pos="-.05 0 .1"/>
<body><joint name="shoulder"/><geom type="capsule" fromto="0 0 0 0 0 -.3" mass="1.2"/>
<site name="c" pos=".03 0 -.12"/><site name="d" pos="-.03 0 -.12"/>
<body pos="0 0 -.3"><joint name="elbow" damping="0.1"/><geom type="capsule" fromto="0 0 0 0 0 -.25" mass=".7"/>
<site name="e" pos=".03 0 -.08"/><site name="f" pos="-.03 0 -.08"/></body></body></worldbody>
<tendon><spatial name="front"><site site="a"/><site site="c"/></spatial>
<spatial name="back"><site site="b"/><site site="d"/></spatial>
<spatial name="biceps"><site site="c"/><site site="e"/></spatial>
<spatial name="triceps"><site site="d"/><site site="f"/></spatial></tendon>
<actuator>ACTUATORS</actuator></mujoco>"""
LENGTHS = {"front": "0.13 0.31", "back": "0.13 0.31", "biceps": "0.18 0.34", "triceps": "0.18 0.34"}
PEAKS_N = {"front": 250.0, "back": 250.0, "biceps": 60.0, "triceps": 60.0}
MUSCLE = '<muscle name="{0}" tendon="{0}" lengthrange="{1}" force="{2}" timeconst="0.01 0.04"/>'

SEGMENT = """<mujoco><compiler angle="radian"/><option timestep="0.001" integrator="implicitfast"/>
<default><joint axis="0 1 0" damping="0.01" armature="0.0005" stiffness="0.6"/>
<geom type="capsule" size=".015" contype="0" conaffinity="0"/></default>
<worldbody><body name="one"><joint name="near"/><geom fromto="0 0 0 0 0 -.08" mass=".05"/>
<body name="two" pos="0 0 -.08"><joint name="far"/><geom fromto="0 0 0 0 0 -.08" mass=".05"/></body></body></worldbody>
<tendon><fixed name="left"><joint joint="near" coef=".01"/><joint joint="far" coef=".012"/></fixed>
<fixed name="right"><joint joint="near" coef="-.01"/><joint joint="far" coef="-.012"/></fixed></tendon>
<actuator>LEFT RIGHT</actuator></mujoco>"""
BELLOW = '<general name="{0}" tendon="{0}" dyntype="filterexact" dynprm="0.05" ctrllimited="true" ctrlrange="0 30"/>'
LEFT = '<motor name="{0}" tendon="{0}" gear="-1.5" ctrllimited="true" ctrlrange="-1 2"/>'
RIGHT = '<general name="{0}" tendon="{0}" gainprm="3" biastype="affine" biasprm="0.5 0 0" forcerange="-1 4"/>'

FINGER = """<mujoco><compiler angle="radian"/><option timestep="0.001" integrator="implicitfast"/>
<default><joint axis="0 1 0" damping="0.01" armature="0.001" stiffness="0.3"/>
<geom type="capsule" size="0.008" contype="0" conaffinity="0"/></default>
<worldbody><body name="proximal"><joint name="knuckle"/><geom fromto="0 0 0 0 0 -0.08" mass="0.08"/>
<site name="near" pos="0.01 0 -0.07"/><body name="tip" pos="0 0 -0.08"><joint name="middle" stiffness="0.2"/>
<geom fromto="0 0 0 0 0 -0.06" mass="0.05"/><site name="far" pos="0.01 0 -0.05"/></body></body></worldbody>
<tendon><fixed name="flexor"><joint joint="knuckle" coef="0.5"/><joint joint="middle" coef="0.4"/></fixed></tendon>
<actuator>ACTUATOR</actuator></mujoco>"""
LOOP = '<position name="flexor" tendon="flexor" kp="3" kv="0.1" forcerange="-1 1"/>'


def arm(**others):
    """Return a model with two muscles at each joint, or other actuators in their place."""
    actuators = (others.get(name, MUSCLE.format(name, LENGTHS[name], PEAKS_N[name])) for name in PEAKS_N)
    return ARM.replace("ACTUATORS", "".join(actuators))


def segment(left=BELLOW, right=BELLOW):
    """Return a model with two bellows that pull against each other and move both joints."""
    return SEGMENT.replace("LEFT", left.format("left")).replace("RIGHT", right.format("right"))


def finger(actuator=LOOP):
    """Return a model with one actuator that moves both joints."""
    return FINGER.replace("ACTUATOR", actuator)


def pulls(random, seconds=8.0):
    """Return commands of an antagonistic pair at each joint of the arm, [T, 4]."""
    t, hertz = np.arange(int(100 * seconds)) / 100, random.uniform(0.15, 1.1, (2, 4))
    turns = random.uniform(0, 6, (2, 4))
    pulled = 0.12 * np.clip(np.sin(2 * np.pi * hertz * t[:, None, None] + turns).sum(axis=2) / 2.2, -1, 1)
    return np.clip(0.1 + np.stack((pulled, -pulled), axis=2).reshape(len(t), 4), 0, 1)


def pressures(random, seconds=6.0):
    """Return commands of the bellows of the segment, [T, 2]."""
    hertz, t = np.array([0.2, 0.5, 1.1, 2.0]), np.arange(int(100 * seconds)) / 100
    waves = np.sin(2 * np.pi * hertz * t[:, None, None] + random.uniform(0, 6, (2, 4)))
    return np.clip(12 + 4 * waves.sum(axis=2), 0, 30)


def goals(random, seconds=5.0, size=0.25):
    """Return commands of the finger, [T]."""
    hertz, t = np.array([0.3, 0.7, 1.3, 2.1]), np.arange(int(100 * seconds)) / 100
    return size * np.sin(2 * np.pi * hertz * t[:, None] + random.uniform(0, 6, 4)).sum(axis=1)


@dataclass(frozen=True)
class Robot:
    """Model with its joints, its commands and the noise of its encoders."""

    text: str
    joints: tuple[str, str]
    commands: Callable
    noise_rad: float

    def recorded(self, folder, seconds=None, **options):
        """Record the robot, and return the path of its stage.yaml; options: as of `recorded`."""
        commands = self.commands if seconds is None else partial(self.commands, seconds=seconds)
        return recorded(folder, self.text, commands, **{"noise_rad": self.noise_rad, **options})

    def view(self, folder, joint, **options):
        """Return the view of a joint of the recorded robot."""
        return view_of_joint(self.recorded(folder, **options), joint)


MUSCLES = Robot(arm(), ("shoulder", "elbow"), pulls, 2e-4)
BELLOWS = Robot(segment(), ("near", "far"), pressures, 1e-4)
TENDON = Robot(finger(), ("knuckle", "middle"), goals, 5e-5)
DRIVEN = replace(TENDON, text=finger('<motor name="flexor" tendon="flexor"/>'))
PAIR = "left and right"
SLOW = '<general name="flexor" tendon="flexor" dyntype="filterexact" dynprm="0.3" biastype="affine"/>'


def weaken(robot, name, share):
    """Multiply the force of an actuator."""
    actuator = robot.actuator(name)
    own = slice(2, 3) if actuator.gaintype[0] == mujoco.mjtGain.mjGAIN_MUSCLE else slice(None)
    actuator.gainprm[own] *= share
    actuator.biasprm[own] *= share


@pytest.mark.parametrize(
    "others",
    [
        {},
        {"biceps": '<motor name="biceps" tendon="biceps" gear="20"/>'},
        {"biceps": '<position name="biceps" tendon="biceps" kp="900" timeconst="0.03"/>'},
        {"front": '<damper name="front" tendon="front" kv="300" ctrlrange="0 1"/>'},
        {"back": '<general name="back" tendon="back" gainprm="40" dyntype="filterexact" dynprm="0.1"/>'},
    ],
    ids=["muscles", "motor", "position loop", "damper", "filter"],
)
def test_torques_along_a_motion_are_those_of_mujoco(tmp_path, others):
    (tmp_path / "robot.xml").write_text(arm(**others))
    mechanism = Mechanism(tmp_path / "robot.xml", MUSCLES.joints)
    data, rows = mujoco.MjData(mechanism.model), []
    sent = pulls(np.random.default_rng(0), 4.0)
    for command in sent:
        data.ctrl[:] = command
        mujoco.mj_forward(mechanism.model, data)
        rows.append((data.qpos.copy(), data.qvel.copy(), data.qacc.copy(), data.qfrc_actuator.copy()))
        mujoco.mj_step(mechanism.model, data, nstep=10)
    position, speed, acceleration, torque = map(np.array, zip(*rows, strict=True))
    motion = {name: (position[:, k], speed[:, k], acceleration[:, k]) for k, name in enumerate(MUSCLES.joints)}
    before = np.concatenate((sent[:1], sent[:-1]))
    for k, joint in enumerate(map(mechanism.joint, MUSCLES.joints)):
        names, course = [*joint.actuator.shares], mechanism.course(joint, motion)
        total = 0.0
        for name, strength in zip(names, mechanism.actuators.strengths(names, course.centre), strict=True):
            column = [*PEAKS_N].index(name)
            activation = sent[:, column]
            if mechanism.model.actuator(name).actnum[0]:
                activation = mechanism.actuators.activation(name, before[:, column], 0.01)
            total += strength.active * activation + strength.passive
        off = (total - torque[:, k])[50:]
        assert np.std(off) < 0.01 * np.std(torque[:, k])


@pytest.mark.parametrize(
    "text",
    [segment(LEFT, RIGHT), *(finger(LOOP.replace("/>", f' gear="{ratio}"/>')) for ratio in (1, -2))],
    ids=["pair", "tendon", "gear"],
)
def test_a_joint_feels_its_actuators_as_mujoco_moves_it(tmp_path, text):
    """The gear, the ranges and the positions of the other joints count as well."""
    (tmp_path / "robot.xml").write_text(text)
    robot = Mechanism(tmp_path / "robot.xml")
    data, random = mujoco.MjData(robot.model), np.random.default_rng(0)
    for _ in range(50):
        data.qpos[:], data.qvel[:] = random.normal(size=2), random.normal(size=2)
        data.ctrl[:] = 3 * random.normal(size=robot.model.nu)
        mujoco.mj_forward(robot.model, data)
        sent = {robot.model.actuator(i).name: np.array([x]) for i, x in enumerate(data.ctrl)}
        for joint in map(robot.joint, (robot.model.joint(i).name for i in range(2))):
            drive, felt = joint.actuator, []
            for state, own in ((data.qpos, joint.position), (data.qvel, joint.dof)):
                length = sum(ratio * state[robot.joint(name).dof] for name, ratio in drive.others.items())
                felt.append(state[own] + length / drive.gear)
            assert drive.torque(drive.sent(sent.__getitem__), *felt) == pytest.approx(
                data.qfrc_actuator[joint.dof], abs=1e-12
            )


def test_a_loop_that_is_too_fast_for_its_torque_to_show_is_refused(tmp_path):
    for kp, refused in ((4e3, False), (6e3, True)):
        (tmp_path / "robot.xml").write_text(arm(biceps=f'<position name="biceps" tendon="biceps" kp="{kp}"/>'))
        problem = Mechanism(tmp_path / "robot.xml").joint("elbow").problem
        assert ("a position loop may swing at 4 Hz at most" in problem) == refused
        assert ("give its torque under `torque`, as elbow" in problem) == refused


@pytest.mark.parametrize(
    ("right", "reason"),
    [
        (BELLOW.replace("ctrlrange=", 'forcerange="0 30" ctrlrange='), "is moved by left, right; several actuators"),
        (BELLOW.replace('"0.05"', '"0.2"').replace('="{0}" ', '="{0}.1" ', 1), "is moved by right.1: its name holds"),
    ],
    ids=["limit behind the lag", "dot in a name"],
)
def test_other_pairs_are_refused(tmp_path, right, reason):
    (tmp_path / "robot.xml").write_text(segment(right=right))
    joint = Mechanism(tmp_path / "robot.xml").joint("far")
    assert joint.actuator is None
    assert f"joint far {reason}" in joint.problem
    assert "give its torque under `torque`, as far" in joint.problem


@pytest.mark.parametrize("robot", [MUSCLES, BELLOWS, TENDON, DRIVEN], ids=["muscles", "bellows", "loop", "motor"])
def test_a_healthy_robot_has_no_gap_to_its_model(tmp_path, robot):
    """Half a step of MuJoCo remains: 0.5 ms at 3 rad/s."""
    stage = robot.recorded(tmp_path)
    for joint in robot.joints:
        view = view_of_joint(stage, joint)
        assert rms(view) < 0.008 * np.nanstd(view.measured)


@pytest.mark.parametrize(
    ("robot", "joint", "first_s", "last_s"),
    [(MUSCLES, "elbow", 0.3, 0.6), (replace(TENDON, text=finger(SLOW)), "middle", 0.8, 1.5)],
    ids=["muscles", "slow"],
)
def test_the_start_is_left_out_until_the_activations_are_known(tmp_path, robot, joint, first_s, last_s):
    """The recording begins with a command that a slow actuator has not reached."""
    view = robot.view(tmp_path, joint)
    assert first_s < view.t_s[np.isfinite(view.measured[:, 0])][0] < last_s
    assert rms(view) < 3e-3


@pytest.mark.parametrize(
    ("robot", "joint", "weak", "other", "share"),
    [(MUSCLES, "elbow", "biceps", "triceps", 0.8), (BELLOWS, "far", "left", "right", 0.7)],
    ids=["muscles", "bellows"],
)
def test_each_actuator_of_a_pair_has_a_gain_of_its_own(tmp_path, robot, joint, weak, other, share):
    view = robot.view(tmp_path, joint, change=partial(weaken, name=weak, share=share))
    gaps = {name: rms(view, {f"{joint}.gain_{name}.scale": share - 1}) for name in (weak, other)}
    assert gaps[weak] < 0.05 * rms(view) < 0.05 * gaps[other]


@pytest.mark.parametrize(("robot", "joint"), [(MUSCLES, "elbow"), (TENDON, "middle")], ids=["muscles", "tendon"])
def test_a_late_command_leaves_the_motion_of_the_other_joint_in_time(tmp_path, robot, joint):
    view = robot.view(tmp_path, joint, late=3)
    now, late = (rms(view, {f"{joint}.dead_time.delay": delay_s}) for delay_s in (0.0, 0.03))
    assert late < 0.1 * now


@pytest.mark.parametrize(
    ("robot", "joint", "parts"),
    [
        (TENDON, "middle", dict.fromkeys(("gain", "position_gain", "lag", "dead_time"), "flexor")),
        (BELLOWS, "far", {"gain_left": "left", "gain_right": "right", "lag": PAIR, "dead_time": PAIR}),
    ],
    ids=["tendon", "bellows"],
)
def test_effects_of_an_actuator_belong_to_all_joints_that_it_moves(tmp_path, robot, joint, parts):
    view, gain = robot.view(tmp_path, joint), next(iter(parts))
    assert {effect: view.part(effect) for effect in parts} == {k: f"actuator {v}" for k, v in parts.items()}
    common, own = (view.gap([{f"{owner}.{gain}.scale": -0.2}]) for owner in (view.part(gain), joint))
    assert np.array_equal(common, own, equal_nan=True)


@pytest.mark.parametrize("lag", ["", ' dyntype="filterexact" dynprm="0.3"'])
def test_a_muscle_that_bends_springs_of_the_model_is_no_position_loop(tmp_path, lag):
    """The torque is nearly a multiple of the angle."""
    stiff = finger(f'<general name="flexor" tendon="flexor"{lag}/>').replace('stiffness="0.', 'stiffness="10.')
    stage = replace(TENDON, text=stiff, commands=partial(goals, size=5.0)).recorded(tmp_path)
    assert [view_of_joint(stage, name).assumptions for name in TENDON.joints] == [(), ()]


@pytest.mark.parametrize(
    ("robot", "joint", "channel", "column", "says"),
    [
        (BELLOWS, "far", "command", "right", "far is moved by the actuator right, whose command is missing"),
        (TENDON, "middle", "measured", "knuckle", "flexor moves middle and knuckle, which no column measures; add it"),
    ],
    ids=["command", "joint"],
)
def test_the_columns_of_all_motors_and_joints_are_needed(tmp_path, robot, joint, channel, column, says):
    file = robot.recorded(tmp_path)
    stage = yaml.safe_load(file.read_text())
    del stage["channels"][channel]["columns"][column]
    file.write_text(yaml.safe_dump(stage))
    with pytest.raises(TrialError, match=says):
        view_of_joint(file, joint)


def test_a_description_has_the_commands_of_both_and_neither_as_a_reading(tmp_path):
    """The names of the motors hold that of the joint, and are shorter than the name of its readings."""
    names, text = {"left": "far_l", "right": "far_r"}, segment()
    for old, new in names.items():
        text = text.replace(f'name="{old}"', f'name="{new}"').replace(f'tendon="{old}"', f'tendon="{new}"')
    replace(BELLOWS, text=text).recorded(tmp_path)
    run = tmp_path / "run-0.csv"
    run.write_text(run.read_text().replace(",near,far\n", ",near_position,far_position\n"))
    channels = new_description(tmp_path)
    sources = {name: use["source"] for name, use in channels["measured"]["columns"].items()}
    assert sources == {"near": "near_position", "far": "far_position"}
    units = {name: use["unit"] for name, use in channels["command"]["columns"].items()}
    assert units == dict.fromkeys(names.values(), "-")


def new_description(folder):
    """Return the channels of a new description of a robot and its first run."""
    succeed("new", "rig", folder / "robot.xml", folder / "run-0.csv", "--out", folder / "new.yaml")
    return yaml.safe_load((folder / "new.yaml").read_text())["channels"]


def alone():
    """Return a model whose elbow has the biceps alone, against gravity."""
    return arm(triceps="").replace('damping="0.1"', 'damping="0.1" stiffness="2"')


def test_a_command_of_a_muscle_alone_may_be_named_after_its_joint(tmp_path):
    simulate(alone(), tmp_path / "run-0.csv", pulls(np.random.default_rng(0), 4.0)[:, :3])
    (tmp_path / "robot.xml").write_text(alone())
    run = tmp_path / "run-0.csv"
    run.write_text(run.read_text().replace(",biceps,", ",elbow_command,"))
    columns = new_description(tmp_path)["command"]["columns"]
    assert columns["biceps"] == {"source": "elbow_command", "unit": "-"}
    assert {use["unit"] for use in columns.values()} == {"-"}


def patched(folder, text, *changes):
    """Return the patch of a model with some changes, and the patched model."""
    (folder / "robot.xml").write_text(text)
    made = patch.patched(folder / "robot.xml", with_parameters([(*each, "-") for each in changes]), calibration=False)
    return made, mujoco.MjModel.from_xml_string(made.text)


def test_the_patch_holds_the_gain_of_a_muscle_and_of_a_motor(tmp_path):
    text = arm(biceps='<motor name="biceps" tendon="biceps" gear="20"/>')
    gains = ("elbow.gain_biceps.scale", -0.25), ("elbow.gain_triceps.scale", 0.1)
    made, model = patched(tmp_path, text, *gains, ("elbow.lag.time", 0.009))
    assert model.actuator("biceps").gear[0] == pytest.approx(15.0)
    assert model.actuator("triceps").gainprm[2] == pytest.approx(1.1 * PEAKS_N["triceps"])
    (left_out,) = made.left_out
    assert left_out.startswith("elbow.lag.time = 0.009: the MJCF has no place for it")


def test_the_patch_holds_the_gain_of_one_and_the_lag_of_both(tmp_path):
    made, model = patched(tmp_path, segment(), ("far.gain_left.scale", -0.25), ("far.lag.time", 0.08))
    assert model.actuator_gainprm[:, 0].tolist() == [0.75, 1.0]
    assert model.actuator_dynprm[:, 0].tolist() == [0.08, 0.08]
    assert made.left_out == ()


def test_the_patch_has_one_size_of_each_parameter(tmp_path):
    gains = ("knuckle.gain.scale", -0.2), ("middle.gain.scale", -0.1), ("middle.position_gain.scale", 0.1)
    _, model = patched(tmp_path, finger(), *gains, ("knuckle.ceiling.limit", 0.4), ("middle.ceiling.limit", 0.24))
    actuator = model.actuator("flexor")
    assert actuator.gainprm[0] == pytest.approx(3 * 0.85 * 1.1)
    assert actuator.biasprm[2] == pytest.approx(-0.1 * 0.85)
    assert actuator.forcerange.tolist() == pytest.approx([-0.7, 0.7])


def test_a_muscle_without_a_force_gets_that_of_its_scale(tmp_path):
    text = arm(biceps='<muscle name="biceps" tendon="biceps" lengthrange="0.18 0.34" scale="30"/>')
    before = mujoco.MjModel.from_xml_string(text).actuator("biceps")
    _, model = patched(tmp_path, text, ("elbow.gain_biceps.scale", -0.5))
    assert model.actuator("biceps").gainprm[2] == pytest.approx(0.5 * before.gainprm[3] / before.acc0[0], rel=1e-5)


def at_run_time(folder, text, *parameters):
    """Return a simulation of a model with effects, and its data."""
    model, file = folder / "robot.xml", folder / "verdict.json"
    model.write_text(text)
    file.write_text(with_parameters([(path, size, "s") for path, size in parameters]).model_dump_json())
    effects, robot = RuntimeEffects.read(file, model), mujoco.MjModel.from_xml_path(str(model))
    data = mujoco.MjData(robot)
    return Simulation(effects, robot, data), data


def test_at_run_time_each_actuator_receives_its_own_command(tmp_path):
    simulation, data = at_run_time(tmp_path, segment(), ("far.deadband.width", 0.1))
    simulation.step(np.array([3.0, 4.0]))
    assert data.ctrl.tolist() == [3.0, 4.0]


@pytest.mark.parametrize(
    ("text", "late"),
    [
        (alone(), [("elbow.dead_time.delay", 0.02)]),
        (finger(), [("middle.dead_time.delay", 0.02)]),
        (finger(), [("middle.dead_time.delay", 0.03), ("knuckle.dead_time.delay", 0.01)]),
    ],
    ids=["muscle alone", "tendon", "mean of its joints"],
)
def test_at_run_time_an_actuator_is_late_for_all_its_joints(tmp_path, text, late):
    simulation, data = at_run_time(tmp_path, text, *late)
    sent = []
    for k in range(40):
        simulation.step(np.full(len(data.ctrl), 0.01 * k))
        sent.append(data.ctrl[-1])
    assert sent[30:] == pytest.approx(0.01 * np.arange(10, 20))


def test_effects_of_no_single_actuator_or_joint_are_refused_at_run_time(tmp_path):
    with pytest.raises(TrialError, match="left and right move far, and this effect acts on one actuator at run time"):
        at_run_time(tmp_path, segment(), ("far.dead_time.delay", 0.02))
    with pytest.raises(TrialError, match=r"middle.deadband.width: flexor moves middle and knuckle, and this effect"):
        at_run_time(tmp_path, finger(), ("middle.deadband.width", 0.1))


@pytest.mark.parametrize(
    ("robot", "seconds", "weak", "share", "index", "names"),
    [
        pytest.param(MUSCLES, 14.0, "biceps", 0.8, 2, ["elbow.gain_biceps"], marks=pytest.mark.slow, id="muscle"),
        pytest.param(
            BELLOWS, 10.0, "right", 0.75, 0, ["far.gain_right", "near.gain_right"], marks=pytest.mark.prove, id="bellow"
        ),
        pytest.param(
            TENDON, 10.0, "flexor", 0.7, 0, ["knuckle.gain", "middle.gain"], marks=pytest.mark.prove, id="tendon"
        ),
    ],
)
def test_a_weak_actuator_is_named_with_one_size_and_patched(tmp_path, robot, seconds, weak, share, index, names):
    file = robot.recorded(tmp_path, seconds, change=partial(weaken, name=weak, share=share), trials=3)
    verdict = diagnose_table(tables.read(file)).verdict
    assert sorted(effect.name for effect in verdict.effects) == names
    for effect in verdict.effects:
        size = effect.parameters["scale"]
        assert size.low <= share - 1 <= size.high
        assert effect.shared_by == tuple(name.partition(".")[0] for name in names if len(names) > 1)
    made = patch.patched(tmp_path / "robot.xml", verdict, calibration=False)
    before, after = (mujoco.MjModel.from_xml_string(text).actuator(weak) for text in (robot.text, made.text))
    assert after.gainprm[index] == pytest.approx(share * before.gainprm[index], rel=0.03)


@pytest.mark.prove
def test_the_size_of_a_soft_loop_allows_for_the_tolerance_of_its_gain(tmp_path):
    def soft(robot):
        robot.actuator_gainprm[:] *= 1.02 * 0.7
        robot.actuator_biasprm[:, 1:] *= 1.02 * np.array([0.7, *[1.0] * 8])

    file = TENDON.recorded(tmp_path, 10.0, change=soft, trials=3, noise_rad=2e-4)
    effects = diagnose_table(tables.read(file)).verdict.effects
    assert {effect.name for effect in effects} == {"knuckle.position_gain", "middle.position_gain"}
    size = effects[0].parameters["scale"]
    assert size.low <= -0.3 <= size.high
    assert size.high - size.low < 0.08


@pytest.mark.prove
def test_a_late_actuator_and_late_readings_of_all_joints_are_one_set(tmp_path):
    verdict = diagnose_table(tables.read(TENDON.recorded(tmp_path, 10.0, late=4, trials=3))).verdict
    assert {(effect.name, effect.equivalents) for effect in verdict.effects} == {
        ("knuckle.dead_time", ("knuckle.latency",)),
        ("middle.dead_time", ("middle.latency",)),
    }
    assert all(effect.parameters["delay"].value == pytest.approx(0.04, abs=1e-3) for effect in verdict.effects)
