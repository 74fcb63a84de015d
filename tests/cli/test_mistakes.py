"""A mistyped value is met with the nearest there is; a file in the wrong place with what it is."""

import json
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

from softarm.cli.main import main

ROOT = Path(__file__).parents[2]


def run(*arguments):
    return CliRunner().invoke(main, list(map(str, arguments)), prog_name="softarm")


@pytest.mark.parametrize(
    ("line", "near"),
    [
        ("evaluate --policy raech", "did you mean 'reach'?"),
        ("evaluate --policy reach --model nodelay", "did you mean no-delay?"),
        ("evaluate --all --test gird", "did you mean grid?"),
        ("evaluate --all --only raech", "did you mean reach?"),
        ("evaluate --polcy reach", "--policy"),
        ("excite sed --simulated", "did you mean seed?"),
        ("train raech", "did you mean reach?"),
        ("blind run cases --answers a.json --method bics", "did you mean bic?"),
        ("close-gap campaign --out closed --policy reech", "did you mean reach?"),
        ("model diff seed nodely", "did you mean no-delay?"),
        ("polcy", "did you mean 'policy'?"),
        ("policy lits", "did you mean 'list'?"),
    ],
)
def test_what_there_is_none_of_is_met_with_the_nearest(tmp_path, monkeypatch, line, near):
    monkeypatch.chdir(tmp_path)
    result = run(*line.split())
    assert result.exit_code in (1, 2)
    assert near in " ".join(result.stderr.split())


@pytest.mark.parametrize("verb", [["diagnose"], ["identify", "--out", "mine.yaml"]])
@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("seed.yaml", "is a model of the robot; give it as --model, and name recordings"),
        ("softarm.yaml", "is a configuration of the daemon; name recordings, which lie in its recorder.directory"),
        ("verdict.json", "is a verdict; name recordings, `softarm excite --plan` flies what a verdict asks for"),
        ("reach.onnx", "is a policy; name recordings, `softarm evaluate` flies policies"),
    ],
)
def test_a_file_that_is_no_recording_is_told_by_what_it_is(tmp_path, monkeypatch, verb, name, says):
    shutil.copy(ROOT / "simulator" / "models" / "seed.yaml", tmp_path)
    shutil.copy(ROOT / "softarm.yaml", tmp_path)
    (tmp_path / "verdict.json").write_text(json.dumps({"verdict": "none", "effects": []}))
    (tmp_path / "reach.onnx").touch()
    monkeypatch.chdir(tmp_path)
    result = run(*verb, name)
    assert (result.exit_code, result.stderr) == (1, f"{name}: {says}\n")
