"""Muscles, and other actuators whose strength changes with the motion."""

import mujoco
import numpy as np
import pytest
import yaml

from softarm.diagnosis.data import tables
from softarm.diagnosis.rigs.diagnose import diagnose_table
from softarm.diagnosis.rigs.mjcf import patch
from softarm.diagnosis.rigs.mjcf.mechanism import Mechanism
from softarm.diagnosis.rigs.mjcf.runtime import RuntimeEffects, Simulation
from tests.cli.invoke import succeed
from tests.diagnosis.rigs.recordings import described_model, noisy, rms, simulate, view_of_joint
from tests.diagnosis.verdicts import with_parameters

JOINTS = "shoulder", "elbow"
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


def muscle(name):
    return MUSCLE.format(name, LENGTHS[name], PEAKS_N[name])


def arm(**others):
    """Return a model with two muscles at each joint, or other actuators in their place."""
    return ARM.replace("ACTUATORS", "".join(others.get(name, muscle(name)) for name in PEAKS_N))


def waves(random, seconds):
    """Return commands of an antagonistic pair at each joint, [T, 4]."""
    t, hertz = np.arange(int(100 * seconds)) / 100, random.uniform(0.15, 1.1, (2, 4))
    turns = random.uniform(0, 6, (2, 4))
    pulls = 0.12 * np.clip(np.sin(2 * np.pi * hertz * t[:, None, None] + turns).sum(axis=2) / 2.2, -1, 1)
    return np.clip(0.1 + np.stack((pulls, -pulls), axis=2).reshape(len(t), 4), 0, 1)


def recorded(folder, trials=1, seconds=8.0, late=0, **strengths):
    """Record an arm with muscles of other strengths, by name, which receive their commands samples late."""
    robot = mujoco.MjModel.from_xml_string(arm())
    for name, share in strengths.items():
        robot.actuator(name).gainprm[2] *= share
        robot.actuator(name).biasprm[2] *= share
    for number in range(trials):
        random = np.random.default_rng(number)
        sent, file = waves(random, seconds), folder / f"run-{number}.csv"
        received = np.concatenate((np.tile(sent[:1], (late, 1)), sent[: len(sent) - late]))
        simulate(robot, file, received, read=noisy(random, 2e-4))
        if late:
            rows = np.loadtxt(file, delimiter=",", skiprows=1)
            rows[:, 1:5] = sent
            np.savetxt(file, rows, "%.8g", ",", header=file.read_text().partition("\n")[0], comments="")
    return described_model(folder, arm(), "1")


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
    mechanism = Mechanism(tmp_path / "robot.xml", JOINTS)
    data, rows = mujoco.MjData(mechanism.model), []
    sent = waves(np.random.default_rng(0), 4.0)
    for command in sent:
        data.ctrl[:] = command
        mujoco.mj_forward(mechanism.model, data)
        rows.append((data.qpos.copy(), data.qvel.copy(), data.qacc.copy(), data.qfrc_actuator.copy()))
        mujoco.mj_step(mechanism.model, data, nstep=10)
    position, speed, acceleration, torque = map(np.array, zip(*rows, strict=True))
    motion = {name: (position[:, k], speed[:, k], acceleration[:, k]) for k, name in enumerate(JOINTS)}
    before = np.concatenate((sent[:1], sent[:-1]))
    for k, joint in enumerate(map(mechanism.joint, JOINTS)):
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


def test_a_loop_that_is_too_fast_for_its_torque_to_show_is_refused(tmp_path):
    for kp, refused in ((4e3, False), (6e3, True)):
        (tmp_path / "robot.xml").write_text(arm(biceps=f'<position name="biceps" tendon="biceps" kp="{kp}"/>'))
        problem = Mechanism(tmp_path / "robot.xml").joint("elbow").problem
        assert ("a position loop may swing at 4 Hz at most" in problem) == refused
        assert ("give its torque under `torque`, as elbow" in problem) == refused


@pytest.mark.parametrize("joint", JOINTS)
def test_a_healthy_arm_has_no_gap_to_its_model(tmp_path, joint):
    healthy = view_of_joint(recorded(tmp_path), joint)
    assert rms(healthy) < 3e-3
    assert np.nanstd(healthy.measured) > 0.1


def test_the_start_is_left_out_until_the_activations_are_known(tmp_path):
    view = view_of_joint(recorded(tmp_path), "elbow")
    assert 0.3 < view.t_s[np.isfinite(view.measured[:, 0])][0] < 0.6


