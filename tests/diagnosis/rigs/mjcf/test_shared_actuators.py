"""Actuators on tendons over several joints that move on their own, such as a finger's."""

import mujoco
import numpy as np
import pytest

from softarm.diagnosis.data import tables
from softarm.diagnosis.data.trials import TrialError
from softarm.diagnosis.rigs import whole
from softarm.diagnosis.rigs.diagnose import diagnose_table
from softarm.diagnosis.rigs.mjcf import patch
from softarm.diagnosis.rigs.mjcf.mechanism import Mechanism
from softarm.diagnosis.rigs.mjcf.runtime import RuntimeEffects, Simulation
from softarm.diagnosis.rigs.stage import view_of
from tests.diagnosis.rigs.recordings import described, rms, view_of_joint
from tests.diagnosis.verdicts import with_parameters

RATIOS = {"knuckle": 0.5, "middle": 0.4}
LOOP = '<position name="flexor" tendon="flexor" kp="3" kv="0.1" forcerange="-1 1"/>'
FINGER = """
<mujoco><compiler angle="radian"/><option timestep="0.001" integrator="implicitfast"/>
<default><joint axis="0 1 0" damping="0.01" armature="0.001" stiffness="0.3"/>
<geom type="capsule" size="0.008" contype="0" conaffinity="0"/></default>
<worldbody><body name="proximal"><joint name="knuckle"/><geom fromto="0 0 0 0 0 -0.08" mass="0.08"/>
<site name="near" pos="0.01 0 -0.07"/><body name="tip" pos="0 0 -0.08"><joint name="middle" stiffness="0.2"/>
<geom fromto="0 0 0 0 0 -0.06" mass="0.05"/><site name="far" pos="0.01 0 -0.05"/></body></body></worldbody>
<tendon>TENDON</tendon><actuator>ACTUATOR</actuator></mujoco>"""
FIXED = "".join(f'<joint joint="{joint}" coef="{ratio}"/>' for joint, ratio in RATIOS.items())
FIXED = f'<fixed name="flexor">{FIXED}</fixed>'


def finger(actuator=LOOP):
    return FINGER.replace("TENDON", FIXED).replace("ACTUATOR", actuator)


def recorded(
    folder, model, gain=1.0, stiff=1.0, late=0, size=0.25, noise_rad=5e-5, seconds=5.0, trials=3, columns=tuple(RATIOS)
):
    """Record a finger with another gain, whose actuator receives commands samples late, and describe it."""
    (folder / "finger.xml").write_text(model)
    robot = mujoco.MjModel.from_xml_string(model)
    robot.actuator_gainprm[:] *= gain * stiff
    robot.actuator_biasprm[:] *= gain
    robot.actuator_biasprm[:, 1] *= stiff
    for number in range(trials):
        data, random, rows = mujoco.MjData(robot), np.random.default_rng(number), []
        turns, hertz = random.uniform(0, 6, 4), np.array([0.3, 0.7, 1.3, 2.1])
        t = 0.01 * np.arange(int(100 * seconds))
        commands = size * np.sin(2 * np.pi * hertz * t[:, None] + turns).sum(axis=1)
        for k in range(len(t)):
            data.ctrl[0] = commands[max(k - late, 0)]
            rows.append((t[k], commands[k], *(data.qpos + noise_rad * random.normal(size=2))))
            mujoco.mj_step(robot, data, nstep=10)
        header = ",".join(("t", "flexor", *RATIOS))
        np.savetxt(folder / f"run-{number}.csv", rows, "%.6f", ",", header=header, comments="")
    return described(folder, "finger.xml", measured=dict.fromkeys(columns, "rad"), command={"flexor": "1"})


