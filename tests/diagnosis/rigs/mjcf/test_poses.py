"""Floating bodies whose pose is measured."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from softarm.diagnosis.data.trials import Series, TrialError
from softarm.diagnosis.rigs.grid import grid
from softarm.diagnosis.rigs.laws import joint as laws
from softarm.diagnosis.rigs.mjcf.mechanism import Mechanism
from softarm.diagnosis.rigs.motion import differences, smoothed
from validation.mechanisms.record import MODELS

POSE = ("hull_x", "hull_y", "hull_z", "hull_qw", "hull_qx", "hull_qy", "hull_qz")
STEP_S = 1e-4


@pytest.fixture(scope="module")
def drone():
    return Mechanism(MODELS / "drone.xml", ("shoulder", "elbow", "twist"))


@pytest.fixture(scope="module")
def flown():
    """Return positions, speeds and accelerations of a simulated flight, [T, ...] each, and the model."""
    model = mujoco.MjModel.from_xml_path(str(MODELS / "drone.xml"))
    model.opt.timestep, model.opt.integrator = STEP_S, mujoco.mjtIntegrator.mjINT_EULER
    model.dof_frictionloss[:] = 0.0
    data, rows = mujoco.MjData(model), []
    data.qvel[:] = 0.4, -0.2, 4.0, 1.1, -0.8, 1.5, 2.0, -3.0, 1.0
    for _ in range(4000):
        mujoco.mj_forward(model, data)
        rows.append((data.qpos.copy(), data.qvel.copy(), data.qacc.copy()))
        mujoco.mj_step(model, data)
    return (*(np.array(x) for x in zip(*rows, strict=True)), model)


def columns(qpos):
    """Return the motion that differences of the columns give."""
    names = (*POSE, "shoulder", "elbow", "twist")
    found = {}
    for name, x in zip(names, qpos.T, strict=True):
        speed = np.gradient(x, STEP_S)
        found[name] = x, speed, np.gradient(speed, STEP_S)
    return found


def test_a_measured_pose_gives_the_speeds_and_accelerations_of_mujoco(drone, flown):
    qpos, qvel, qacc, _ = flown
    course = drone.course(drone.joint("twist"), columns(qpos))
    inner, state = slice(5, -5, 10), course.centre
    assert state.position[inner] == pytest.approx(qpos[inner], abs=1e-9)
    assert state.speed[inner] == pytest.approx(qvel[inner], abs=1e-2 * np.abs(qvel).max())
    others = np.arange(qacc.shape[1]) != drone.joint("twist").dof
    off = np.sqrt(np.mean((state.acceleration[inner] - qacc[inner])[:, others] ** 2))
    assert off < 0.02 * np.sqrt(np.mean(qacc[inner] ** 2))


def test_a_floating_base_loads_the_joints_that_hang_from_it(drone, flown):
    qpos, qvel, qacc, _ = flown
    shoulder, part = drone.joint("shoulder"), slice(100, -100, 100)
    motion = {name: tuple(x[part] for x in of) for name, of in columns(qpos).items()}
    terms = drone.terms(shoulder, drone.course(shoulder, motion))
    own = qpos[part, shoulder.position], qvel[part, shoulder.dof], qacc[part, shoulder.dof]
    needed = terms[laws.INERTIA] * own[2] + terms[laws.LOAD] + terms[laws.BY_POSITION] * own[0]
    needed += terms[laws.BY_SPEED] * own[1]
    servo = shoulder.actuator
    given = -servo.kp * own[0] - (servo.kd + shoulder.viscous) * own[1]
    assert needed == pytest.approx(given, abs=0.03 * np.abs(given).max())
    still = drone.terms(shoulder, drone.course(shoulder, {n: motion[n] for n in ("shoulder", "elbow", "twist")}))
    assert np.abs(still - terms)[laws.LOAD].max() > 0.1 * np.abs(given).max()


def test_a_thruster_concerns_no_joint_of_the_arm(drone):
    assert drone.joint("shoulder").actuator.name == "shoulder_servo"
    assert not drone.joint("shoulder").problem


def test_a_misspelt_column_of_a_pose_names_the_right_one(drone):
    with pytest.raises(TrialError, match="no hinge or slide joint hull_qv; did you mean hull_q"):
        drone.joint("hull_qv")


def test_a_quaternion_that_changes_its_sign_is_continued(drone):
    turn = np.array([[0.9, 0.1, 0.2, 0.3], [0.89, 0.12, 0.2, 0.3], [-0.88, -0.14, -0.2, -0.3]])
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    series = Series(np.arange(3.0), dict(zip(POSE[3:], turn.T, strict=True)))
    found = drone.poses[0].continuous(series, Path("run.csv"))
    assert found["hull_qw"] == pytest.approx(np.abs(turn[:, 0]))


def test_the_acceleration_of_a_pose_is_not_that_of_its_noise():
    """Motion capture at 500 Hz with 0.1 mm of noise, of a body that moves by 0.1 m at 1 Hz."""
    t, turn = np.arange(0, 4, 0.002), 2 * np.pi
    place = 0.1 * np.sin(turn * t) + 1e-4 * np.random.default_rng(0).normal(size=len(t))
    series = Series(t, {"hull_x": place})
    at = grid(series, 500.0)
    true = -0.1 * turn**2 * np.sin(turn * at.t_s)
    plain, smooth = (of(series, "hull_x", at)[2] for of in (differences, smoothed))
    inner = slice(40, -40)
    assert np.std((plain - true)[inner]) > 30
    assert np.std((smooth - true)[inner]) < 0.5


@pytest.mark.parametrize(
    ("names", "factor", "said"),
    [
        (POSE[3:6], 1.0, "run.csv: the orientation of hull lacks hull_qz; name all four columns, or none"),
        (POSE[3:], 2.0, r"have a length of 2 at 0.000 s \(error 1; allowed: 0.05\)"),
    ],
)
def test_a_wrong_orientation_is_refused(drone, names, factor, said):
    series = Series(np.arange(2.0), {name: np.full(2, 0.5 * factor) for name in names})
    with pytest.raises(TrialError, match=said):
        drone.poses[0].continuous(series, Path("run.csv"))