def test_a_weak_muscle_and_a_late_command_explain_the_gap(tmp_path):
    weak = view_of_joint(recorded(tmp_path, biceps=0.8), "elbow")
    gaps = {name: rms(weak, {f"elbow.gain_{name}.scale": -0.2}) for name in ("biceps", "triceps")}
    assert gaps["biceps"] < 0.05 * rms(weak) < 0.05 * gaps["triceps"]
    late = view_of_joint(recorded(tmp_path, late=3), "elbow")
    assert rms(late, {"elbow.dead_time.delay": 0.03}) < 0.1 * rms(late)


def test_a_description_has_activations_without_a_unit(tmp_path):
    recorded(tmp_path)
    out = tmp_path / "new.yaml"
    succeed("new", "rig", tmp_path / "robot.xml", tmp_path / "run-0.csv", "--out", out)
    columns = yaml.safe_load(out.read_text())["channels"]["command"]["columns"]
    assert {name: use["unit"] for name, use in columns.items()} == dict.fromkeys(PEAKS_N, "-")


def test_the_patch_holds_the_gain_of_a_muscle_and_of_a_motor(tmp_path):
    file = tmp_path / "robot.xml"
    file.write_text(arm(biceps='<motor name="biceps" tendon="biceps" gear="20"/>'))
    gains = [("elbow.gain_biceps.scale", -0.25, "-"), ("elbow.gain_triceps.scale", 0.1, "-")]
    made = patch.patched(file, with_parameters([*gains, ("elbow.lag.time", 9, "ms")]), calibration=False)
    model = mujoco.MjModel.from_xml_string(made.text)
    assert model.actuator("biceps").gear[0] == pytest.approx(15.0)
    assert model.actuator("triceps").gainprm[2] == pytest.approx(1.1 * PEAKS_N["triceps"])
    assert len(made.left_out) == 1
    assert made.left_out[0].startswith("elbow.lag.time = 0.009: the MJCF has no place for it")


def test_a_muscle_without_a_force_gets_that_of_its_scale(tmp_path):
    file = tmp_path / "robot.xml"
    file.write_text(arm(biceps='<muscle name="biceps" tendon="biceps" lengthrange="0.18 0.34" scale="30"/>'))
    before = mujoco.MjModel.from_xml_path(str(file)).actuator("biceps")
    made = patch.patched(file, with_parameters([("elbow.gain_biceps.scale", -0.5, "-")]), calibration=False)
    after = mujoco.MjModel.from_xml_string(made.text).actuator("biceps")
    assert after.gainprm[2] == pytest.approx(0.5 * before.gainprm[3] / before.acc0[0], rel=1e-5)


def alone():
    """Return a model whose elbow has the biceps alone, against gravity."""
    return arm(triceps="").replace('damping="0.1"', 'damping="0.1" stiffness="2"')


def test_a_command_of_a_muscle_alone_may_be_named_after_its_joint(tmp_path):
    robot = mujoco.MjModel.from_xml_string(alone())
    simulate(robot, tmp_path / "run.csv", waves(np.random.default_rng(0), 4.0)[:, :3])
    (tmp_path / "robot.xml").write_text(alone())
    run = tmp_path / "run.csv"
    run.write_text(run.read_text().replace(",biceps,", ",elbow_command,"))
    out = tmp_path / "new.yaml"
    succeed("new", "rig", tmp_path / "robot.xml", run, "--out", out)
    column = yaml.safe_load(out.read_text())["channels"]["command"]["columns"]["biceps"]
    assert column == {"source": "elbow_command", "unit": "-"}


def test_at_run_time_a_muscle_alone_receives_its_command_late(tmp_path):
    model, file = tmp_path / "robot.xml", tmp_path / "verdict.json"
    model.write_text(alone())
    file.write_text(with_parameters([("elbow.dead_time.delay", 0.02, "s")]).model_dump_json())
    robot = mujoco.MjModel.from_xml_path(str(model))
    data, sent = mujoco.MjData(robot), []
    simulation = Simulation(RuntimeEffects.read(file, model), robot, data)
    for k in range(40):
        simulation.step(np.array([0.0, 0.0, 0.01 * k]))
        sent.append(data.ctrl[2])
    assert sent[30:] == pytest.approx(0.01 * np.arange(10, 20))


@pytest.mark.slow
def test_a_weak_muscle_is_named_with_its_size_and_patched(tmp_path):
    file = recorded(tmp_path, trials=3, seconds=14.0, biceps=0.8)
    verdict = diagnose_table(tables.read(file)).verdict
    (effect,) = verdict.effects
    assert effect.name == "elbow.gain_biceps"
    assert effect.parameters["scale"].low <= -0.2 <= effect.parameters["scale"].high
    made = patch.patched(tmp_path / "robot.xml", verdict, calibration=False)
    model = mujoco.MjModel.from_xml_string(made.text)
    assert model.actuator("biceps").gainprm[2] == pytest.approx(0.8 * PEAKS_N["biceps"], rel=0.03)
