"""Independent mechanisms: recordings are reproducible, and each law changes what it states."""

import json

import mujoco
import numpy as np
import pytest

from validation.mechanisms import cases
from validation.mechanisms.cases import FAULTS, UNKNOWNS, WHOLE, MechanismCase, draw_and_write, scales_of, sizes_of
from validation.mechanisms.record import ROBOTS, JointLaw, Truth, loaded, record

HEALTHY = Truth({})


def columns(robot, truth=HEALTHY, seconds=1.0):
    return record(ROBOTS[robot], truth, "multisine", seconds, np.random.default_rng(0))


@pytest.fixture(scope="module")
def healthy():
    """The recording of a camera without a fault."""
    return columns("camera")


@pytest.mark.parametrize("name", ROBOTS)
def test_every_joint_of_a_robot_exists_in_its_model(name):
    robot, model = ROBOTS[name], mujoco.MjModel.from_xml_path(str(ROBOTS[name].model))
    joints = {model.joint(i).name for i in range(model.njnt)}
    assert joints == {*robot.judged, *robot.moved, *robot.followers, *filter(None, [robot.floats])}


@pytest.fixture(scope="module")
def scales():
    """Return the sizes of the camera's axes, which take half a second to simulate."""
    return scales_of(ROBOTS["camera"])


@pytest.mark.parametrize("name", [*FAULTS, *UNKNOWNS])
def test_every_fault_changes_the_recording(name, healthy, scales):
    laws = {"tilt": (FAULTS | UNKNOWNS)[name].law(JointLaw(), scales["tilt"], 1.0)}
    faulty = columns("camera", Truth(laws))
    assert np.abs(faulty["q_tilt"] - healthy["q_tilt"]).max() >= 1e-3


@pytest.mark.parametrize(
    ("name", "law", "path", "expected"),
    [
        ("friction", JointLaw(dry=1.5, more_dry=0.1), "coulomb_friction.torque", 0.1225),
        ("rotor", JointLaw(armature=2.0, more_inertia=0.01), "armature.inertia", 0.018),
        ("weak", JointLaw(gain=0.7), "gain.scale", -0.3),
        ("soft", JointLaw(stiff=0.6), "position_gain.scale", -0.4),
        ("late", JointLaw(delay_s=0.05), "dead_time.delay", 0.05),
    ],
)
def test_the_true_size_of_a_fault_includes_the_model_s_own(name, law, path, expected):
    found = sizes_of(ROBOTS["camera"], "tilt", name, law)
    assert found == {f"tilt.{path}": pytest.approx(expected)}


def test_the_size_of_a_joint_with_followers_is_not_stated():
    assert sizes_of(ROBOTS["linkage"], "crank", "friction", JointLaw(more_dry=0.1)) == {}


@pytest.mark.parametrize(
    ("name", "joint"), [("tilted", "pan"), ("loaded", "tilt"), ("beside", "tilt"), ("heavier", "tilt")]
)
def test_every_fault_of_the_whole_mechanism_changes_a_joint(name, joint, healthy):
    fault = WHOLE[name](ROBOTS["camera"], HEALTHY, np.random.default_rng(0))
    assert joint in fault.joints
    faulty = columns("camera", fault.truth)
    assert np.abs(faulty[f"q_{joint}"] - healthy[f"q_{joint}"]).max() >= 2e-3


def test_a_load_adds_its_share_of_the_last_body_s_mass():
    before, after = (loaded(ROBOTS["camera"].model, truth) for truth in (HEALTHY, Truth({}, load=0.5)))
    added = after.body_subtreemass[0] - before.body_subtreemass[0]
    assert added == pytest.approx(0.5 * before.body("camera").mass[0])
    centre = [model.body("load").pos if model is after else model.body("camera").ipos for model in (before, after)]
    assert centre[1] == pytest.approx(centre[0])


@pytest.mark.parametrize("seed", range(4))
def test_a_heavier_body_is_named_with_the_joints_that_move_it(seed):
    fault = WHOLE["heavier"](ROBOTS["arm"], HEALTHY, np.random.default_rng(seed))
    ((body, factor),) = fault.truth.masses.items()
    assert fault.names[0] == f"mass_{body}"
    assert 1.4 <= factor <= 2.0
    carried = {"upper": 2, "fore": 3, "roll": 4, "wrist": 5, "tool": 6}
    assert fault.joints == tuple(ROBOTS["arm"].follows)[: carried[body]]


def test_a_case_holds_its_input_apart_from_its_causes(tmp_path, scales, monkeypatch):
    monkeypatch.setattr(cases, "DURATION_S", 0.3)
    monkeypatch.setattr(cases, "scales_of", lambda robot: {"camera": scales}[robot.name])
    draw_and_write(MechanismCase(1, 4, "two"), tmp_path / "data", tmp_path / "truths")
    assert sorted(path.name for path in (tmp_path / "data" / "mechanism-1-004").iterdir()) == [
        "holds-1.csv", "multisine-0.csv", "multisine-2.csv", "robot.xml", "stage.yaml",
    ]  # fmt: skip
    causes = json.loads((tmp_path / "truths" / "mechanism-1-004.json").read_text())["causes"]
    assert len({joint for cause in causes for joint in cause["joints"]}) == 2
    assert all(path.split(".")[0] in cause["joints"] for cause in causes for path in cause["sizes"])
    # A cause of the whole mechanism holds all its joints.
    draw_and_write(MechanismCase(1, 4, "whole"), tmp_path / "data", tmp_path / "truths")
    (cause,) = json.loads((tmp_path / "truths" / "mechanism-1-004.json").read_text())["causes"]
    assert cause["joints"] == ["pan", "tilt"]
    assert cause["names"] in (["tilt"], ["payload"], ["mass_camera", "mass", "payload"])
    assert {path.rpartition(".")[0] for path in cause["sizes"]} == {f"*.{cause['names'][0]}"}


def test_followers_keep_the_equalities_of_their_model():
    found, model = columns("linkage", seconds=1.5), mujoco.MjModel.from_xml_path(str(ROBOTS["linkage"].model))
    data = mujoco.MjData(model)
    for k in range(0, 150, 15):
        data.qpos[:] = [found[f"q_{name}"][k] for name in ("crank", "coupler", "rocker")]
        mujoco.mj_forward(model, data)
        assert np.abs(data.efc_pos[: data.ne]).max() < 2e-3  # the encoders have steps of 1 mrad


def test_a_body_that_flies_has_a_unit_quaternion_and_loads_the_arm():
    found = columns("drone", seconds=2.5)
    turn = np.stack([found[f"hull_q{part}"] for part in "wxyz"])
    assert np.linalg.norm(turn, axis=0) == pytest.approx(1.0)
    assert 0.05 < np.ptp(found["hull_qx"]) < 0.4
    assert 0.1 < np.ptp(found["hull_z"]) < 0.4
