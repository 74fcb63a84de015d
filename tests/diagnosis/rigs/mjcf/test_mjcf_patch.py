"""The patched MJCF: only the named attributes change, and MuJoCo reads the new numbers."""

import tempfile
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from softarm.diagnosis.rigs.mjcf import patch
from softarm.diagnosis.rigs.mjcf.mechanism import Mechanism
from tests.diagnosis.verdicts import with_parameters as verdict
from validation.mechanisms.record import ROBOTS

ARM = ROBOTS["arm"].model


def read(found, folder):
    """Return the patched model as MuJoCo reads it."""
    (folder / "patched.xml").write_text(found.text)
    return mujoco.MjModel.from_xml_path(str(folder / "patched.xml"))


def edited(folder, text, changes=(), calibration=()):
    """Return the patch of a model's text, and the patched model."""
    (folder / "arm.xml").write_text(text)
    found = patch.patched(folder / "arm.xml", verdict(changes, calibration), calibration=True)
    return found, read(found, folder)


def test_attributes_of_joint_and_actuator_are_written_and_nothing_else_changes(tmp_path):
    changes = [
        ("elbow.coulomb_friction.torque", 120.0, "mN m"),
        ("wrist.damping.viscous", 0.2, "N m s/rad"),
        ("shoulder.position_gain.scale", -0.25, "-"),
        ("elbow.ceiling.limit", 2.5, "N m"),
    ]
    found = patch.patched(ARM, verdict(changes), calibration=True)
    before, after = ARM.read_text().splitlines(), found.text.splitlines()
    assert len(before) == len(after)
    assert sum(one != other for one, other in zip(before, after, strict=True)) == 5
    assert found.diff.count("\n+") == 6  # with the header; the shoulder's friction holds
    model = read(found, tmp_path)
    assert model.dof_frictionloss[model.joint("elbow").dofadr[0]] == pytest.approx(0.12)
    assert model.dof_damping[model.joint("wrist").dofadr[0]] == pytest.approx(0.2)
    assert model.actuator("shoulder_servo").gainprm[0] == pytest.approx(30)
    assert model.actuator("shoulder_servo").biasprm[1] == pytest.approx(-30)
    assert model.actuator("elbow_servo").forcerange.tolist() == [-2.5, 2.5]


FRICTION_N_M = 1.5 * 0.5 * 9.81 * 0.2  # holds the link of the next test


@pytest.mark.parametrize("own", [True, False], ids=["of the model", "found"])
@pytest.mark.parametrize(("creeping", "moved_rad"), [((), 2e-4), (("elbow",), 0.02)])
def test_friction_holds_a_weight_unless_the_recordings_show_that_it_creeps(tmp_path, own, creeping, moved_rad):
    file = tmp_path / "arm.xml"
    friction = f'frictionloss="{FRICTION_N_M}"' if own else ""
    file.write_text(
        f"""<mujoco><worldbody><body><joint name="elbow" axis="0 1 0" ref="90" {friction}/>
        <inertial pos="0.2 0 0" mass="0.5" diaginertia="1e-3 1e-3 1e-3"/></body></worldbody></mujoco>"""
    )
    change = ("damping.viscous", 1e-3, "N m s/rad") if own else ("coulomb_friction.torque", FRICTION_N_M, "N m")
    found = verdict([(f"elbow.{change[0]}", *change[1:])]).model_copy(update={"creeping": creeping})
    model = read(patch.patched(file, found, calibration=True), tmp_path)
    data = mujoco.MjData(model)
    start = float(data.qpos[0])
    mujoco.mj_step(model, data, nstep=1000)
    moved = abs(float(data.qpos[0]) - start)
    assert moved > moved_rad if creeping else moved < moved_rad


ACTUATED = """<mujoco>{}<worldbody><body name="link"><joint name="elbow" axis="0 1 0"/>
<geom size="0.1" pos="0.2 0 0" mass="2"/></body></worldbody><actuator>{}</actuator></mujoco>"""


def test_an_equality_with_the_name_of_a_joint_is_no_joint(tmp_path):
    text = ACTUATED.format('<equality><joint name="elbow" joint1="elbow"/></equality>', "")
    _, after = edited(tmp_path, text, [("elbow.damping.viscous", 0.2, "N m s/rad")])
    assert np.ravel(after.dof_damping)[0] == pytest.approx(0.2)


