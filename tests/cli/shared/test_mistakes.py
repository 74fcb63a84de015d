"""Tests of messages for misspelt names and files of the wrong kind."""

import json
import shutil
from pathlib import Path

import pytest

from tests.cli.invoke import invoke

ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize(
    ("line", "near"),
    [
        ("evaluate --policy raech", "did you mean 'reach'?"),
        ("evaluate --policy reach --model nodelay", "did you mean no-delay?"),
        ("evaluate --all --test gird", "did you mean grid?"),
        ("evaluate --all --only raech", "did you mean reach?"),
        ("evaluate --polcy reach", "--policy"),
        ("excite sed --simulated", "did you mean seed?"),
        ("close-gap campaign --out closed --robot no-dely", "did you mean no-delay?"),
        ("train raech", "did you mean reach?"),
        ("blind run cases --answers a.json --method bics", "did you mean bic?"),
        ("close-gap campaign --out closed --policy reech", "did you mean reach?"),
        ("model diff seed nodely", "did you mean no-delay?"),
        ("polcy", "did you mean 'policy'?"),
        ("policy lits", "did you mean 'list'?"),
        ("goal xyzzy", "`softarm goal --help` lists the verbs."),
        ("xyzzy", "`softarm --help` lists the verbs"),
        (f"twin --config {ROOT}/twin.yaml --model no-dely", "did you mean no-delay?"),
    ],
)
def test_a_misspelt_name_is_refused_with_the_nearest(tmp_path, monkeypatch, line, near):
    monkeypatch.chdir(tmp_path)
    result = invoke(*line.split())
    assert result.exit_code in (1, 2)
    assert near in " ".join(result.stderr.split())


@pytest.mark.parametrize("verb", [["diagnose"], ["identify", "--out", "mine.yaml"]])
@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("seed.yaml", "is a model of the robot; give it as --model, and name recordings"),
        ("softarm.yaml", "is a configuration of the daemon; name recordings, which are in its recorder.directory"),
        (
            "verdict.json",
            "is a verdict; name recordings here, and play its next experiment with `softarm excite --plan`",
        ),
        ("reach.onnx", "is a policy; name recordings here, and fly policies with `softarm evaluate`"),
    ],
)
def test_a_file_that_is_not_a_recording_is_recognised(tmp_path, monkeypatch, verb, name, message):
    shutil.copy(ROOT / "softarm" / "simulator" / "models" / "seed.yaml", tmp_path)
    shutil.copy(ROOT / "softarm.yaml", tmp_path)
    (tmp_path / "verdict.json").write_text(json.dumps({"verdict": "none", "effects": []}))
    (tmp_path / "reach.onnx").touch()
    monkeypatch.chdir(tmp_path)
    result = invoke(*verb, name)
    assert (result.exit_code, result.stderr) == (1, f"{name}: {message}\n")


@pytest.mark.parametrize("verb", ["view --no-open", "logs export --to csv", "logs recover", "events", "replay"])
def test_a_file_that_is_not_a_log_is_refused(tmp_path, monkeypatch, verb):
    (tmp_path / "a.mcap").write_text("no log")
    monkeypatch.chdir(tmp_path)
    result = invoke(*verb.split(), "a.mcap")
    assert result.exit_code == 1
    assert result.stderr.startswith("a.mcap: not a log; a log is an MCAP file, as the recorder writes it")
