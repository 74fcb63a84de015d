"""Files that the steps of closing a gap write, with an invented diagnosis and a few frames of training."""

import json

import numpy as np
import pytest
from torch import nn

from softarm.daemon.config.configuration import load
from softarm.diagnosis.engine.result import Diagnosis
from softarm.evaluation.closing import fly, steps
from softarm.evaluation.closing.closed import Place
from softarm.evaluation.closing.outcomes import HELD_OUT
from softarm.evaluation.closing.wires import Wires
from softarm.evaluation.robots import with_faults
from softarm.policies.base import MODELS
from softarm.reality.parameters import RobotParameters
from softarm.schemas.config import Config, Goals, Limits, RailLimits
from softarm.schemas.flights import TEST_TARGETS
from softarm.schemas.model import Arm, Model
from softarm.schemas.verdict import Verdict, Where
from softarm.simulator import model_file
from softarm.training.record import curve, foreign
from softarm.training.record.checkpoint import CheckpointError
from softarm.training.run.retrain import RetrainingConfig, load_weights
from tests.evaluation.closing import cases

pytestmark = pytest.mark.slow

CAREFUL = Config(limits=Limits(rail=RailLimits(braking_m_s2=3.0, surge_m_s2=9.0)), goals=Goals(time_limit_s=1.5))
RAIL = cases.findings(CAREFUL, cases.seen())
REACH = MODELS / "reach.onnx"
EASY, NEVER = TEST_TARGETS[4], TEST_TARGETS[-1]  # (-0.20, 0.55), and (0, 0.80), which no command reaches
TINY = RetrainingConfig(
    frames=256,
    frames_min=0,
    seconds=float("inf"),
    robots=16,
    validate_every=1,
    validation_trials=6,
    critic_iterations=1,
)
LATE = Model(effects=Model().effects | {"pressure.dead_time": {"delay": 0.06}})
NAMED = cases.named("pressure.dead_time", 0.06, 0.07)
NONE = NAMED.model_copy(
    update={"verdict": "none", "effects": (), "where": Where(stage=None, share={}, regime="nowhere")}
)


@pytest.fixture(autouse=True)
def two_targets(monkeypatch):
    """Fly a few draws to two targets, in this process, and draw no learning curve."""
    monkeypatch.setattr(fly, "PART", 3)
    monkeypatch.setattr(fly, "TEST_TARGETS", (EASY, NEVER))
    monkeypatch.setattr(fly, "cores", lambda: 1)
    monkeypatch.setattr(curve, "write_png", lambda rows, path, *_: path.touch())


def close(out, held_out, declared=True, through=lambda closed: None, reported=None, **found):
    out.mkdir()
    usual = {"verdict": NAMED, "nominal": Model(), "patched": LATE, "trials": (("a", "seed", 1.0),)}
    diagnosis = Diagnosis(**usual | found)
    spent, reported = {}, [] if reported is None else reported
    options = steps.Options(adaptive=MODELS / "reach-robust.onnx", draws=fly.PART)
    steps.close(diagnosis, RAIL, REACH, out, held_out, declared, TINY, spent, options, through, reported.append)
    summary = json.loads((out / "summary.json").read_text())
    assert summary["spent"].keys() == spent.keys()
    return Verdict.model_validate_json((out / "verdict.json").read_text()), summary


# Over 3 s: 36 flights and a retraining, the shortest that gives every figure of the results.
@pytest.mark.parametrize(
    "robot",
    [LATE, pytest.param(with_faults(RobotParameters(), ["regulator.dead_time_s=0.06"]), marks=pytest.mark.prove)],
    ids=["simulated", "independent"],
)
def test_a_named_effect_is_patched_trained_on_and_flown(tmp_path, monkeypatch, robot):
    monkeypatch.setattr(steps, "Replanning", cases.QuickReplanning)
    out = tmp_path / "closed"
    reported = []
    verdict, summary = close(out, Place(HELD_OUT, "the robot", robot), reported=reported)
    assert model_file.load(out / "patched-model.yaml") == LATE
    old, new = load_weights(REACH), load_weights(out / "retrained.onnx")
    assert new.metadata.training["start.frames"] == old.metadata.training["run.frames"]
    assert new.metadata.training["model.sha256"] == model_file.fingerprint(LATE)

    patched = RAIL.patched.limits.rail
    assert (patched.latency_s, patched.braking_m_s2, patched.surge_m_s2) == (0.05, 2.6, 9.0)
    assert load(out / "limits-patch.yaml").limits.rail == patched
    for key in ("latency_s", "braking_m_s2", "surge_m_s2"):
        assert new.metadata.training[f"task.rail_{key}"] == getattr(patched, key)
    assert summary["limits"]["rail"]["braking_m_s2"]["advised"] == 2.6
    assert not np.array_equal(new.network.w_h.detach(), old.network.w_h.detach())
    assert (out / "retrained.pt").stat().st_size > 1e6
    assert 0 < verdict.task.success_nominal < 1  # only one of the two targets can be reached
    assert 0 <= verdict.task.success_patched < 1
    assert set(summary["old"]) == {"nominal", "patched", "held-back"}
    assert verdict.task.success_real == summary["old"]["held-back"]["reached"] / fly.PART
    assert list(summary["ways"]) == ["old", "mppi", "new", "adaptive"]
    for way in summary["ways"].values():
        assert way["rest"]["flights"] + way["swinging"]["flights"] == fly.PART
    assert summary["fly"] == "old"
    assert set(summary["against"]) == {"mppi", "new", "adaptive"}
    assert summary["wires"] is None
    assert summary["retrained"]["frames"] == TINY.frames
    assert set(summary["spent"]) == {"old", "mppi", "adaptive", "retrain", "new"}
    assert [text.split(":")[0] for text in reported] == ["Mppi on the patch", "Adaptive policy", "Retrained"]
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.count("<html") == 1
    for text in (
        "The ways to fly",
        "Retraining",
        "Rail limits",
        "Keep the old policy",
    ):
        assert text in page