@pytest.mark.parametrize("ratio", [1, -2])
def test_each_joint_feels_the_actuator_as_mujoco_moves_it(tmp_path, ratio):
    """The gear and the force range count as well."""
    (tmp_path / "finger.xml").write_text(finger(LOOP.replace("/>", f' gear="{ratio}"/>')))
    robot = Mechanism(tmp_path / "finger.xml")
    data, random = mujoco.MjData(robot.model), np.random.default_rng(0)
    for _ in range(50):
        data.qpos[:], data.qvel[:], data.ctrl[0] = random.normal(size=2), random.normal(size=2), random.normal()
        mujoco.mj_forward(robot.model, data)
        for name in RATIOS:
            joint = robot.joint(name)
            (other,) = joint.actuator.others
            length, speed = (joint.actuator.others[other] * x[robot.joint(other).dof] for x in (data.qpos, data.qvel))
            place, rate = data.qpos[joint.position], data.qvel[joint.dof]
            felt = place + length / joint.actuator.gear, rate + speed / joint.actuator.gear
            torque = joint.actuator.torque(data.ctrl[0], *felt)
            assert torque == pytest.approx(data.qfrc_actuator[joint.dof], abs=1e-12)


@pytest.mark.parametrize("actuator", [LOOP, '<motor name="flexor" tendon="flexor"/>'])
def test_a_healthy_finger_has_no_gap_to_its_model(tmp_path, actuator):
    """Half a step of MuJoCo remains: 0.5 ms at 3 rad/s."""
    stage = recorded(tmp_path, finger(actuator), trials=1)
    for name in RATIOS:
        view = view_of_joint(stage, name)
        assert rms(view) < 3e-3
        assert np.nanstd(view.measured) > 0.1


def test_a_delay_of_the_command_leaves_the_motion_of_the_other_joint_in_time(tmp_path):
    view = view_of_joint(recorded(tmp_path, finger(), trials=1, late=3), "middle")
    now, late = (rms(view, {"middle.dead_time.delay": delay_s}) for delay_s in (0.0, 0.03))
    assert now > 0.02
    assert late < 3e-3


def test_its_gain_and_delay_belong_to_all_joints_that_it_moves(tmp_path):
    view = view_of_joint(recorded(tmp_path, finger(), trials=1), "middle")
    assert {view.part(effect) for effect in ("gain", "position_gain", "lag", "dead_time")} == {"actuator flexor"}
    common, own = (view.gap([{f"{owner}.gain.scale": -0.2}]) for owner in ("actuator flexor", "middle"))
    assert np.array_equal(common, own, equal_nan=True)


@pytest.mark.prove
def test_a_weak_actuator_is_one_effect_with_one_size(tmp_path):
    verdict = diagnose_table(tables.read(recorded(tmp_path, finger(), gain=0.7, seconds=10.0))).verdict
    assert {effect.name for effect in verdict.effects} == {"knuckle.gain", "middle.gain"}
    for effect in verdict.effects:
        size = effect.parameters["scale"]
        assert size.low <= -0.3 <= size.high
        assert effect.shared_by == ("knuckle", "middle")
    found = patch.patched(tmp_path / "finger.xml", verdict, calibration=False)
    model = mujoco.MjModel.from_xml_string(found.text)
    assert model.actuator("flexor").gainprm[0] == pytest.approx(2.1, rel=0.03)


@pytest.mark.prove
def test_the_size_of_a_soft_loop_allows_for_the_tolerance_of_its_gain(tmp_path):
    file = recorded(tmp_path, finger(), gain=1.02, stiff=0.7, seconds=10.0, noise_rad=2e-4)
    effects = diagnose_table(tables.read(file)).verdict.effects
    assert {effect.name for effect in effects} == {"knuckle.position_gain", "middle.position_gain"}
    size = effects[0].parameters["scale"]
    assert size.low <= -0.3 <= size.high
    assert size.high - size.low < 0.08


def test_a_tolerance_of_an_actuator_is_one_for_all_its_joints(tmp_path):
    stage = recorded(tmp_path, finger(), trials=1)
    views = [view_of_joint(stage, name) for name in RATIOS]
    stages = [*RATIOS]
    loaded = {("gain", "actuator flexor"): stages, ("position_gain", "actuator flexor"): stages}
    judged = {f"{name}.{effect}" for effect, _ in loaded for name in stages}
    found = [n.path for n in whole.tolerated(views, loaded, judged) if "gain" in n.path]
    assert found == ["actuator flexor.gain.scale", "actuator flexor.position_gain.scale"]