DEFAULTS = (
    "",
    '<default><position kp="50" kv="2" timeconst="0.2"/></default>',
    '<default><position kp="50" dampratio="1" forcerange="-9 9"/></default>',
    '<default><general gainprm="7" biastype="affine" biasprm="1 -7 -1"/></default>',
    '<default><joint damping="0.3" frictionloss="0.1" armature="0.02" stiffness="0.4"/></default>',
    '<default><motor gear="3" forcerange="-8 8"/><joint actuatorfrcrange="-7 7"/></default>',
)
ACTUATORS = (
    '<motor joint="elbow"{}/>',
    '<position name="m" joint="elbow"{}/>',
    '<position joint="elbow" kp="10" kv="1" timeconst="0.05"{}/>',
    '<position joint="elbow" kp="10" dampratio="1"{}/>',
    '<velocity joint="elbow" kv="3"{}/>',
    '<general joint="elbow" gainprm="10" biastype="affine" biasprm="3 -10 -2"{}/>',
    '<general name="m" joint="elbow"{}/>',
)
FURTHER = "", ' gear="2"', ' gear="-3"', ' gear="2" forcerange="-4 6"'
SIZES = {
    "gain.scale": (-0.8, 1.0, "-"),
    "position_gain.scale": (-0.8, 1.0, "-"),
    "lag.time": (0.02, 0.2, "s"),
    "ceiling.limit": (1.0, 10.0, "N m"),
    "damping.viscous": (0.0, 1.0, "N m s/rad"),
    "coulomb_friction.torque": (0.0, 1.0, "N m"),
    "armature.inertia": (0.0, 0.1, "kg m^2"),
    "spring.stiffness": (0.0, 2.0, "N m/rad"),
}
SLOWER = {"gain.scale": -0.5, "lag.time": 0.1}
LOOP = {**SLOWER, "position_gain.scale": 0.2}
ONE = st.sampled_from


@settings(max_examples=20)
@given(
    ONE(DEFAULTS),
    ONE(ACTUATORS),
    ONE(FURTHER),
    st.fixed_dictionaries({}, optional={path: st.floats(low, high) for path, (low, high, _) in SIZES.items()}),
)
@example(DEFAULTS[1], ACTUATORS[0], "", {"lag.time": 0.1})  # took the position loop of its defaults
@example("", ACTUATORS[0], FURTHER[3], {"gain.scale": -0.5})  # its gear changed what its limit means at the joint
@example(DEFAULTS[5], ACTUATORS[2], "", {"ceiling.limit": 8.0})  # ended at the lower limit of the joint
@example("", ACTUATORS[3], "", {"armature.inertia": 0.1})  # MuJoCo computed another damper from the inertia
@example("", ACTUATORS[3], "", LOOP)
@example("", ACTUATORS[5], "", LOOP)
@example("", '<motor joint="elbow" gear="4"></motor>', "", SLOWER)
@example("", ACTUATORS[4], "", SLOWER)
@example("", ACTUATORS[1], FURTHER[1], {"position_gain.scale": -0.5, "ceiling.limit": 5.0})
@example('<compiler autolimits="false"/>', ACTUATORS[0], "", {"ceiling.limit": 2.0})
def test_a_patched_model_has_the_parameters_that_were_found(defaults, actuator, further, sizes):
    with tempfile.TemporaryDirectory() as folder:
        file, patched = Path(folder) / "arm.xml", Path(folder) / "patched.xml"
        file.write_text(ACTUATED.format(defaults, actuator.format(further)))
        before = Mechanism(file).joint("elbow")
        if not before.actuator.kp:
            sizes.pop("position_gain.scale", None)
        if "velocity" in actuator:
            sizes.pop("lag.time", None)
        changes = [(f"elbow.{path}", size, SIZES[path][2]) for path, size in sizes.items()]
        found = patch.patched(file, verdict(changes), calibration=True)
        patched.write_text(found.text if changes else file.read_text())
        model = Mechanism(patched)
    after = model.joint("elbow")
    assert not (found and found.left_out)
    if "lag.time" in sizes:
        assert model.model.actuator_dyntype[0] == int(mujoco.mjtDyn.mjDYN_FILTEREXACT)
    old, new, limit = before.actuator, after.actuator, sizes.get("ceiling.limit")
    factor = 1 + sizes.get("gain.scale", 0.0)
    stiff = factor * (1 + sizes.get("position_gain.scale", 0.0))
    low, high = (-limit, limit) if limit else (old.low, old.high)
    pairs = (
        (new.scale, stiff * old.scale),
        (new.offset, stiff * old.offset),
        (new.kp, stiff * old.kp),
        (new.kd, factor * old.kd),
        (new.low, low),
        (new.high, high),
        (new.lag_s, sizes.get("lag.time", old.lag_s)),
        (after.viscous, sizes.get("damping.viscous", before.viscous)),
        (after.dry, sizes.get("coulomb_friction.torque", before.dry)),
        (after.armature, sizes.get("armature.inertia", before.armature)),
        (after.spring, sizes.get("spring.stiffness", before.spring)),
    )
    for found_size, size in pairs:
        assert found_size == pytest.approx(size, rel=1e-4, abs=1e-9)


