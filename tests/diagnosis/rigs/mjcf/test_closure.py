"""Models with equalities: closed chains, mimic joints and coupled tendons."""

import re

import mujoco
import numpy as np
import pytest

from softarm.diagnosis.rigs.laws import joint as laws
from softarm.diagnosis.rigs.mjcf.closure import Closure
from softarm.diagnosis.rigs.mjcf.mechanism import Mechanism
from validation.mechanisms.record import MODELS

STEP_S = 2e-4
# A tendon moves the fingers of the gripper, and an equality couples them.
GRIPPER = (MODELS / "gripper.xml").read_text()
WRIST_SERVO = '<position name="wrist_servo" joint="wrist" kp="18" kv="0.8" forcerange="-4 4"/>'
SERVO = 'kp="900" kv="30"'


@pytest.fixture(scope="module")
def linkage():
    return Mechanism(MODELS / "linkage.xml", ("crank",))


@pytest.fixture(scope="module")
def swung():
    """Return position, speed, acceleration and applied torque of a stiffly closed linkage, [T, nv] each."""
    rigid = (MODELS / "linkage.xml").read_text().replace('frictionloss="0.05"', "")  # no part of the rigid-body terms
    model = mujoco.MjModel.from_xml_string(rigid[: rigid.index("<actuator>")] + "</mujoco>")
    assert model.joint(0).name == "crank"
    model.opt.timestep, model.opt.integrator = STEP_S, mujoco.mjtIntegrator.mjINT_EULER
    model.eq_solref[:] = 4 * STEP_S, 1
    data, rows = mujoco.MjData(model), []
    for k in range(round(1.0 / STEP_S)):
        data.qfrc_applied[0] = 1.5 * np.sin(9 * k * STEP_S)
        before = data.qpos.copy(), data.qvel.copy()
        mujoco.mj_step(model, data)
        rows.append((*before, data.qacc.copy(), data.qfrc_applied.copy()))
    return tuple(np.array(x) for x in zip(*rows, strict=True))


def test_the_joints_of_a_closed_chain_follow_the_measured_one(linkage, swung):
    q, v, a, _ = swung
    crank, part = linkage.joint("crank"), slice(200, None, 50)
    course = linkage.course(crank, {"crank": (q[part, 0], v[part, 0], a[part, 0])})
    assert set(crank.followers) == {"coupler", "rocker"}
    assert course.centre.closed.all()
    assert course.centre.position == pytest.approx(q[part], abs=2e-3)
    assert course.centre.speed == pytest.approx(v[part], abs=0.02 * np.abs(v).max())


def test_joints_that_carry_a_closed_chain_are_no_part_of_it(tmp_path):
    text, file = (MODELS / "linkage.xml").read_text(), tmp_path / "carried.xml"
    arm = "".join(
        f'<body pos="0 0 0.3"><joint name="{name}" axis="{axis}"/><geom size="0.05" mass="1"/>'
        for name, axis in (("pan", "0 0 1"), ("tilt", "0 1 0"), ("roll", "1 0 0"))
    )
    file.write_text(
        text.replace("<worldbody>", f"<worldbody>{arm}").replace("</worldbody>", f"{3 * '</body>'}</worldbody>")
    )
    carried = Mechanism(file, ("pan", "tilt", "roll", "crank"))
    assert {joint.name: set(joint.followers) for joint in carried.joints.values() if joint.followers} == {
        "crank": {"coupler", "rocker"}
    }
    t = np.linspace(0, 1, 5)
    motion = {name: (np.sin(t + k), np.cos(t + k), -np.sin(t + k)) for k, name in enumerate(("pan", "tilt", "roll"))}
    course = carried.course(carried.joint("tilt"), motion | {"crank": (0.3 * t, np.full(5, 0.3), np.zeros(5))})
    data = mujoco.MjData(carried.model)
    for state in (course.centre, course.above, course.below):
        for data.qpos[:] in state.position:
            mujoco.mj_fwdPosition(carried.model, data)
            assert data.efc_pos[: data.ne] == pytest.approx(0, abs=1e-5)


def test_the_terms_of_a_closed_chain_give_the_torque_that_moved_it_in_mujoco(linkage, swung):
    q, v, a, torque = swung
    crank, part = linkage.joint("crank"), slice(200, None, 50)
    own = q[part, 0], v[part, 0], a[part, 0]
    terms = linkage.terms(crank, linkage.course(crank, {"crank": own}))
    needed = terms[laws.LOAD] + terms[laws.BY_POSITION] * own[0] + terms[laws.BY_SPEED] * own[1]
    needed += terms[laws.INERTIA] * own[2] + crank.viscous * own[1]
    assert needed == pytest.approx(torque[part, 0], abs=0.03 * np.abs(torque).max())


