"""Several motors at one joint, such as two bellows that pull against each other."""

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
from tests.diagnosis.rigs.recordings import described_model, noisy, rms, simulate, view_of_joint
from tests.diagnosis.verdicts import with_parameters

JOINTS, BELLOWS = ("near", "far"), ("left", "right")
SEGMENT = """<mujoco><compiler angle="radian"/><option timestep="0.001" integrator="implicitfast"/>
<default><joint axis="0 1 0" damping="0.01" armature="0.0005" stiffness="0.6"/>
<geom type="capsule" size=".015" contype="0" conaffinity="0"/></default>
<worldbody><body name="one"><joint name="near"/><geom fromto="0 0 0 0 0 -.08" mass=".05"/>
<body name="two" pos="0 0 -.08"><joint name="far"/><geom fromto="0 0 0 0 0 -.08" mass=".05"/></body></body></worldbody>
<tendon><fixed name="left"><joint joint="near" coef=".01"/><joint joint="far" coef=".012"/></fixed>
<fixed name="right"><joint joint="near" coef="-.01"/><joint joint="far" coef="-.012"/></fixed></tendon>
<actuator>LEFT RIGHT</actuator></mujoco>"""
BELLOW = '<general name="{0}" tendon="{0}" dyntype="filterexact" dynprm="0.05" ctrllimited="true" ctrlrange="0 30"/>'


def segment(left=BELLOW, right=BELLOW):
    return SEGMENT.replace("LEFT", left.format("left")).replace("RIGHT", right.format("right"))


def recorded(folder, gains=(1.0, 1.0), trials=1, seconds=6.0, model=None):
    """Record a segment whose bellows have other gains, and describe it."""
    robot = mujoco.MjModel.from_xml_string(model or segment())
    robot.actuator_gainprm[:, 0] *= gains
    hertz, t = np.array([0.2, 0.5, 1.1, 2.0]), np.arange(int(100 * seconds)) / 100
    for number in range(trials):
        random = np.random.default_rng(number)
        waves = np.sin(2 * np.pi * hertz * t[:, None, None] + random.uniform(0, 6, (2, 4)))
        commands = np.clip(12 + 4 * waves.sum(axis=2), 0, 30)
        simulate(robot, folder / f"run-{number}.csv", commands, read=noisy(random, 1e-4))
    return described_model(folder, model or segment(), "1")


def test_a_joint_feels_the_sum_of_its_motors_each_within_its_ranges(tmp_path):
    left = '<motor name="{0}" tendon="{0}" gear="-1.5" ctrllimited="true" ctrlrange="-1 2"/>'
    right = '<general name="{0}" tendon="{0}" gainprm="3" biastype="affine" biasprm="0.5 0 0" forcerange="-1 4"/>'
    (tmp_path / "robot.xml").write_text(segment(left, right))
    robot = Mechanism(tmp_path / "robot.xml")
    data, random = mujoco.MjData(robot.model), np.random.default_rng(0)
    for _ in range(50):
        data.ctrl[:] = 3 * random.normal(size=2)
        mujoco.mj_forward(robot.model, data)
        commands = {name: np.array([x]) for name, x in zip(BELLOWS, data.ctrl, strict=True)}
        for name in JOINTS:
            actuator = robot.joint(name).actuator
            torque = actuator.torque(actuator.sent(commands.__getitem__), np.zeros(1), np.zeros(1))
            assert torque == pytest.approx(data.qfrc_actuator[robot.joint(name).dof], abs=1e-12)


@pytest.mark.parametrize("joint", JOINTS)
def test_a_healthy_segment_has_no_gap_to_its_model(tmp_path, joint):
    healthy = view_of_joint(recorded(tmp_path), joint)
    assert rms(healthy) < 5e-4
    assert np.nanstd(healthy.measured) > 0.05