@pytest.mark.parametrize("include", [True, False], ids=["include", "comment"])
def test_a_file_that_cannot_be_edited_is_replaced_by_one_of_mujoco(tmp_path, include):
    """One that includes another file, and one with a comment that only MuJoCo reads."""
    file, robot = tmp_path / "scene.xml", ACTUATED.format("", '<position joint="elbow" kp="10"/>')
    (tmp_path / "robot.xml").write_text(robot)
    scene = '<mujoco><include file="robot.xml"/></mujoco>'
    file.write_text(scene if include else robot.replace("<worldbody>", "<!-- 1 -- 2 --><worldbody>"))
    changes = [("elbow.damping.viscous", 0.2, "N m s/rad"), ("elbow.gain.scale", -0.5, "-")]
    found = patch.patched(file, verdict(changes), calibration=True)
    model = read(found, tmp_path)
    assert not found.left_out
    assert (np.ravel(model.dof_damping)[0], model.actuator_gainprm[0, 0]) == pytest.approx((0.2, 5))


@pytest.mark.parametrize(("mode", "mass_kg"), [("auto", 2.2), ("true", 2.0)])
def test_the_mass_of_a_body_without_inertia_of_its_own_is_written_or_reported(tmp_path, mode, mass_kg):
    text = ACTUATED.format(f'<compiler inertiafromgeom="{mode}"/>', "")
    found, after = edited(tmp_path, text, [("elbow.mass_link.scale", 0.1, "-")])
    body, old = after.body("link"), mujoco.MjModel.from_xml_string(text).body("link")
    assert body.mass[0] == pytest.approx(mass_kg)
    assert body.inertia == pytest.approx(old.inertia * mass_kg / 2, rel=1e-4)
    assert body.ipos == pytest.approx(old.ipos)
    left_out = ("mass of link x 1.1: its geoms define it; change theirs",)
    assert found.left_out == (left_out if mode == "true" else ())


def test_a_finding_that_the_file_cannot_express_is_left_out_with_its_remedy(tmp_path):
    text = ACTUATED.format("", '<position jointinparent="elbow" kp="10" dampratio="1"/>')
    text = text.replace('<body name="link">', "<body>")
    before = mujoco.MjModel.from_xml_string(text)
    changes = [("elbow.mass_body1.scale", 0.1, "-"), ("elbow.payload.mass", 0.2, "kg"), ("elbow.gain.scale", 0.1, "-")]
    found, _ = edited(tmp_path, text, changes)
    assert found.text == text
    unnamed = "the body has no name; name it in the model and diagnose again"
    assert found.left_out == (
        "elbow.gain.scale = 0.1: the MJCF has no place for it; --patch FILE.yaml writes it",
        f"mass of body1 x 1.1: {unnamed}",
        f"payload of 0.2 kg at body1: {unnamed}, or --patch FILE.yaml writes it",
        f"the damper of elbow: its dampratio gives another one; write kv={-before.actuator_biasprm[0, 2]:.6g} instead",
    )


def test_a_joint_that_another_follows_has_the_friction_and_the_gains_of_both(tmp_path):
    """The tendon of the gripper moves both fingers by half, and 1.2 N of the friction belong to the other finger."""
    changes = [("left.coulomb_friction.torque", 3.0, "N"), ("left.position_gain.scale", -0.2, "-")]
    model = read(patch.patched(ROBOTS["gripper"].model, verdict(changes), calibration=True), tmp_path)
    assert model.dof_frictionloss[model.joint("left").dofadr[0]] == pytest.approx(1.8)
    assert model.dof_frictionloss[model.joint("right").dofadr[0]] == pytest.approx(1.2)
    assert model.actuator("grip_servo").gainprm[0] == pytest.approx(720)


def test_a_payload_that_several_joints_weigh_is_added_once(tmp_path):
    payloads = [
        ("elbow.payload.mass", 0.1, "kg"),
        ("elbow.payload.distance", 0.10, "m"),
        ("shoulder.payload.mass", 0.12, "kg"),
        ("shoulder.payload.distance", 0.14, "m"),
    ]
    found = patch.patched(ARM, verdict(payloads), calibration=True)
    assert not found.left_out
    before, after = mujoco.MjModel.from_xml_path(str(ARM)), read(found, tmp_path)
    (added,) = {after.body(i).name for i in range(after.nbody)} - {before.body(i).name for i in range(before.nbody)}
    assert after.body(added).mass[0] == pytest.approx(0.11)
    assert np.linalg.norm(after.body(added).pos) == pytest.approx(0.12, abs=1e-6)
    assert after.body_mass.sum() == pytest.approx(before.body_mass.sum() + 0.11)
    again = read(patch.patched(tmp_path / "patched.xml", verdict(payloads), calibration=True), tmp_path)
    assert again.body(f"{added}2").mass[0] == pytest.approx(0.11)


