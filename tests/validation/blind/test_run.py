"""Running and opening the sealed benchmark: only data decide, runs can be continued, frozen answers stay."""

import json
import shutil

import numpy as np
import pytest
from click.testing import CliRunner

from softarm.common.batch import Workers
from softarm.diagnosis.engine.result import Diagnosis
from softarm.reality.record import record
from softarm.schemas.model import Model
from softarm.simulator import model_file
from tests.diagnosis.verdicts import effect, verdict
from validation.blind import opening, run, seal
from validation.blind.__main__ import main

CASES = ("case-a", "case-b", "case-c")
GAIN = {"name": "pressure.gain", "stage": "pressure", "removed": False, "settings": {}}
CABLE = {"name": "unknown.cable", "stage": "rail", "removed": False, "settings": {}}
KINDS = (("single", [GAIN]), ("none", []), ("unknown", [CABLE]))
LABELS = seal.Labels(
    "5a" * 32, 3, {case: {"kind": kind, "causes": of} for case, (kind, of) in zip(CASES, KINDS, strict=True)}
)


def names_gain(trials, model):
    """Stub of a method whose answer contains everything that it can read."""
    seen = [f"{trial.name} {trial.kind} {trial.source} {trial.warnings} {trial.missing}" for trial in trials]
    rms = float(np.std(trials[0].channels["mocap"]["link5_y"]))
    gain, regime = effect("pressure.gain", confidence=0.8), f"{seen} {rms!r} {sorted(model.effects)}"
    found = verdict("named", gain, stage="pressure", share={"pressure": 1.0}, regime=regime)
    patched = model.model_copy(update={"effects": {**model.effects, "pressure.gain": {}}})
    return Diagnosis(found, model, patched, (), margins={"pressure.gain": 0.4})


@pytest.fixture(scope="module")
def answered(tmp_path_factory):
    """Replace the diagnosis, and return a folder with data, their sealed labels and the frozen answers."""
    folder = tmp_path_factory.mktemp("blind")
    for seed, case in enumerate(CASES):
        record(lambda t: (0.2, 9.0), folder / "data" / case / "trial-1", 0.5, seed=seed, kind="step")
        model_file.save(Model(), folder / "data" / case / "model.yaml")
    seal.write_labels(LABELS, folder / "sealed" / "labels.json", folder / "data")
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(run.METHODS, "diagnose", names_gain)
        run.run(folder / "data", folder / "answers.json", workers=Workers(1))
        yield folder


@pytest.fixture
def data(answered, tmp_path):
    """Return the data of a copy of that folder."""
    shutil.copytree(answered, tmp_path, dirs_exist_ok=True)
    return tmp_path / "data"


def test_a_run_never_reads_the_labels(data, tmp_path):
    (data / seal.COMMITMENT).write_text(json.dumps(seal.commitment(seal.Labels("00" * 32, 4, {}))))
    run.run(data, tmp_path / "other.json", workers=Workers(1))
    shutil.rmtree(tmp_path / "sealed")
    (data / seal.COMMITMENT).unlink()
    run.run(data, tmp_path / "none.json", workers=Workers(1))
    assert len({(tmp_path / f"{name}.json").read_bytes() for name in ("answers", "other", "none")}) == 1
    assert [answer["case"] for answer in json.loads((tmp_path / "none.json").read_text())["answers"]] == [*CASES]


def test_changed_data_or_another_tool_are_answered_again(data, tmp_path, monkeypatch):
    file, seen = tmp_path / "answers.json", []
    monkeypatch.setitem(run.METHODS, "diagnose", lambda t, m: seen.append(t) or names_gain(t, m))
    run.run(data, file, workers=Workers(1))
    assert seen == []
    csv = data / "case-b" / "trial-1" / "pressure.csv"
    csv.write_text("".join(csv.read_text().splitlines(keepends=True)[:-1]))
    run.run(data, file, workers=Workers(1))
    assert len(seen) == 1
    monkeypatch.setattr(seal, "tool_version", lambda: "another")
    run.run(data, file, workers=Workers(1))
    assert len(seen) == 4


