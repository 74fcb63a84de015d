"""Tests of `softarm diagnose` and `softarm excite --plan` with a stand-in for the diagnosis."""

import re
import shlex
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from softarm.daemon.config import configuration
from softarm.diagnosis.engine.result import Diagnosis, Overlay
from softarm.schemas.config import Config
from softarm.schemas.model import Model
from softarm.schemas.verdict import NextExperiment, Verdict
from softarm.simulator import model_file
from tests.cli.invoke import invoke, refuse, succeed
from tests.cli.trial_folder import write_trial
from tests.diagnosis.rigs.recordings import SERVO, described
from tests.diagnosis.verdicts import effect, gap, rms, verdict, with_parameters

FLIGHT = Path(__file__).parents[2] / "data" / "flight.mcap"
BEFORE, AFTER, CALIBRATED, FLOOR = (rms("kPa", pressure=value) for value in (2.0, 1.0, 0.8, 0.2))
NAMED = verdict(
    "named",
    effect("pressure.dead_time", confidence=0.9, delay=(0.06, 0.05, 0.07, "s")),
    stage="pressure",
    share={"pressure": 1.0},
    gaps=gap(BEFORE, AFTER, FLOOR, calibrated=CALIBRATED),
    next_experiment=NextExperiment(
        excitation="pressure-multisine", separates=("pressure.lag",), expect={"pressure.lag": "a slope at once"}
    ),
    warnings=("one frame is missing",),
)
WHOLE = Model(effects={"arm.stiffness": {"scale": 0.02}})
UNKNOWN = NAMED.model_copy(update={"verdict": "unknown", "effects": (), "next_experiment": None})


@pytest.fixture
def asked(monkeypatch):
    """Replace the diagnosis and return its settings and inputs."""
    asked = SimpleNamespace(verdict=NAMED, patched=Model(effects={}), calibrated=WHOLE, trials=None, model=None)

    def diagnose(trials, model, progress=None, processes=1, budget_s=120.0):
        asked.trials, asked.model, asked.budget_s = trials, model, budget_s
        progress("fitting", 0.5)
        t = np.arange(30) / 30
        overlay = Overlay("pressure", trials[0].name, "seed", "pressure", "kPa", t, t, t + 1, None)
        return Diagnosis(
            asked.verdict, model, asked.patched, (("a", "seed", 1.0),), (overlay,), calibrated=asked.calibrated
        )

    monkeypatch.setattr("softarm.diagnosis.diagnose.diagnose", diagnose)
    return asked


def test_diagnose_writes_verdict_report_and_patch_and_prints_the_answer(asked, tmp_path):
    campaign = write_trial(tmp_path / "campaign" / "a", Model(effects={})).parent
    places = [tmp_path / name for name in ("verdict.json", "report.html", "patched.yaml")]
    outcome = succeed("diagnose", campaign, "--json", places[0], "--report", places[1], "--patch", places[2])
    assert Verdict.model_validate_json(places[0].read_text()) == NAMED
    assert places[1].read_text(encoding="utf-8").startswith("<!doctype html>")
    assert model_file.load(places[2]) == WHOLE
    assert asked.budget_s == 120.0
    bare = succeed("diagnose", campaign, "--no-calibration", "--patch", places[2], "--budget", 30)
    assert "softarm excite pressure-multisine" in " ".join(bare.output.split())
    assert asked.budget_s == 30.0
    assert model_file.load(places[2]) == asked.patched
    output = " ".join(outcome.output.split())
    assert "the regulator starts to react late), delay 60 ms (50 to 70)." in output
    assert "shrinks from 2 to 1 kPa RMS" in output
    assert "warning: one frame is missing" in output
    assert f"softarm excite --plan {places[0]}" in output
    assert [trial.name for trial in asked.trials] == ["a"]


