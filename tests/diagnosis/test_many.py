"""Diagnosis of many robots and rigs: one table and page, restartable."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from softarm.common.batch import Workers
from softarm.diagnosis import many
from softarm.diagnosis.data.trials import TrialError
from softarm.diagnosis.many import Options
from softarm.schemas.model import Model
from softarm.schemas.verdict import Verdict
from softarm.simulator import model_file
from tests.cli.invoke import refuse, succeed
from tests.cli.trial_folder import write_trial
from tests.diagnosis.report.cases import CASES

HERE = Workers(1)


@pytest.fixture
def asked(monkeypatch, tmp_path):
    """Replace the diagnosis, and return its inputs; the working folder has two robots and a rig."""
    asked = SimpleNamespace(trials=[], models=[], budgets=[], processes=set())

    def diagnose(trials, model, progress=None, processes=1, budget_s=120.0):
        asked.trials.append(trials[0].name)
        asked.models.append(model)
        asked.budgets.append(budget_s)
        asked.processes.add(processes)
        if trials[0].name == "quiet":
            return replace(CASES["unknown"], nominal=model)
        return replace(CASES["named"], nominal=model, calibrated=Model())

    monkeypatch.setattr("softarm.diagnosis.diagnose.diagnose", diagnose)
    monkeypatch.chdir(tmp_path)
    write_trial(tmp_path / "robots" / "one" / "loud", Model(effects={}))
    write_trial(tmp_path / "robots" / "two" / "quiet")
    return asked


ROBOTS = [Path("robots/two"), Path("robots/one")]


def test_each_input_has_its_files_and_all_have_one_page_and_one_table(asked):
    outcome = succeed("diagnose", *ROBOTS, "--out", "reports", "--workers", 1, "--budget", 7)
    out = Path("reports")
    assert Verdict.model_validate_json((out / "one.json").read_text()) == CASES["named"].verdict
    assert model_file.load(out / "one.yaml") == Model()
    assert not (out / "two.yaml").exists()
    rows = json.loads((out / "index.json").read_text())
    assert [(row["name"], row["verdict"]["verdict"], row["patched"]) for row in rows] == [
        ("two", "unknown", False),
        ("one", "named", True),
    ]
    page = (out / "index.html").read_text()
    assert page.index('href="two.html"') < page.index('href="one.html"')
    assert page.count("<tr>") == 3
    assert "took 12 s" not in (out / "one.html").read_text()
    output = " ".join(outcome.output.replace("│", " ").split())
    assert "94 %" in output
    assert "two: no --model and no model.yaml with the trials" in output
    assert (asked.budgets, asked.processes) == ([7.0, 7.0], {1})
    assert asked.models == [Model(), Model(effects={})]


def test_a_restart_diagnoses_the_missing_and_the_changed(asked, monkeypatch):
    out = Path("reports")

    def diagnosed(**settings):
        asked.trials.clear()
        rows = many.diagnose_all(ROBOTS, Options(out, **settings), HERE)
        return asked.trials, rows, {path.name: path.read_bytes() for path in out.glob("*.*")}

    trials, first, content = diagnosed()
    assert trials == ["quiet", "loud"]
    assert diagnosed() == ([], first, content)
    for suffix in ("html", "json", "yaml"):
        (out / f"one.{suffix}").unlink()
        assert diagnosed() == (["loud"], first, content)
    text = (ROBOTS[0] / "quiet" / "pressure.csv").read_text()
    (ROBOTS[0] / "quiet" / "pressure.csv").write_text(text + "1.0,3.0\n")
    assert diagnosed()[0] == ["quiet"]
    model_file.save(Model(), ROBOTS[1] / "model.yaml")
    assert diagnosed()[0] == ["loud"]
    assert diagnosed(model=Path("no-delay"))[0] == ["quiet", "loud"]
    assert diagnosed(budget_s=3.0)[0] == ["quiet", "loud"]
    monkeypatch.setattr(many, "code_version", lambda *names: " ".join(names))
    assert diagnosed()[0] == ["quiet", "loud"]
    kept = json.loads((out / "kept" / "one.json").read_text())
    assert kept["tool"] == "common diagnosis recordings reporting schemas simulator"


def test_results_inside_an_input_are_no_part_of_its_data(asked):
    options = Options(ROBOTS[0] / "reports")
    many.diagnose_all(ROBOTS, options, HERE)
    asked.trials.clear()
    many.diagnose_all(ROBOTS, options, HERE)
    assert asked.trials == []


def test_files_outside_the_folder_of_a_rig_belong_to_its_data(tmp_path):
    stage = tmp_path / "rig" / "stage.yaml"
    stage.parent.mkdir()
    stage.write_text("""
