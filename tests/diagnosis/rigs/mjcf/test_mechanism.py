"""Rigid-body terms, actuators and refusals of a MuJoCo model."""

import os
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from softarm.diagnosis.data.trials import TrialError
from softarm.diagnosis.rigs.laws import joint as laws
from softarm.diagnosis.rigs.mjcf.loads import powers
from softarm.diagnosis.rigs.mjcf.mechanism import Mechanism, mechanism
from validation.mechanisms.record import ROBOTS

EXAMPLE = Path(__file__).parents[4] / "examples/mujoco"


def terms_of(mechanism, name, motion, longer=0.0):
    joint = mechanism.joint(name)
    return mechanism.terms(joint, mechanism.course(joint, motion), longer)


def changes_of(mechanism, name, motion):
    joint = mechanism.joint(name)
    return mechanism.changes(joint, mechanism.course(joint, motion))


@pytest.fixture(scope="module")
def arm():
    return Mechanism(ROBOTS["arm"].model)


@pytest.fixture(scope="module")
def motion(arm):
    random = np.random.default_rng(0)
    return {name: tuple(random.normal(size=(3, 5)) * [[0.5], [1.0], [3.0]]) for name in arm.joints}


@pytest.mark.parametrize("name", ["base", "elbow", "wrist"])
def test_the_terms_give_the_torque_that_mujoco_computes(arm, motion, name):
    joint, terms = arm.joint(name), terms_of(arm, name, motion)
    model = mujoco.MjModel.from_xml_path(str(ROBOTS["arm"].model))
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT) | int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    data = mujoco.MjData(model)
    for k in range(5):
        data.qpos[:], data.qvel[:], data.qacc[:] = np.array(list(motion.values()))[:, :, k].T
        mujoco.mj_inverse(model, data)
        inertia, load, by_position, by_speed = terms[:, k]
        q, v, a = (motion[name][d][k] for d in range(3))
        own = inertia * a + load + by_position * q + by_speed * v + joint.viscous * v
        assert own == pytest.approx(data.qfrc_inverse[joint.dof], rel=1e-6, abs=1e-9)
        matrix = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, matrix, data.qM) if hasattr(data, "qM") else mujoco.mj_fullM(model, data, matrix)
        assert inertia == pytest.approx(matrix[joint.dof, joint.dof], rel=1e-6)


def test_the_slope_by_position_is_the_load_of_another_angle(arm, motion):
    terms = terms_of(arm, "shoulder", motion)
    position, speed, acceleration = motion["shoulder"]
    moved = terms_of(arm, "shoulder", motion | {"shoulder": (position + 0.02, speed, acceleration)})

    def load(of, q):
        return of[laws.LOAD] + of[laws.BY_POSITION] * q + of[laws.BY_SPEED] * speed

    assert load(terms, position + 0.02) == pytest.approx(load(moved, position + 0.02), abs=2e-3)


@pytest.mark.parametrize(
    ("robot", "body", "joint"),
    [("arm", "tool", "shoulder"), ("linkage", "coupler", "crank"), ("drone", "lower", "shoulder")],
    ids=["chain", "closed loop", "floating base"],
)
def test_a_heavier_body_changes_the_terms_as_in_mujoco(robot, body, joint, tmp_path):
    nominal, random = Mechanism(ROBOTS[robot].model), np.random.default_rng(0)
    names = [*nominal.joints, *(column for pose in nominal.poses for column in pose.columns)]
    motion = {name: tuple(random.normal(size=(3, 5)) * [[0.3], [1.0], [3.0]]) for name in names}
    spec, own = mujoco.MjSpec.from_file(str(nominal.path)), nominal.inertial(body)
    changed = spec.body(body)
    changed.explicitinertial, changed.mass, changed.inertia = True, 1.1 * own.mass_kg, 1.1 * own.inertia
    changed.ipos, changed.iquat = own.at, own.quat
    spec.compile()
    (tmp_path / "heavier.xml").write_text(spec.to_xml())
    expected = terms_of(Mechanism(tmp_path / "heavier.xml"), joint, motion) - terms_of(nominal, joint, motion)
    assert 0.1 * changes_of(nominal, joint, motion).parts[body] == pytest.approx(expected, rel=1e-5, abs=1e-6)