@pytest.mark.parametrize("option", ['<option timestep="0.002" integrator="implicitfast"/>', ""])
def test_the_tilt_that_several_joints_feel_turns_gravity_once(tmp_path, option):
    text = ARM.read_text().replace('<option timestep="0.002" integrator="implicitfast"/>', option)
    assert ("<option" in text) == bool(option)
    tilts = [("base.tilt.x", 0.04, "rad"), ("base.tilt.y", -0.02, "rad"), ("shoulder.tilt.x", 0.06, "rad")]
    found, after = edited(tmp_path, text, tilts)
    assert not found.left_out
    x, y, z = after.opt.gravity
    assert np.linalg.norm((x, y, z)) == pytest.approx(9.81, rel=1e-5)
    assert (x, y) == pytest.approx((-0.02 * 9.81, -0.05 * 9.81), rel=3e-3)


def test_the_patch_of_a_urdf_is_an_mjcf_with_the_findings(tmp_path):
    file = tmp_path / "arm.urdf"
    link = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
    joint = '<parent link="a"/><child link="b"/><axis xyz="0 1 0"/><dynamics damping="0.1" friction="0.2"/>'
    file.write_text(
        f'<robot name="r"><link name="a">{link}</link><link name="b">{link}</link>'
        f'<joint name="j" type="continuous">{joint}</joint></robot>'
    )
    changes = [
        ("j.coulomb_friction.torque", 0.3, "N m"),
        ("j.damping.viscous", 0.4, "N m s/rad"),
        ("j.payload.mass", 0.5, "kg"),
        ("j.payload.distance", 0.1, "m"),
        ("j.tilt.y", 0.05, "rad"),
    ]
    found = patch.patched(file, verdict(changes), calibration=True)
    model = read(found, tmp_path)
    assert not found.left_out
    assert (model.dof_frictionloss[0], np.ravel(model.dof_damping)[0]) == pytest.approx((0.3, 0.4))
    assert model.body_mass.sum() == pytest.approx(1.5)
    assert model.opt.gravity == pytest.approx([0.489888, 0, -9.79776])
    assert found.diff.count("\n+") == 4  # header, option, joint, body


def test_a_body_with_another_mass_is_no_average_with_its_calibration(tmp_path):
    changes = [("shoulder.mass_wrist.scale", 0.4, "-"), ("elbow.mass_wrist.scale", 0.4, "-")]
    found = patch.patched(ARM, verdict(changes, [("base.mass_wrist", 0.02, "-")]), calibration=True)
    before, after = mujoco.MjModel.from_xml_path(str(ARM)), read(found, tmp_path)
    assert after.body("wrist").mass[0] == pytest.approx(1.4 * before.body("wrist").mass[0])


def test_the_mass_of_a_part_is_scaled_in_all_its_bodies_with_their_inertia(tmp_path):
    body = '<body name="{}">{}<inertial pos="0 0 0" mass="1" diaginertia="4 3 2"/>'
    link, plate, tip = (
        body.format(name, joint and f'<joint name="{joint}"/>')
        for name, joint in (("link", "j"), ("plate", ""), ("tip", "k"))
    )
    text = f"<mujoco><worldbody>{link}{plate}</body>{tip}</body></body></worldbody></mujoco>"
    _, model = edited(tmp_path, text, calibration=[("j.mass_link", 0.02, "-")])
    assert [model.body(name).mass[0] for name in ("link", "plate", "tip")] == pytest.approx([1.02, 1.02, 1.0])
    assert model.body("plate").inertia == pytest.approx([4.08, 3.06, 2.04])


def test_the_calibration_is_left_out_on_request():
    only = verdict(calibration=[("elbow.damping.viscous", 0.16, "N m s/rad")])
    assert patch.patched(ARM, only, calibration=False) is None
    assert 'damping="0.16"' in patch.patched(ARM, only, calibration=True).text


def test_a_best_fit_takes_the_place_of_its_joints_findings_on_request():
    found = verdict(
        [("elbow.damping.viscous", 0.5, "N m s/rad"), ("wrist.damping.viscous", 0.3, "N m s/rad")],
        [("elbow.armature.inertia", 0.02, "kg m^2")],
        [("elbow.coulomb_friction.torque", 140.0, "mN m")],
    )
    named, best = (patch.patched(ARM, found, calibration=True, best_fit=on) for on in (False, True))
    assert 'damping="0.5"' in named.text
    assert 'armature="0.02"' in named.text
    assert "0.14" not in named.text
    assert 'frictionloss="0.14"' in best.text
    assert "0.5" not in best.diff
    assert 'armature="0.02"' not in best.text
    assert 'damping="0.3"' in best.text