def test_the_slope_by_position_of_a_closed_chain_is_the_load_at_another_angle(linkage):
    crank, t = linkage.joint("crank"), np.linspace(0, 1, 7)
    q, v, a = 0.5 * np.sin(6 * t), 3 * np.cos(6 * t), np.zeros(7)

    def load(angle):
        terms = linkage.terms(crank, linkage.course(crank, {"crank": (angle, v, a)}))
        return terms, terms[laws.LOAD] + terms[laws.BY_POSITION] * angle + terms[laws.BY_SPEED] * v

    terms, here = load(q)
    _, there = load(q + 0.01)
    assert there - here == pytest.approx(0.01 * terms[laws.BY_POSITION], rel=0.1, abs=2e-3)


def test_an_angle_that_the_chain_cannot_reach_is_left_out(linkage):
    crank, angle = linkage.joint("crank"), np.array([0.0, 0.2, 2.9])
    held = linkage.held(crank, linkage.course(crank, {"crank": (angle, np.zeros(3), np.zeros(3))}))
    assert held.tolist() == [False, False, True]


def test_fingers_are_one_part_of_the_wrist_and_parts_of_their_own_joint():
    joints = Mechanism(MODELS / "gripper.xml", ("wrist", "left")).joints
    assert joints["wrist"].parts == {"palm": ("palm",), "left": ("left", "right")}
    assert joints["left"].parts == {"left": ("left",), "right": ("right",)}


@pytest.mark.parametrize(("measured", "other"), [("left", "right"), ("right", "left")])
def test_a_tendon_and_an_equality_make_two_fingers_one_joint(tmp_path, measured, other):
    file = tmp_path / "gripper.xml"
    file.write_text(GRIPPER.replace(SERVO, f'{SERVO} gear="2"'))
    gripper = Mechanism(file, (measured, "wrist"))
    finger = gripper.joint(measured)
    assert finger.followers == (other,)
    assert gripper.leader(gripper.joint(other)) == measured
    assert finger.friction == pytest.approx(2.4)
    # Length of the tendon 0.5 (1 + 1) times the finger's, gear 2.
    assert (finger.actuator.gear, finger.actuator.kp, finger.actuator.kd) == pytest.approx((2, 3600, 120))
    zero = np.zeros(1)
    terms = gripper.terms(finger, gripper.course(finger, {measured: (zero, zero, zero)}))
    assert terms[laws.INERTIA, 0] == pytest.approx(0.84)  # two masses of 0.12 kg and rotors of 0.3 kg
    assert terms[laws.BY_SPEED, 0] == pytest.approx(12.0)  # damping of the other finger
    assert not gripper.joint("wrist").followers


def test_actuators_are_refused_at_the_joints_that_they_move_alone(tmp_path):
    file = tmp_path / "model.xml"
    muscle = '<muscle name="flexor" joint="wrist" lengthrange="0 1" forcerange="-4 0"/>'
    uncoupled = re.sub("<equality>.*</equality>", "", GRIPPER, flags=re.DOTALL)
    file.write_text(uncoupled.replace(WRIST_SERVO, muscle))
    model = Mechanism(file)
    wrist = model.joint("wrist")
    assert wrist.actuator is None
    assert "joint wrist is moved by flexor; several actuators" in wrist.problem
    assert "give its torque under `torque`, as wrist" in wrist.problem
    assert not model.joint("left").problem
    file.write_text(GRIPPER.replace(WRIST_SERVO, f'{WRIST_SERVO}<motor name="turn" joint="wrist"/>'))
    assert "joint wrist is moved by wrist_servo, turn" in Mechanism(file).joint("wrist").problem


def test_a_motor_at_a_follower_moves_its_leader(tmp_path):
    file = tmp_path / "model.xml"
    text = GRIPPER.replace('joint2="left"', 'joint2="left" polycoef="0 -0.5 0 0 0"')
    file.write_text(text[: text.index("<actuator>")] + '<actuator><motor name="m" joint="right"/></actuator></mujoco>')
    left = Mechanism(file, ("left",)).joint("left")
    assert (left.actuator.name, left.actuator.scale) == ("m", pytest.approx(-0.5))


def test_constant_ratios_move_as_the_solved_equalities():
    """Equalities whose ratios are not quite constant, by 1e-7, are solved; the last joint depends first."""
    bodies = "".join(f'<body><joint name="{n}" axis="0 1 0"/><geom size="0.01" mass="1"/></body>' for n in "abcd")
    text = (
        f"<mujoco><worldbody>{bodies}</worldbody><equality>"
        '<joint joint1="b" joint2="a" polycoef="0.1 2 X 0 0"/><joint joint1="d" joint2="c" polycoef="0 -0.5 0 0 0"/>'
        "</equality></mujoco>"
    )
    random, found = np.random.default_rng(0), []
    given = [random.uniform(-0.5, 0.5, (9, 4)) for _ in range(3)]
    for curved in ("0", "1e-7"):
        model = mujoco.MjModel.from_xml_string(text.replace("X", curved))
        found.append(Closure(mujoco, model, [3, 2, 1, 0]).complete(*given, 0))
    for linear, solved in zip(*found, strict=True):
        assert linear == pytest.approx(solved, abs=1e-5)
    assert found[0].along == pytest.approx(np.tile([1, 2, 0, 0], (9, 1)), abs=1e-6)
