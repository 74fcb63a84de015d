"""The change of a column that makes the motion explain a torque, of an arm that MuJoCo moves."""

import mujoco
import numpy as np
import pytest

from softarm.diagnosis.rigs.mjcf.descriptions import right_description
from softarm.diagnosis.rigs.mjcf.mechanism import Mechanism
from validation.mechanisms.record import ROBOTS

ARM = ROBOTS["arm"].model
JOINTS = "base", "shoulder", "elbow"  # the others stand still


@pytest.fixture(scope="module")
def moved():
    """Return the arm, the motion of its joints, and the torque that each of them needs."""
    model, random, t_s = mujoco.MjModel.from_xml_path(str(ARM)), np.random.default_rng(2), np.linspace(0, 20, 150)
    rates, phases, sizes = (random.uniform(*ends, (3, 4)) for ends in ((1, 6), (0, 6), (0.1, 0.4)))
    turns = rates[..., None] * t_s + phases[..., None]
    position = 0.4 + np.einsum("jk,jkt->jt", sizes, np.sin(turns))
    speed = np.einsum("jk,jkt->jt", sizes * rates, np.cos(turns))
    acceleration = -np.einsum("jk,jkt->jt", sizes * rates**2, np.sin(turns))
    data, torques = mujoco.MjData(model), []
    for q, v, a in zip(position.T, speed.T, acceleration.T, strict=True):
        data.qpos[:3], data.qvel[:3], data.qacc[:3] = q, v, a
        mujoco.mj_inverse(model, data)
        torques.append(data.qfrc_inverse[:3].copy())
    motions = {name: (position[i], speed[i], acceleration[i]) for i, name in enumerate(JOINTS)}
    return Mechanism(ARM, JOINTS), motions, dict(zip(JOINTS, np.array(torques).T, strict=True))


def described(moved, joint, **changed):
    mechanism, motions, torques = moved
    return right_description(mechanism, mechanism.joint(joint), {**motions, **changed}, torques[joint])


@pytest.mark.parametrize("joint", ["shoulder", "elbow"])
def test_a_wrong_zero_a_sign_and_exchanged_columns_are_found_from_each_joint(moved, joint):
    (x, v, a), elbow = (moved[1][name] for name in ("shoulder", "elbow"))
    assert described(moved, joint, shoulder=(x - np.pi / 2, v, a)) == "with `add: 1.571` for shoulder it explains 100 %"
    assert described(moved, joint, shoulder=(-x, -v, -a)) == "with `scale: -1` for shoulder it explains 100 %"
    swapped = described(moved, joint, shoulder=elbow, elbow=(x, v, a))
    assert swapped == "with the columns of shoulder and elbow exchanged it explains 100 %"


def test_a_torque_that_no_change_explains_has_no_remedy(moved):
    mechanism, motions, torques = moved
    noise = np.random.default_rng(3).normal(size=len(torques["elbow"]))
    assert right_description(mechanism, mechanism.joint("elbow"), motions, noise) == ""


def test_changes_that_a_torque_cannot_separate_are_no_remedy(moved):
    """The zero of a vertical axis acts on no torque, so every zero of it is as good as another."""
    assert described(moved, "shoulder") == ""
