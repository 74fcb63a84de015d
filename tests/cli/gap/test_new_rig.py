"""Tests of `softarm new rig`: the written stage file is read back, and nothing is overwritten silently."""

import numpy as np
import pytest

from softarm.cli.gap import new_rig
from softarm.diagnosis.data import tables
from tests.cli.invoke import invoke, refuse, succeed
from tests.diagnosis.data import servo

T = np.arange(200) * 0.02
COMMAND, MEASURED = 30 * np.sin(3 * T), 30 * np.sin(3 * (T - 0.1))


def record(path, head, *columns):
    path.parent.mkdir(exist_ok=True)
    path.write_text(servo.table(head, *columns, delimiter=";", decimal=","))


@pytest.fixture
def runs(tmp_path, monkeypatch):
    """Return the folder of two recordings, next to the current folder's stage.yaml."""
    monkeypatch.chdir(tmp_path)
    for name in ("steps-01", "chirp"):
        record(tmp_path / "runs" / f"{name}.csv", "t/ms;soll [deg];angle [deg]", 1e3 * T, COMMAND, MEASURED)
    return "runs"


def test_the_written_file_is_checked_and_the_next_command_printed(runs, tmp_path):
    result = succeed("new", "rig", runs, "--name", "servo", "--nominal", "lag_s=0.1")
    lines = result.stdout.splitlines()
    assert "wrote stage.yaml" in lines
    assert "stage.yaml: valid; 2 trials of servo (tracking)" in lines
    assert lines[-2:] == ["next:", "  softarm diagnose stage.yaml --report stage.html"]
    trials = tables.read(tmp_path / "stage.yaml")
    assert [(t.name, t.kind, t.stage.model, t.warnings) for t in trials] == [
        ("chirp", "chirp", {"lag_s": 0.1}, ()),
        ("steps-01", "steps", {"lag_s": 0.1}, ()),
    ]
    np.testing.assert_allclose(trials[0].channels["measured"]["position"], np.radians(MEASURED), atol=1e-5)


def test_every_key_of_the_written_file_is_explained(runs, tmp_path):
    result = succeed("new", "rig", runs)
    assert "next: complete `model:` in stage.yaml with the values of your simulator, then\n" in result.stdout
    lines = (tmp_path / "stage.yaml").read_text().splitlines()
    for key in ("name:", "kind:", "channels:", "model:", "trials:"):
        at = next(i for i, line in enumerate(lines) if line.startswith(key))
        assert lines[at - 1].startswith("# ")
    assert '      command: {source: "soll [deg]", unit: deg}  # -30 to 30; unit from the header' in lines
    assert "  - {name: steps-01, kind: steps, files: runs/steps-01.csv}  # 200 rows, 3.98 s" in lines
    assert any(line.startswith("  # lag_s: 0 ") and "time constant" in line for line in lines)


@pytest.mark.parametrize(
    ("model", "option", "value", "says"),
    [
        ((), "--angles", "relative", "--angles is for chain; this mechanism is tracking: omit it"),
        ((), "--base", "angle", "--base is for pendulum, chain; this mechanism is tracking: omit it"),
        (("arm.xml",), "--kind", "chain", "--kind is for tracking, driven_mass, pendulum, chain; this mechanism is mu"),
    ],
)
def test_an_option_that_the_kind_does_not_use_is_refused(runs, tmp_path, model, option, value, says):
    (tmp_path / "arm.xml").write_text('<mujoco><worldbody><body><joint name="angle"/><geom size="1"/></body>'
                                      "</worldbody></mujoco>")  # fmt: skip
    refuse(says, "new", "rig", *model, runs, option, value, code=2)
    assert not (tmp_path / "stage.yaml").exists()


def test_a_file_is_not_overwritten_silently(runs, tmp_path, monkeypatch):
    (tmp_path / "stage.yaml").write_text("mine")
    result = invoke("new", "rig", runs)
    assert result.exit_code == 1
    assert result.stderr == ("stage.yaml: exists and is not overwritten; choose another --out, or add --overwrite\n")
    monkeypatch.setattr(new_rig, "is_terminal", lambda: True)
    assert invoke("new", "rig", runs, input="n\n").exit_code == 1
    assert (tmp_path / "stage.yaml").read_text() == "mine"
    succeed("new", "rig", runs, input="y\n")
    succeed("new", "rig", runs, "--overwrite")


@pytest.fixture
def bare(tmp_path, monkeypatch):
    """Return a recording whose headers say nothing."""
    monkeypatch.chdir(tmp_path)
    record(tmp_path / "run.csv", "a;b;c", T, COMMAND, MEASURED)
    return "run.csv"


def test_without_a_terminal_missing_facts_are_errors_with_their_options(bare, tmp_path):
    result = invoke("new", "rig", bare)
    assert result.exit_code == 1
    assert result.stderr == (
        "--kind is missing: kind of mechanism (the headers do not show it); allowed tracking, driven_mass, pendulum, "
        "chain; add e.g. --kind tracking\n"
    )
    result = invoke("new", "rig", bare, "--kind", "tracking")
    assert [line.partition(";")[2] for line in result.stderr.splitlines()] == [
        " add e.g. --unit b=UNIT",
        " add e.g. --unit c=UNIT",
    ]
    assert not (tmp_path / "stage.yaml").exists()
    succeed("new", "rig", bare, "--kind", "tracking", "--unit", "b=deg", "--unit", "c=deg")


def test_at_a_terminal_missing_facts_are_asked_for_until_they_fit(bare, tmp_path, monkeypatch):
    monkeypatch.setattr(new_rig, "is_terminal", lambda: True)
    result = succeed("new", "rig", bare, input="\nfoot\ndeg\ndeg\n")
    assert "Kind of mechanism (the headers do not show it)" in result.output
    assert "--unit b=foot: no unit 'foot'" in result.stderr
    (trial,) = tables.read(tmp_path / "stage.yaml")
    assert trial.stage.units["command"]["command"].name == "deg"


def test_a_file_that_does_not_pass_its_check_is_kept_with_the_next_step(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    record(tmp_path / "run.csv", "t;soll [deg];angle [deg]", 0.1 * T, COMMAND, MEASURED)
    result = invoke("new", "rig", "run.csv")
    assert result.exit_code == 1
    assert "200 rows over 0.398 s; the command channel" in result.stderr or "needs 20 rows over 0.8 s" in result.stderr
    assert result.stdout.endswith("next: correct stage.yaml, then\n  softarm check stage.yaml\n")
    assert (tmp_path / "stage.yaml").exists()