def test_each_motor_has_a_gain_of_its_own_which_belongs_to_all_joints_that_it_moves(tmp_path):
    weak = view_of_joint(recorded(tmp_path, gains=(0.7, 1.0)), "far")
    gaps = {name: rms(weak, {f"far.gain_{name}.scale": -0.3}) for name in BELLOWS}
    assert gaps["left"] < 0.05 * rms(weak) < 0.05 * gaps["right"]
    common = weak.gap([{"actuator left.gain_left.scale": -0.3}])
    assert np.array_equal(common, weak.gap([{"far.gain_left.scale": -0.3}]), equal_nan=True)
    parts = {effect: weak.part(effect) for effect in ("gain_left", "gain_right", "lag", "dead_time")}
    assert parts == {
        "gain_left": "actuator left",
        "gain_right": "actuator right",
        "lag": "actuator left and right",
        "dead_time": "actuator left and right",
    }


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


def test_the_command_of_each_motor_is_needed(tmp_path):
    file = recorded(tmp_path)
    stage = yaml.safe_load(file.read_text())
    del stage["channels"]["command"]["columns"]["right"]
    file.write_text(yaml.safe_dump(stage))
    with pytest.raises(TrialError, match="far is moved by the actuator right, whose command is missing"):
        view_of_joint(file, "far")


def test_a_description_has_the_commands_of_both_and_neither_as_a_reading(tmp_path):
    """The names of the motors hold that of the joint, and are shorter than the name of its readings."""
    names = {"left": "far_l", "right": "far_r"}
    text = segment()
    for old, new in names.items():
        text = text.replace(f'name="{old}"', f'name="{new}"').replace(f'tendon="{old}"', f'tendon="{new}"')
    recorded(tmp_path, model=text)
    run = tmp_path / "run-0.csv"
    run.write_text(run.read_text().replace(",near,far\n", ",near_position,far_position\n"))
    out = tmp_path / "new.yaml"
    succeed("new", "rig", tmp_path / "robot.xml", run, "--out", out)
    channels = yaml.safe_load(out.read_text())["channels"]
    sources = {name: use["source"] for name, use in channels["measured"]["columns"].items()}
    assert sources == {"near": "near_position", "far": "far_position"}
    units = {name: use["unit"] for name, use in channels["command"]["columns"].items()}
    assert units == dict.fromkeys(names.values(), "-")


def test_the_patch_holds_the_gain_of_one_and_the_lag_of_both(tmp_path):
    (tmp_path / "robot.xml").write_text(segment())
    found = with_parameters([("far.gain_left.scale", -0.25, "-"), ("far.lag.time", 80.0, "ms")])
    made = patch.patched(tmp_path / "robot.xml", found, calibration=False)
    model = mujoco.MjModel.from_xml_string(made.text)
    assert model.actuator_gainprm[:, 0].tolist() == [0.75, 1.0]
    assert model.actuator_dynprm[:, 0].tolist() == [0.08, 0.08]
    assert made.left_out == ()


def test_at_run_time_each_receives_its_own_command_and_a_common_delay_is_refused(tmp_path):
    model, file = tmp_path / "robot.xml", tmp_path / "verdict.json"
    model.write_text(segment())
    file.write_text(with_parameters([("far.deadband.width", 0.1, "rad")]).model_dump_json())
    robot = mujoco.MjModel.from_xml_path(str(model))
    data = mujoco.MjData(robot)
    Simulation(RuntimeEffects.read(file, model), robot, data).step(np.array([3.0, 4.0]))
    assert data.ctrl.tolist() == [3.0, 4.0]
    file.write_text(with_parameters([("far.dead_time.delay", 0.02, "s")]).model_dump_json())
    with pytest.raises(TrialError, match="left and right move far, and this effect acts on one actuator at run time"):
        RuntimeEffects.read(file, model)


@pytest.mark.prove
def test_a_weak_bellow_is_named_with_one_size_and_patched(tmp_path):
    verdict = diagnose_table(tables.read(recorded(tmp_path, gains=(1.0, 0.75), trials=3, seconds=10.0))).verdict
    assert {effect.name for effect in verdict.effects} == {"near.gain_right", "far.gain_right"}
    for effect in verdict.effects:
        size = effect.parameters["scale"]
        assert size.low <= -0.25 <= size.high
        assert effect.shared_by == ("far", "near")
    found = patch.patched(tmp_path / "robot.xml", verdict, calibration=False)
    model = mujoco.MjModel.from_xml_string(found.text)
    assert model.actuator_gainprm[:, 0] == pytest.approx([1.0, 0.75], rel=0.05)