def test_another_rig_gets_a_recording_to_make_instead_of_a_command(asked, tmp_path):
    (set_,) = (NAMED.effects[0].model_copy(update={"equivalents": ("pressure.lag",)}),)
    asked.verdict = NAMED.model_copy(update={"effects": (set_,), "next_experiment": None})
    outcome = invoke("diagnose", write_trial(tmp_path / "c" / "a"))
    output = " ".join(outcome.output.split())
    assert "next: To separate dead_time and lag (pressure): a step: flat foot or slope at once" in output
    assert "softarm excite" not in output


def test_limits_are_measured_from_the_recordings(asked, tmp_path):
    patch = tmp_path / "limits-patch.yaml"
    outcome = succeed("diagnose", FLIGHT, "--limits", patch)
    assert configuration.load(patch) == Config()
    assert "(1 recording, 10 s)" in patch.read_text()
    assert "set-point steps recorded, 59 required: record more with `softarm excite rail-dashes`" in outcome.output
    assert f"wrote {patch}" in outcome.output


def test_a_diagnosed_rail_delay_raises_the_latency_limit(asked, tmp_path):
    """The recording has too few set-point steps to measure the latency itself."""
    late = NAMED.effects[0].model_copy(update={"name": "rail.delay"})
    asked.verdict = NAMED.model_copy(update={"effects": (late,)})
    patch = tmp_path / "limits-patch.yaml"
    outcome = succeed("diagnose", write_trial(tmp_path / "campaign" / "a"), "--limits", patch)
    assert configuration.load(patch).limits.rail.latency_s == 0.07
    output = " ".join(outcome.output.split())
    assert output.count("the diagnosis names rail.delay, 60 ms, 70 at most") == 1
    assert "raise it to 0.07" in output


def test_the_nominal_model_is_the_option_then_the_campaigns_then_the_seed(asked, tmp_path):
    campaign = write_trial(tmp_path / "campaign" / "a", Model(effects={})).parent
    bare = write_trial(tmp_path / "bare" / "b")
    invoke("diagnose", campaign)
    assert asked.model.effects == {}
    invoke("diagnose", campaign / "a")
    assert asked.model.effects == {}
    model_file.save(Model(), tmp_path / "model.yaml")  # beside the campaign, none of its business
    invoke("diagnose", campaign)
    assert asked.model.effects == {}
    invoke("diagnose", campaign, "--model", "no-delay")
    assert asked.model == model_file.load("no-delay")
    outcome = invoke("diagnose", bare)
    assert asked.model == Model()
    assert "the seed's simulator is the nominal model" in outcome.output


def test_campaigns_with_different_models_need_the_model_option(asked, tmp_path):
    one = write_trial(tmp_path / "one" / "a", Model(effects={})).parent
    other = write_trial(tmp_path / "other" / "b", Model()).parent
    refuse("differ; choose one with --model", "diagnose", one, other)
    assert asked.trials is None


def test_without_a_named_effect_no_patch_is_written(asked, tmp_path):
    asked.verdict, asked.patched, asked.calibrated = UNKNOWN, None, None
    trial, patch = write_trial(tmp_path / "c" / "a"), tmp_path / "patched.yaml"
    outcome = succeed("diagnose", trial, "--patch", patch)
    assert "not written, no effect was named and nothing calibrated (verdict: unknown)" in outcome.output
    calibrated = with_parameters(calibration=[("pressure.gain.scale", 0.02, "-")]).calibration
    asked.verdict = UNKNOWN.model_copy(update={"calibration": calibrated})
    outcome = invoke("diagnose", trial, "--patch", patch, "--no-calibration")
    assert "no effect was named (verdict: unknown); for the calibration omit --no-calibration" in outcome.output
    assert not patch.exists()