@pytest.mark.prove
def test_a_late_actuator_and_late_readings_of_all_joints_are_one_set(tmp_path):
    verdict = diagnose_table(tables.read(recorded(tmp_path, finger(), late=4, seconds=10.0))).verdict
    assert {(effect.name, effect.equivalents) for effect in verdict.effects} == {
        ("knuckle.dead_time", ("knuckle.latency",)),
        ("middle.dead_time", ("middle.latency",)),
    }
    assert all(effect.parameters["delay"].value == pytest.approx(0.04, abs=1e-3) for effect in verdict.effects)


def test_the_patch_has_one_size_of_each_parameter(tmp_path):
    (tmp_path / "finger.xml").write_text(finger())
    changes = [
        ("knuckle.gain.scale", -0.2, "-"),
        ("middle.gain.scale", -0.1, "-"),
        ("middle.position_gain.scale", 0.1, "-"),
        ("knuckle.ceiling.limit", 0.4, "N m"),
        ("middle.ceiling.limit", 0.24, "N m"),
    ]
    found = patch.patched(tmp_path / "finger.xml", with_parameters(changes), calibration=True)
    actuator = mujoco.MjModel.from_xml_string(found.text).actuator("flexor")
    assert actuator.gainprm[0] == pytest.approx(3 * 0.85 * 1.1)
    assert actuator.biasprm[2] == pytest.approx(-0.1 * 0.85)
    assert actuator.forcerange.tolist() == pytest.approx([-0.7, 0.7])


def test_an_effect_on_the_error_of_a_common_loop_is_refused_at_run_time(tmp_path):
    model, file = tmp_path / "finger.xml", tmp_path / "verdict.json"
    model.write_text(finger())
    file.write_text(with_parameters([("middle.deadband.width", 0.1, "rad")]).model_dump_json())
    with pytest.raises(TrialError, match=r"middle.deadband.width: flexor moves middle and knuckle, and this effect"):
        RuntimeEffects.read(file, model)
    file.write_text(with_parameters([("middle.dead_time.delay", 0.02, "s")]).model_dump_json())
    effects = RuntimeEffects.read(file, model)
    assert effects.parameters.dead_time_s.tolist() == [0.02, 0.02]  # it is the actuator that is late
    robot = mujoco.MjModel.from_xml_path(str(model))
    data = mujoco.MjData(robot)
    simulation = Simulation(effects, robot, data)
    sent = []
    for k in range(40):
        simulation.step(np.array([0.01 * k]))
        sent.append(data.ctrl[0])
    assert sent[30:] == pytest.approx(0.01 * np.arange(10, 20))
    both = with_parameters([("middle.dead_time.delay", 0.02, "s"), ("knuckle.dead_time.delay", 0.01, "s")])
    file.write_text(both.model_dump_json())
    assert RuntimeEffects.read(file, model).parameters.dead_time_s.tolist() == [0.015, 0.015]


def test_a_joint_that_no_column_measures_is_required(tmp_path):
    file = recorded(tmp_path, finger(), trials=1, columns=("middle",))
    with pytest.raises(TrialError, match="flexor moves middle and knuckle, which no column measures; add it to"):
        view_of(tables.read(file))


def test_samples_before_a_slow_actuator_has_forgotten_its_start_are_left_out(tmp_path):
    """The recording begins with a command that the actuator has not reached."""
    muscle = '<general name="flexor" tendon="flexor" dyntype="filterexact" dynprm="0.3" biastype="affine"/>'
    view = view_of_joint(recorded(tmp_path, finger(muscle), trials=1), "middle")
    seen = np.isfinite(view.measured[:, 0])
    assert 0.8 < view.t_s[seen][0] < 1.5
    assert rms(view) < 3e-3


@pytest.mark.parametrize("lag", ["", ' dyntype="filterexact" dynprm="0.3"'])
def test_a_muscle_that_bends_springs_of_the_model_is_no_position_loop(tmp_path, lag):
    """The torque is nearly a multiple of the angle."""
    muscle = f'<general name="flexor" tendon="flexor"{lag}/>'
    stiff = finger(muscle).replace('stiffness="0.', 'stiffness="10.')
    stage = recorded(tmp_path, stiff, size=5.0, trials=1)
    assert [view_of_joint(stage, name).assumptions for name in RATIOS] == [(), ()]