def test_a_payload_at_a_distance_is_a_point_mass_in_mujoco(arm, motion, tmp_path):
    link = arm.last_link(arm.joint("elbow"))
    place = link.place((0.11, 0.02, -0.03))
    x, y, z = place
    mass = f'<body pos="{x} {y} {z}"><inertial pos="0 0 0" mass="0.15" diaginertia="1e-12 1e-12 1e-12"/></body>'
    text = arm.path.read_text()
    (tag,) = re.findall(rf'<body name="{link.body}"[^>]*>', text)
    (tmp_path / "loaded.xml").write_text(text.replace(tag, tag + mass))
    found = 0.15 * np.tensordot(powers(place), changes_of(arm, "elbow", motion).point, 1)
    expected = terms_of(Mechanism(tmp_path / "loaded.xml"), "elbow", motion) - terms_of(arm, "elbow", motion)
    assert found == pytest.approx(expected, rel=1e-6, abs=1e-8)


def test_a_longer_link_carries_its_masses_and_the_next_joint_farther_out(tmp_path):
    text = (EXAMPLE / "robot.xml").read_text()
    (tmp_path / "longer.xml").write_text(text.replace(" -0.3", " -0.33"))
    nominal, longer = Mechanism(EXAMPLE / "robot.xml"), Mechanism(tmp_path / "longer.xml")
    t = np.linspace(0, 1, 20)
    motion = {name: (np.sin(t + k), np.cos(3 * t), np.sin(5 * t)) for k, name in enumerate(("shoulder", "elbow"))}
    base, stretched, expected = (
        terms_of(mechanism, "shoulder", motion, share)
        for mechanism, share in ((nominal, 0.0), (nominal, 0.1), (longer, 0.0))
    )
    # MuJoCo gives a capsule's own inertia by its shape, a small part of the change.
    assert np.abs(stretched - expected).max() < 0.05 * np.abs(expected - base).max()
    assert not nominal.carries(nominal.joint("elbow"))


def test_a_tilted_base_turns_gravity_as_a_rotated_body_does(arm, motion, tmp_path):
    text = arm.path.read_text()
    turret = '<body name="turret" pos="0 0 0.1"'
    assert turret in text
    (tmp_path / "tilted.xml").write_text(text.replace(turret, f'{turret} euler="0.03 -0.02 0"'))
    tilted = Mechanism(tmp_path / "tilted.xml")
    for name in ("base", "shoulder", "wrist"):
        change = changes_of(arm, name, motion).tilted
        found = 0.03 * change["x"] - 0.02 * change["y"]
        expected = terms_of(tilted, name, motion) - terms_of(arm, name, motion)
        # The linear change lacks the squares of the angles.
        assert np.abs(found - expected).max() < 0.05 * np.abs(expected).max()


def test_the_base_tilts_about_the_axes_that_gravity_does_not_point_along(tmp_path):
    text = ROBOTS["arm"].model.read_text()
    (tmp_path / "wall.xml").write_text(text.replace("<option ", '<option gravity="0 9.81 0" '))
    (tmp_path / "space.xml").write_text(text.replace("<option ", '<option gravity="0 0 0" '))
    assert [*Mechanism(tmp_path / "wall.xml").level_axes] == ["x", "z"]
    assert not Mechanism(tmp_path / "space.xml").level_axes


def held(model, angles):
    """Return by joint at which samples a contact or limit acts on it; angles: joint -> positions at rest."""
    motion = {name: (np.array(x), np.zeros(3), np.zeros(3)) for name, x in angles.items()}
    return {name: model.held(model.joint(name), model.course(model.joint(name), motion)).tolist() for name in angles}


def test_a_contact_counts_for_the_joints_that_it_loads(tmp_path):
    """A foot on the ground loads hip and ankle, not the other leg; legs that touch load both."""
    leg = (
        '<body name="{0}" pos="0 {1} 1"><joint name="{0}" axis="1 0 0"/><geom type="capsule" size="0.05" '
        'fromto="0 0 0 0 0 -0.8" mass="1"/><body name="{0}_foot" pos="0 0 -0.8"><joint name="{0}_ankle" axis="1 0 0"/>'
        '<geom size="0.1" mass="0.2"/></body></body>'
    )
    ground = '<geom type="plane" size="2 2 0.1" pos="0 0 0.12"/>'
    file = tmp_path / "legs.xml"
    legs = leg.format("left", 0.3) + leg.format("right", -0.3)
    file.write_text(f"<mujoco><worldbody>{ground}{legs}</worldbody></mujoco>")
    model = Mechanism(file)
    # Left foot on the ground, right leg raised; then both raised; then both legs turned towards each other.
    angles = {"left": [0.0, 0.6, -0.35], "right": [-0.6, -0.6, 0.35], "left_ankle": [0.0] * 3, "right_ankle": [0.0] * 3}
    found = held(model, angles)
    assert found["left"] == found["left_ankle"] == [True, False, True]
    assert found["right"] == [False, False, True]


