"""Rigid-body terms, actuators and refusals of a MuJoCo model."""

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from softarm.diagnosis.data.trials import TrialError
from softarm.diagnosis.rigs.laws import joint as laws
from softarm.diagnosis.rigs.mjcf.mechanism import Change, Mechanism
from softarm.reality.mechanisms.record import ROBOTS

EXAMPLE = Path(__file__).parents[4] / "examples/mujoco"
LOOP = """
<mujoco>
  <worldbody>
    <body name="a"><joint name="one" type="hinge"/><geom size="0.1"/></body>
    <body name="b" pos="1 0 0"><joint name="two" type="hinge"/><geom size="0.1"/></body>
  </worldbody>
  <equality><connect body1="a" body2="b" anchor="0 0 0"/></equality>
</mujoco>
"""
MUSCLE = """
<mujoco>
  <worldbody><body><joint name="one" type="hinge"/><geom size="0.1"/></body></worldbody>
  <actuator><muscle name="flexor" joint="one" lengthrange="0 1"/></actuator>
</mujoco>
"""
TENDON = """
<mujoco>
  <worldbody><body><joint name="one" type="hinge"/><geom size="0.1"/></body></worldbody>
  <tendon><fixed name="cable"><joint joint="one" coef="0.1"/></fixed></tendon>
  <actuator><motor name="winch" tendon="cable"/></actuator>
</mujoco>
"""


@pytest.fixture(scope="module")
def arm():
    return Mechanism(ROBOTS["arm"].model)


@pytest.fixture(scope="module")
def motion(arm):
    random = np.random.default_rng(0)
    return {name: tuple(random.normal(size=(3, 5)) * [[0.5], [1.0], [3.0]]) for name in arm.joints}


@pytest.mark.parametrize("name", ["base", "elbow", "wrist"])
def test_the_terms_give_the_torque_that_mujoco_computes(arm, motion, name):
    joint, terms = arm.joint(name), arm.terms(arm.joint(name), motion)
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
    joint, terms = arm.joint("shoulder"), arm.terms(arm.joint("shoulder"), motion)
    position, speed, acceleration = motion["shoulder"]
    moved = arm.terms(joint, motion | {"shoulder": (position + 0.02, speed, acceleration)})

    def load(of, q):
        return of[laws.LOAD] + of[laws.BY_POSITION] * q + of[laws.BY_SPEED] * speed

    assert load(terms, position + 0.02) == pytest.approx(load(moved, position + 0.02), abs=2e-3)


def test_masses_behind_a_joint_and_a_payload_change_its_terms_linearly(arm, motion):
    joint = arm.joint("elbow")
    base = arm.terms(joint, motion)
    half, whole = (arm.terms(joint, motion, Change(payload_kg=kg)) - base for kg in (0.1, 0.2))
    assert whole == pytest.approx(2 * half, rel=1e-6, abs=1e-9)
    assert half[laws.INERTIA].min() > 0
    heavier = arm.terms(joint, motion, Change(mass_share=0.1))
    own, more = (terms[laws.INERTIA] - joint.armature for terms in (base, heavier))
    assert more == pytest.approx(1.1 * own, rel=1e-6)


def test_a_payload_at_a_distance_is_a_point_mass_in_mujoco(arm, motion, tmp_path):
    joint = arm.joint("elbow")
    link, change = arm.last_link(joint), Change(payload_kg=0.15, payload_m=0.11)
    x, y, z = link.place(change.payload_m)
    mass = f'<body pos="{x} {y} {z}"><inertial pos="0 0 0" mass="0.15" diaginertia="1e-12 1e-12 1e-12"/></body>'
    text = arm.path.read_text()
    (tag,) = re.findall(rf'<body name="{link.body}"[^>]*>', text)
    (tmp_path / "loaded.xml").write_text(text.replace(tag, tag + mass))
    loaded = Mechanism(tmp_path / "loaded.xml")
    assert arm.terms(joint, motion, change) == pytest.approx(
        loaded.terms(loaded.joint("elbow"), motion), rel=1e-6, abs=1e-8
    )