kind: mujoco
channels:
  measured: {time: {source: t, unit: s}, columns: {pan: {source: y, unit: deg}}}
  command: {time: {source: t, unit: s}, columns: {drive: {source: u, unit: deg}}}
model: {mjcf: ../arm.xml}
trials:
  - {name: one, files: {command: ../sent.csv, measured: own.csv}}
""")
    folder, *outside = many.input_files(stage)
    assert folder == stage.parent
    assert {path.resolve() for path in outside} == {tmp_path / "sent.csv", tmp_path / "arm.xml"}
    stage.write_text("trials: 3\n")
    assert many.input_files(stage) == [folder]


def test_only_an_own_patch_of_an_earlier_answer_is_deleted(asked):
    out, own = Path("reports"), Path("reports/two.yaml")
    out.mkdir()
    own.write_text("rate: 30\n")

    def diagnosed():
        many.diagnose_all(ROBOTS, Options(out), HERE)
        return sorted(path.name for path in out.glob("*.yaml"))

    assert diagnosed() == ["one.yaml", "two.yaml"]  # robot two has no patch
    (ROBOTS[1] / "loud" / "trial.yaml").unlink()
    assert diagnosed() == ["two.yaml"]
    assert own.read_text() == "rate: 30\n"


def test_a_failure_has_a_row_and_the_others_continue(asked):
    Path("robots/empty").mkdir()
    command = ("diagnose", "robots/empty", *ROBOTS, "--out", "reports", "--workers", 1)
    refuse("robots/empty: robots/empty: contains no trial", *command)
    rows = json.loads(Path("reports/index.json").read_text())
    assert [bool(row["failure"]) for row in rows] == [True, False, False]
    assert rows[0]["verdict"] is None
    assert 'href="empty.html"' not in Path("reports/index.html").read_text()
    shutil.rmtree("robots/empty")
    write_trial(Path("robots/empty/loud"))
    succeed(*command)
    assert asked.trials == ["quiet", "loud", "loud"]


def test_every_diagnosis_may_fail_also_without_a_text(asked, monkeypatch):
    def full(*given, **more):
        raise MemoryError

    monkeypatch.setattr(many, "diagnose_files", full)
    refuse("robots/two: MemoryError", "diagnose", *ROBOTS, "--out", "reports", "--workers", 1)


def test_names_are_the_parts_of_the_paths_that_differ():
    given = [Path(name) for name in ("a/x", "b/x", "b/rig/stage.yaml", "b/y.mcap")]
    assert list(many.names(given)) == ["a-x", "b-x", "b-rig", "b-y.mcap"]
    assert list(many.names(given[1:])) == ["x", "rig", "y.mcap"]
    assert list(many.names([Path("a/index")])) == ["a-index"]
    assert list(many.names([Path("/data/x"), Path("/mnt/data/x")])) == ["data-x", "mnt-data-x"]
    for twice in (["b/rig", "b/rig/stage.yaml"], ["a", "b/../a"]):
        with pytest.raises(TrialError, match="is given twice"):
            many.names(list(map(Path, twice)))
    assert list(many.names([Path("a/.."), Path("/a/b")])) == [Path.cwd().name, "b"]
    for nameless in (["/index"], ["/"], ["/a-b/c", "/a/b-c", "/d/c", "/d/b-c"]):
        with pytest.raises(TrialError, match="gives its results no name; allowed is any but index"):
            many.names(list(map(Path, nameless)))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--out", "reports", "--json", "a.json"), "--json is for one diagnosis"),
        (("--workers", "2"), "--workers is for many diagnoses: add --out FOLDER"),
        (("--ray", "local"), "--ray is for many diagnoses"),
    ],
)
def test_options_of_one_and_of_many_diagnoses_are_not_mixed(asked, options, words):
    refuse(words, "diagnose", *ROBOTS, *options, code=2)