def test_a_limit_of_a_tendon_counts_for_the_joints_that_move_it(tmp_path):
    """A finger's last joint follows within 0.1 rad, a thread from palm to tip is 0.398 m long at most."""
    file = tmp_path / "finger.xml"
    file.write_text("""<mujoco><worldbody><body><joint name="wrist" axis="0 0 1"/><geom size="0.05" mass="1"/>
      <site name="palm" pos="0 0 0.3"/>
      <body pos="0 0 0.1"><joint name="base" axis="0 1 0"/><geom size="0.02" mass="0.1"/>
        <body pos="0 0 0.1"><joint name="last" axis="0 1 0"/><geom size="0.02" mass="0.1"/></body>
        <body><joint name="spread" axis="1 0 0"/><geom size="0.02" mass="0.1"/><site name="tip" pos="0 0 -0.2"/></body>
      </body></body></worldbody>
      <tendon>
        <fixed limited="true" range="-0.1 0.1"><joint joint="base" coef="-1"/><joint joint="last" coef="1"/></fixed>
        <spatial limited="true" range="0 0.398"><site site="palm"/><site site="tip"/></spatial>
      </tendon></mujoco>""")
    model = Mechanism(file)
    # Both within their limits; the last joint ahead; and the tip far away.
    angles = {"wrist": [0.0] * 3, "base": [0.3, 0.0, 0.0], "last": [0.25, 0.2, 0.0], "spread": [0.3, 0.3, 0.0]}
    assert held(model, angles) == {
        "wrist": [False, False, False],
        "base": [False, True, True],
        "last": [False, True, False],
        "spread": [False, False, True],
    }


def test_friction_without_impedance_is_as_soft_as_mujoco_lets_it_be(tmp_path):
    """MuJoCo keeps impedances between mjMINIMP and mjMAXIMP."""
    text = '<joint name="{0}" solimpfriction="{1} {2}" frictionloss="1"/><geom size="0.1"/>'
    bodies = "".join(f"<body>{text.format(*each)}</body>" for each in (("soft", 0, 0), ("same", 1e-4, 1e-4)))
    (tmp_path / "soft.xml").write_text(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    soft, same = (Mechanism(tmp_path / "soft.xml").joint(name) for name in ("soft", "same"))
    assert (soft.softness, soft.yields_per_s) == pytest.approx((same.softness, same.yields_per_s))


def test_an_actuator_is_read_in_the_units_of_its_joint():
    joint = Mechanism(ROBOTS["leg"].model).joint("hip")
    assert (joint.actuator.name, joint.actuator.scale, joint.actuator.kp) == ("hip_motor", 6.0, 0.0)
    servo = Mechanism(ROBOTS["arm"].model).joint("wrist").actuator
    assert (servo.kp, servo.kd, servo.low, servo.high) == (15.0, 0.5, -3.0, 3.0)
    assert Mechanism(ROBOTS["gantry"].model).joint("swing").actuator is None


def test_a_change_of_an_included_file_is_seen(tmp_path):
    scene, robot = tmp_path / "scene.xml", tmp_path / "robot.xml"
    scene.write_text('<mujoco><include file="parts.xml"/></mujoco>')
    (tmp_path / "parts.xml").write_text('<mujoco><include file="robot.xml"/></mujoco>')
    for second, viscous in enumerate((0.1, 0.2)):
        joint = f'<joint name="elbow" damping="{viscous}"/><geom size="0.1"/>'
        robot.write_text(f"<mujoco><worldbody><body>{joint}</body></worldbody></mujoco>")
        os.utime(robot, (second, second))
        assert mechanism(scene).joint("elbow").viscous == viscous


def test_a_model_that_mujoco_refuses_is_refused_with_its_reason(tmp_path):
    file = tmp_path / "model.xml"
    file.write_text("<mujoco><worldbody><body></mujoco>")
    with pytest.raises(TrialError, match="cannot read the model"):
        Mechanism(file)


def test_a_missing_file_and_an_unknown_joint_name_the_next_step(arm, tmp_path):
    with pytest.raises(TrialError, match="write the path of the MJCF"):
        Mechanism(tmp_path / "none.xml")
    with pytest.raises(TrialError, match="did you mean elbow"):
        arm.joint("elbw")
    with pytest.raises(TrialError, match="its name holds a dot"):
        arm.joint("left.elbow")