def test_a_model_that_no_finding_changes_is_not_written(asked, tmp_path):
    (tmp_path / "arm.xml").write_text('<mujoco><worldbody><body><joint name="elbow"/><geom size="1"/></body>'
                                      "</worldbody></mujoco>")  # fmt: skip
    angles = "".join(f"{k / 100},{np.sin(k / 10)}\n" for k in range(200))
    (tmp_path / "run.csv").write_text("t,elbow\n" + angles)
    stage = described(tmp_path, "arm.xml", measured={"elbow": "rad"})
    late = NAMED.effects[0].model_copy(update={"name": "elbow.dead_time"})
    asked.verdict, patch = NAMED.model_copy(update={"effects": (late,)}), tmp_path / "patched.xml"
    outcome = succeed("diagnose", stage, "--patch", patch)
    assert "left out: elbow.dead_time.delay = 0.06: the MJCF has no place for it; --patch FILE" in outcome.output
    assert f"{patch}: not written, since no finding changes the model (see above)" in outcome.output
    assert not patch.exists()


def test_a_patch_with_the_suffix_of_another_format_is_refused(asked, tmp_path):
    trial = write_trial(tmp_path / "c" / "a")
    refuse("--patch: patched.urdf; allowed .yaml", "diagnose", trial, "--patch", "patched.urdf", code=2)
    refuse("stage.yaml of kind mujoco", "diagnose", trial, "--patch", "patched.XML", code=2)
    assert asked.trials is None


def test_data_of_another_rig_may_be_in_another_folder(asked, tmp_path):
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "a.csv").write_text("t,u,y\n" + "".join(f"{k / 10},{k},{k}\n" for k in range(20)))
    (tmp_path / "stage.yaml").write_text(f"name: axis\n{SERVO}")
    for rig in (tmp_path / "stage.yaml", tmp_path):
        asked.trials = None
        succeed("diagnose", rig, "--data", tmp_path / "data")
        assert asked.model is None
        assert asked.trials[0].stage.name == "axis"


def test_the_next_experiment_of_a_verdict_is_played_and_diagnosed(asked, tmp_path):
    plan, config = tmp_path / "a verdict.json", tmp_path / "softarm.yaml"
    plan.write_text(NAMED.model_dump_json())
    config.write_text(f"recorder: {{directory: {tmp_path / 'logs'}}}\n")
    outcome = succeed("excite", "--plan", plan, "--simulated", "--config", config)
    assert "if pressure.lag: a slope at once" in outcome.output
    assert "played pressure-multisine" in outcome.output
    (log,) = (tmp_path / "logs").glob("*.mcap")
    (line,) = [line for line in outcome.output.splitlines() if line.startswith("next: ")]
    assert f"also name the recordings behind {plan}" in outcome.output
    succeed(*shlex.split(line.removeprefix("next: softarm")))
    assert [trial.source for trial in asked.trials] == [log]
    assert Verdict.model_validate_json(plan.read_text()) == NAMED  # still there to be played again
    assert (tmp_path / "a verdict-next.json").is_file()


def planned(excitation, expect=NAMED.next_experiment.expect):
    """Return a verdict with this next experiment, as JSON."""
    following = NextExperiment(excitation=excitation, separates=("pressure.lag",), expect=expect)
    return NAMED.model_copy(update={"next_experiment": following}).model_dump_json()


@pytest.mark.parametrize(
    ("text", "arguments", "message", "code"),
    [
        (UNKNOWN.model_dump_json(), (), "asks for no next experiment; name an excitation", 1),
        ('{"verdict": "none"}', (), "where: Field required; name a file that `softarm diagnose --json` wrote", 1),
        ("no JSON", (), "Invalid JSON", 1),
        (None, (), "cannot be read", 1),
        (NAMED.model_dump_json(), ("seed",), "NAME or --plan, not both", 2),
        (planned("static hang"), (), "no excitation 'static hang'; record the motion of another rig by hand", 1),
        (planned("none separates these: seed", {}), (), "json: none separates these: seed, or name an", 1),
    ],
)
def test_an_unusable_verdict_is_refused_with_the_reason(text, arguments, message, code, tmp_path):
    plan = tmp_path / "verdict.json"
    if text is not None:
        plan.write_text(text)
    outcome = invoke("excite", *arguments, "--plan", plan, "--simulated")
    assert re.search(message, outcome.output)
    assert outcome.exit_code == code