def test_an_invalid_run_is_refused(data, tmp_path):
    with pytest.raises(seal.SealError, match="unknown method 'oracle'; allowed are diagnose"):
        run.run(data, tmp_path / "a.json", "oracle")
    with pytest.raises(seal.SealError, match="contains no case"):
        run.run(tmp_path / "nothing", tmp_path / "a.json")
    with pytest.raises(seal.SealError, match="outside"):
        run.run(data, data / "answers.json")


def test_opening_scores_measures_and_writes_the_results(data, tmp_path, monkeypatch):
    file, fresh = tmp_path / "answers.json", tmp_path / "fresh"
    shutil.copytree(data, fresh)
    asked = []

    def measure(trials, nominal, patched):
        asked.append((trials[0].source, sorted(set(patched.effects) - set(nominal.effects))))
        return {"pressure": 0.55, "chain": 0.1}

    monkeypatch.setattr(opening, "measure_shrink", measure)
    labels = tmp_path / "sealed" / "labels.json"
    result = opening.open_labels(data, labels, [file], fresh)
    assert [added for _, added in asked] == [["pressure.gain"]] * 3
    assert all(fresh in source.parents for source, _ in asked)
    measures = result["methods"]["diagnose"]["measures"]
    assert (measures["single, exact"]["hits"], measures["single, exact"]["of"]) == (1, 1)
    assert measures["none, given a name"]["share"] == measures["unknown, given a name"]["share"] == 1.0
    assert result["methods"]["diagnose"]["coverage"]["stage"]["of"] == 3
    assert {wrong["case"] for wrong in result["methods"]["diagnose"]["wrong"]} == {"case-b", "case-c"}


@pytest.mark.parametrize("broken", ["answers", "labels", "data", "incomplete", "twice"])
def test_opening_refuses_anything_changed_after_sealing(data, tmp_path, broken):
    file, labels = tmp_path / "answers.json", tmp_path / "sealed" / "labels.json"
    files = [file]
    if broken == "answers":
        file.write_text(file.read_text().replace("pressure.gain", "rail.gain"))
        expected = "has changed since it was frozen"
    elif broken == "labels":
        labels.write_text(labels.read_text().replace("unknown.cable", "pressure.gain"))
        expected = "case-c"
    elif broken == "data":
        (data / "case-a" / "trial-1" / "rail.csv").unlink()
        expected = "changed after it was answered"
    elif broken == "incomplete":
        content = json.loads(file.read_text())
        content["answers"].pop()
        file.write_text(json.dumps(content))
        seal.freeze(file)
        expected = "case-c"
    else:
        files.append(tmp_path / "copy.json")
        shutil.copy(file, files[1])
        shutil.copy(tmp_path / "answers.json.sha256", tmp_path / "copy.json.sha256")
        expected = "one file for each method"
    with pytest.raises(seal.SealError, match=expected):
        opening.open_labels(data, labels, files)


def invoke(*words):
    return CliRunner().invoke(main, [str(word) for word in words])


def test_the_commands_run_and_open_work(data, tmp_path):
    outcome = invoke("run", data, "--answers", tmp_path / "a.json", "--workers", 1)
    assert outcome.exit_code == 0, outcome.output
    assert "frozen as" in outcome.output
    opened = ("open", data, "--answers", tmp_path / "a.json", "--json", tmp_path / "b.json", "--labels")
    outcome = invoke(*opened, tmp_path / "sealed" / "labels.json")
    assert outcome.exit_code == 0, outcome.output
    assert "| a single effect named exactly | 100 % (1 of 1) |" in outcome.output
    assert "case-c | unknown.cable | named | pressure.gain (0.80)" in outcome.output
    assert json.loads((tmp_path / "b.json").read_text())["methods"]["diagnose"]["cases"] == 3
    outcome = invoke(*opened, tmp_path / "none.json")
    assert outcome.exit_code == 1
    assert "python -m validation.blind make" in outcome.output