def test_a_longer_link_carries_its_masses_and_the_next_joint_farther_out(tmp_path):
    text = (EXAMPLE / "robot.xml").read_text()
    (tmp_path / "longer.xml").write_text(text.replace(" -0.3", " -0.33"))
    nominal, longer = Mechanism(EXAMPLE / "robot.xml"), Mechanism(tmp_path / "longer.xml")
    t = np.linspace(0, 1, 20)
    motion = {name: (np.sin(t + k), np.cos(3 * t), np.sin(5 * t)) for k, name in enumerate(("shoulder", "elbow"))}
    base, stretched, expected = (
        mechanism.terms(mechanism.joint("shoulder"), motion, change)
        for mechanism, change in ((nominal, Change()), (nominal, Change(length_share=0.1)), (longer, Change()))
    )
    # MuJoCo gives a capsule's own inertia by its shape, a small part of the change.
    assert np.abs(stretched - expected).max() < 0.05 * np.abs(expected - base).max()
    assert not nominal.carries(nominal.joint("elbow"))


def test_a_tilted_base_turns_gravity_as_a_rotated_body_does(arm, motion, tmp_path):
    text = arm.path.read_text()
    turret = '<body name="turret" pos="0 0 0.1"'
    assert turret in text
    (tmp_path / "tilted.xml").write_text(text.replace(turret, f'{turret} euler="0.03 -0.02 0"'))
    tilted, change = Mechanism(tmp_path / "tilted.xml"), Change(tilts_rad={"x": 0.03, "y": -0.02})
    for name in ("base", "shoulder", "wrist"):
        base, found, expected = (
            mechanism.terms(mechanism.joint(name), motion, each)
            for mechanism, each in ((arm, Change()), (arm, change), (tilted, Change()))
        )
        # The linear change lacks the squares of the angles.
        assert np.abs(found - expected).max() < 0.05 * np.abs(expected - base).max()


def test_the_base_tilts_about_the_axes_that_gravity_does_not_point_along(tmp_path):
    text = ROBOTS["arm"].model.read_text()
    (tmp_path / "wall.xml").write_text(text.replace("<option ", '<option gravity="0 9.81 0" '))
    (tmp_path / "space.xml").write_text(text.replace("<option ", '<option gravity="0 0 0" '))
    assert [*Mechanism(tmp_path / "wall.xml").level_axes] == ["x", "z"]
    assert not Mechanism(tmp_path / "space.xml").level_axes


def test_an_actuator_is_read_in_the_units_of_its_joint():
    joint = Mechanism(ROBOTS["leg"].model).joint("hip")
    assert (joint.actuator.name, joint.actuator.scale, joint.actuator.kp) == ("hip_motor", 6.0, 0.0)
    servo = Mechanism(ROBOTS["arm"].model).joint("wrist").actuator
    assert (servo.kp, servo.kd, servo.low, servo.high) == (15.0, 0.5, -3.0, 3.0)
    assert Mechanism(ROBOTS["gantry"].model).joint("swing").actuator is None


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (LOOP, "closes a loop"),
        (MUSCLE, "flexor is neither a motor"),
        (TENDON, "winch .* give the torques of its joints under `torque`"),
        ("<mujoco><worldbody><body></mujoco>", "cannot read the model"),
    ],
)
def test_a_model_that_is_not_supported_is_refused_with_the_reason(tmp_path, text, said):
    file = tmp_path / "model.xml"
    file.write_text(text)
    with pytest.raises(TrialError, match=said):
        Mechanism(file)


def test_a_missing_file_and_an_unknown_joint_name_the_next_step(arm, tmp_path):
    with pytest.raises(TrialError, match="write the path of the MJCF"):
        Mechanism(tmp_path / "none.xml")
    with pytest.raises(TrialError, match="did you mean elbow"):
        arm.joint("elbw")
    with pytest.raises(TrialError, match="its name holds a dot"):
        arm.joint("left.elbow")
