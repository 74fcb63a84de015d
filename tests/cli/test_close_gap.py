"""`softarm close-gap`: what it leaves behind, with a stand-in for the diagnosis and a few frames of training."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner
from rich.console import Console

from softarm.cli import close_gap
from softarm.cli.main import main
from softarm.diagnosis.gap.result import Diagnosis
from softarm.flights.closing.summary import HELD_BACK, OLD, changed
from softarm.flights.many import Place, fly, fly_all, shares, with_faults
from softarm.policies.base import MODELS
from softarm.reality.parameters import RobotParameters
from softarm.schemas.goals import TEST_TARGETS
from softarm.schemas.model import Model
from softarm.schemas.verdict import Estimate, Gap, Interval, NamedEffect, Shrink, Verdict, Where
from softarm.simulator import model_file
from softarm.training.run.retrain import RetrainingConfig
from softarm.training.run.warm_start import load_weights

REACH = MODELS / "reach.onnx"
EASY, NEVER = TEST_TARGETS[4], TEST_TARGETS[-1]  # (-0.20, 0.55), and (0, 0.80), which no command reaches
TINY = RetrainingConfig(
    frames=2048, seconds=float("inf"), robots=64, validate_every=1, validation_trials=12, critic_iterations=1
)
LATE = Model(effects=Model().effects | {"pressure.dead_time": {"delay": 0.06}})
NAMED = Verdict(
    verdict="named",
    where=Where(stage="pressure", share={"pressure": 1.0}, regime="throughout"),
    effects=(
        NamedEffect(
            name="pressure.dead_time",
            parameters={"delay": Estimate(value=0.06, low=0.05, high=0.07, unit="s")},
            confidence=0.9,
            shrink=Shrink(stage=Interval(value=0.5, low=0.4, high=0.6)),
        ),
    ),
    gap=Gap(before={}, after={}, floor={}, ceiling={}),
)
NONE = NAMED.model_copy(
    update={"verdict": "none", "effects": (), "where": Where(stage=None, share={}, regime="nowhere")}
)


@pytest.fixture
def asked(monkeypatch):
    """Stand in for the diagnosis: what it is to answer."""
    asked = SimpleNamespace(verdict=NAMED, nominal=Model(), patched=LATE)

    def diagnose(trials, model, tell=None):
        return Diagnosis(asked.verdict, asked.nominal, asked.patched, (("a", "seed", 1.0),))

    monkeypatch.setattr("softarm.diagnosis.from_files.diagnose", diagnose)
    return asked


@pytest.fixture
def campaign(tmp_path):
    """A campaign with one trial, of a second of pressure."""
    trial = tmp_path / "campaign" / "a"
    trial.mkdir(parents=True)
    (trial / "trial.yaml").write_text("kind: seed\n")
    rows = [f"{k / 30:.4f},{k % 7}.0" for k in range(30)]
    (trial / "pressure.csv").write_text("\n".join(("t,pressure", *rows)) + "\n")
    model_file.save(Model(), trial.parent / "model.yaml")
    return trial.parent


def close(campaign, out, held_back, declared=True):
    out.mkdir()
    close_gap.run(
        campaign, out, REACH, None, held_back, declared, TINY, Console(quiet=True), targets=(EASY, NEVER), processes=1
    )
    summary = json.loads((out / "summary.json").read_text())
    return Verdict.model_validate_json((out / "verdict.json").read_text()), summary


def test_a_named_effect_is_patched_trained_on_and_flown(asked, campaign, tmp_path):
    out = tmp_path / "closed"
    robot = Place(HELD_BACK, "the robot", parameters=with_faults(RobotParameters(), ["regulator.dead_time_s=0.06"]))
    verdict, summary = close(campaign, out, robot)
    assert model_file.load(out / "patched-model.yaml") == LATE
    old, new = load_weights(REACH), load_weights(out / "retrained.onnx")
    assert new.metadata.training["start.frames"] == old.metadata.training["run.frames"]
    assert new.metadata.training["model.sha256"] == model_file.fingerprint(LATE)
    assert not np.array_equal(new.network.w_h.detach(), old.network.w_h.detach())
    assert (out / "retrained.pt").stat().st_size > 1e6
    # One target of two can be reached at all; nominal, the shipped policy reaches it.
    assert verdict.task.success_nominal == pytest.approx(0.5)
    assert 0 <= verdict.task.success_patched <= 0.5
    assert verdict.task.success_real == summary["success"]["held-back"]["old"]["all"]
    assert set(summary["success"]) == {"nominal", "patched", "held-back"}
    for row in summary["success"].values():
        assert {"old", "new", "gained", "lost"} <= set(row)
    assert summary["flights"] == 6
    assert summary["retrained"]["frames"] == TINY.frames
    assert set(summary["spent"]) == {"diagnose", "retrain", "fly"}
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.count("<html") == 1
    for text in ("The policy before and after", "Retraining", "retrained policy, the robot"):
        assert text in page


def test_where_nothing_is_named_nothing_is_patched_or_retrained(asked, campaign, tmp_path):
    asked.verdict, asked.patched = NONE, None
    verdict, summary = close(campaign, tmp_path / "out", Place(HELD_BACK, "late", model=LATE), declared=False)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["report.html", "summary.json", "verdict.json"]
    assert verdict.task.success_nominal == pytest.approx(0.5)
    assert verdict.task.success_patched is None
    assert verdict.task.success_real is None  # nobody said that it was this robot
    assert summary["retrained"] is None
    assert set(summary["success"]) == {"nominal", "held-back"}
    assert "nothing was patched or retrained" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def test_another_rig_has_no_policy(asked, campaign, tmp_path):
    asked.nominal = None
    outcome = CliRunner().invoke(main, ["close-gap", str(campaign), "--out", str(tmp_path / "out")])
    assert outcome.exit_code == 1
    assert "is of another rig, for which there is no policy" in outcome.output


def test_results_are_never_written_over(asked, campaign, tmp_path):
    (tmp_path / "summary.json").write_text("{}")
    outcome = CliRunner().invoke(main, ["close-gap", str(campaign), "--out", str(tmp_path)])
    assert outcome.exit_code == 1
    assert "holds summary.json already; name a new --out" in outcome.output


@pytest.mark.parametrize(
    ("arguments", "says", "code"),
    [
        (("--policy", "raech"), "one of reach, reach-robust, reach-wide", 1),
        (("--fault", "regulator.dead_time=0.06"), "allowed here: inflate_s, deflate_s", 1),
        (("--fault", "valve.stuck=1"), "a group of regulator, rail, arm", 1),
        (("--fault", "arm.payload_kg=heavy"), "'heavy' is no number", 1),
        (("--fault", "arm.payload_kg=7"), "allowed are 0 to 0.5", 1),
        (("--robot", "no-delay", "--fault", "arm.payload_kg=0.1"), "--fault is for the independent robot", 2),
        (("--robot", "no-dely"), "did you mean no-delay?", 1),
    ],
)
def test_what_cannot_be_done_is_said_before_minutes_of_work(campaign, tmp_path, arguments, says, code):
    outcome = CliRunner().invoke(main, ["close-gap", str(campaign), "--out", str(tmp_path / "out"), *arguments])
    assert outcome.exit_code == code, outcome.output
    assert says in " ".join(outcome.output.split())
    assert not (tmp_path / "out").exists()


def test_flights_are_the_daemons_own_and_the_same_in_parts():
    place = Place("nominal", "nominal", model=Model())
    reached = fly(REACH, place, (EASY, NEVER))
    assert reached.tolist() == [[True] * 3, [False] * 3]
    told: list[int] = []
    flown = fly_all({OLD: REACH}, [place], (EASY, NEVER), told.append, processes=1)
    assert told == [6]
    assert np.array_equal(flown[OLD, "nominal"], reached)


def test_shares_and_changes_count_flights():
    old, new = np.array([[True, True], [False, False]]), np.array([[False, True], [True, True]])
    assert shares(old, (EASY, NEVER)).in_range == 1.0
    assert shares(new, (EASY, NEVER)).above == 1.0
    assert shares(new, (EASY, NEVER)).all == 0.75
    assert changed(old, new) == {"gained": 2, "lost": 1}


def test_faults_are_set_one_by_one():
    robot = with_faults(RobotParameters(), ["regulator.dead_time_s=0.06", "mocap.loose_link=2"])
    assert robot.regulator.dead_time_s == 0.06
    assert robot.mocap.loose_link == 2
    assert robot.rail == RobotParameters().rail
