"""Scores of the mechanisms' benchmark."""

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

from softarm.diagnosis.rigs.mjcf.mechanism import Mechanism
from validation.mechanisms import benchmark
from validation.mechanisms.cases import WHOLE
from validation.mechanisms.record import ROBOTS, Truth

FRICTION = {"joints": ["elbow"], "fault": "friction", "names": ["coulomb_friction"]}
LATE = {"joints": ["wrist"], "fault": "late", "names": ["dead_time", "latency"]}
TILTED = {"joints": ["elbow", "wrist"], "fault": "tilted", "names": ["tilt"]}
COGGING = {"joints": ["elbow"], "fault": "cogging", "names": []}


def answer(*groups, verdict="named", stage="elbow", tuned=()):
    effects = [{"name": first, "equivalents": rest, "confidence": 0.9} for first, *rest in groups]
    calibration = [{"name": name} for name in tuned]
    found = {"verdict": verdict, "effects": effects, "where": {"stage": stage}, "calibration": calibration}
    return {"verdict": found, "seconds": 1.0}


@pytest.mark.parametrize(
    ("causes", "reply", "said"),
    [
        ([FRICTION], answer(["elbow.coulomb_friction"]), "right"),
        ([FRICTION], answer(["wrist.coulomb_friction"]), "wrong"),
        ([FRICTION], answer(["elbow.damping", "elbow.coulomb_friction"]), "set"),
        ([FRICTION], answer(verdict="unknown"), "silent"),
        ([FRICTION], answer(verdict="none", tuned=["elbow.coulomb_friction.torque"]), "calibrated"),
        ([FRICTION], answer(verdict="none", tuned=["elbow.damping.viscous"]), "silent"),
        ([FRICTION, LATE], answer(["wrist.latency"], tuned=["elbow.coulomb_friction.torque"]), "calibrated"),
        ([LATE], answer(["wrist.dead_time", "wrist.latency"]), "right"),
        ([FRICTION, LATE], answer(["elbow.coulomb_friction"]), "part"),
        ([FRICTION, LATE], answer(["elbow.coulomb_friction"], ["wrist.latency"]), "right"),
        ([TILTED], answer(["elbow.tilt"], ["wrist.tilt"]), "right"),
        ([TILTED], answer(["elbow.tilt"]), "right"),
        ([TILTED], answer(["elbow.tilt"], ["wrist.sensor_bias", "wrist.tilt"]), "set"),
        ([TILTED], answer(["elbow.sensor_bias"], ["wrist.tilt"]), "wrong"),
        ([], answer(verdict="none", stage=None), "right"),
        ([], answer(["elbow.damping"]), "wrong"),
        ([COGGING], answer(verdict="unknown"), "right"),
        ([COGGING], answer(verdict="none", stage=None), "silent"),
        ([COGGING], answer(["elbow.damping"], verdict="incomplete"), "wrong"),
        ([FRICTION], {"verdict": None, "failure": "TrialError", "seconds": 1.0}, "failed"),
    ],
)
def test_an_answer_is_scored_by_joint_and_name(causes, reply, said):
    assert benchmark.outcome({"causes": causes}, reply) == said


def test_the_right_joint_is_the_one_with_a_known_cause():
    assert benchmark.joint_right({"causes": [FRICTION]}, answer(["elbow.damping"])) is True
    assert benchmark.joint_right({"causes": [FRICTION]}, answer(["wrist.damping"], stage="wrist")) is False
    assert benchmark.joint_right({"causes": [COGGING]}, answer(verdict="unknown")) is None


@pytest.mark.parametrize(("low", "held"), [(0.2, True), (0.35, False)])
def test_an_interval_is_compared_with_the_true_size_and_once_if_joints_share_it(low, held):
    reply = answer(["elbow.coulomb_friction"], ["wrist.damping"], ["elbow.payload"], ["wrist.payload"])
    tried, wide = {"low": low, "high": 0.4}, {"low": 0, "high": 1}
    sizes = [{"torque": tried, "give": wide}, {"viscous": wide}, {"mass": tried}, {"mass": tried}]
    for effect, parameters in zip(reply["verdict"]["effects"], sizes, strict=True):
        effect["parameters"] = parameters
    own, shared = {"elbow.coulomb_friction.torque": 0.3}, {"*.payload.mass": 0.3, "*.tilt.x": 0.1}
    truth = {"causes": [FRICTION | {"sizes": own}, {"sizes": shared}]}
    found = benchmark.intervals(truth, reply)
    assert found == {"elbow.coulomb_friction.torque": held, "*.payload.mass": held}
    assert benchmark.intervals(truth, {"verdict": None}) == {}


def test_the_true_tilt_is_the_angle_that_a_diagnosis_names():
    fault = WHOLE["tilted"](ROBOTS["arm"], Truth({}), np.random.default_rng(0))
    robot = Mechanism(ROBOTS["arm"].model)
    turned = Rotation.from_euler("XY", fault.truth.tilt_rad).inv().apply(robot.model.opt.gravity)
    named = sum(fault.sizes[f"tilt.{axis}"] * change for axis, change in robot.level_axes.items())
    assert robot.model.opt.gravity + named == pytest.approx(turned, abs=0.05)


def test_a_folder_keeps_cases_of_one_drawing(tmp_path):
    folder = tmp_path / "truths"
    folder.mkdir()
    (folder / "mechanism-5-000.json").write_text('{"category": "whole"}')
    words = ["make", str(tmp_path), "--cases", "1", "--seed", "5", "--category", "none"]
    assert "mechanism-5-000.json: belongs to other cases" in CliRunner().invoke(benchmark.main, words).output