def test_a_refused_retraining_leaves_the_diagnosis_and_the_ways_before_it(tmp_path, monkeypatch):
    """A user who has waited for the diagnosis keeps it when the retraining is too short."""

    def refuse(*_):
        raise ValueError("too short: give --seconds 320 or more")

    monkeypatch.setattr(steps, "retrain", refuse)
    monkeypatch.setattr(steps, "Replanning", cases.QuickReplanning)
    out = tmp_path / "out"
    with pytest.raises(ValueError, match=r"--seconds 320 or more\. .*report.html .* start again with another --out"):
        close(out, Place(HELD_OUT, "late", LATE))
    assert Verdict.model_validate_json((out / "verdict.json").read_text()).effects == NAMED.effects
    assert "pressure.dead_time" in (out / "report.html").read_text(encoding="utf-8")
    assert list(json.loads((out / "summary.json").read_text())["ways"]) == ["old", "mppi", "adaptive"]


def test_without_a_named_effect_nothing_is_patched_or_retrained_and_results_precede_the_motion(tmp_path, monkeypatch):
    monkeypatch.setattr(fly, "TEST_TARGETS", (EASY,))
    written = []

    def through(closed):
        written.append(json.loads((tmp_path / "out" / "summary.json").read_text()))
        return Wires.unflown("the robot of softarm.yaml", "not wanted")

    late = Place(HELD_OUT, "late", LATE)
    found = {"verdict": NONE, "patched": None}
    reported = []
    verdict, summary = close(tmp_path / "out", late, declared=False, through=through, reported=reported, **found)
    files = ["limits-patch.yaml", "report.html", "summary.json", "verdict.json"]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == files
    assert verdict.task.success_nominal > 0.5
    assert verdict.task.success_patched is None
    assert verdict.task.success_real is None
    assert summary["retrained"] is None
    assert set(summary["ways"]) == {"old", "adaptive"}
    assert "flights on the nominal simulator" in reported[0]
    assert "nothing was patched" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    # Written before the robot moves, and again after.
    assert [each["wires"] for each in written] == [None]
    assert written[0]["ways"] == summary["ways"]
    assert summary["wires"]["ended"] == "not wanted"


def test_only_a_policy_of_training_is_retrained_and_any_network_may_adapt(tmp_path, monkeypatch):
    monkeypatch.setattr(foreign, "VALIDATION_TRIALS", 12)
    file = tmp_path / "foreign.onnx"
    foreign.export(nn.Sequential(nn.Linear(10, 2)), file)
    assert steps.policy_file(str(file), is_retrained=False) == file
    with pytest.raises(CheckpointError, match=r"foreign\.onnx: not a policy of `softarm train`"):
        steps.policy_file(str(file), is_retrained=True)


@pytest.mark.parametrize(("is_retrained", "option"), [(True, "--policy"), (False, "--adaptive")])
def test_a_policy_for_the_shelf_is_refused(is_retrained, option):
    with pytest.raises(ValueError, match=f"{option} shelf: flies into a shelf, .*; name one of the task reach"):
        steps.policy_file("shelf", is_retrained)


def test_another_rig_has_no_policy(tmp_path):
    with pytest.raises(ValueError, match="shows another rig, and policies fly only the arm"):
        close(tmp_path / "out", Place(HELD_OUT, "late", LATE), nominal=None)


def test_the_independent_robot_gets_the_nominal_arm_and_cart_and_keeps_its_actuators():
    heavier = Model(arm=Arm(link_mass_kg=(0.005, 0.005, 0.005, 0.005, 0.2)))
    place = steps.of_the_nominal_body(steps.independent(["regulator.dead_time_s=0.06"]), heavier)
    assert place.robot.body == heavier.arm
    assert place.robot.regulator.dead_time_s == 0.06
    assert steps.of_the_nominal_body(Place(HELD_OUT, "late", LATE), heavier).robot == LATE
