"""Forms of tables: delimiters, decimal commas, headers, missing values, several mechanisms, file patterns."""

import re
from pathlib import Path

import numpy as np
import pytest

from softarm.diagnosis.data import tables
from softarm.diagnosis.data.stage_file import kind_of
from softarm.diagnosis.data.trials import TrialError
from tests.diagnosis.data.servo import COMMAND, MEASURED, STAGE, T, changed, read, table

ONE = "{name: one, kind: sine, files: data.csv}"
NUMBERED = (("source: t", "source: 1"), ("source: u", "source: 2"), ("source: y", "source: 3"))


def assert_valid(trial):
    np.testing.assert_allclose(trial.channels["measured"].t_s, T, atol=1e-8)
    np.testing.assert_allclose(trial.channels["command"]["command"], COMMAND, atol=1e-8)
    np.testing.assert_allclose(trial.channels["measured"]["position"], MEASURED, atol=1e-8)
    assert trial.warnings == ()


@pytest.mark.parametrize(
    ("delimiter", "decimal", "head", "coding"),
    [
        (",", ".", "t,u,y", "utf-8"),
        (";", ".", "t;u;y", "utf-8"),
        ("\t", ",", "t\tu\ty", "utf-16"),  # a spreadsheet's Unicode text
        (" ", ".", "t u y", "utf-8"),
        (";", ",", "sep=;\nt;u;y", "utf-8-sig"),
        (",", ".", "# logged on a Tuesday\n\nt, u, y", "utf-8"),
    ],
)
def test_a_text_table_is_read_with_any_delimiter(tmp_path, delimiter, decimal, head, coding):
    text = table(head, T, COMMAND, MEASURED, delimiter=delimiter, decimal=decimal)
    (trial,) = read(tmp_path, text, coding=coding)
    assert_valid(trial)


def test_a_table_format_can_be_declared(tmp_path):
    text = table("made by a logger;;\nt;u;y", T, COMMAND, MEASURED, delimiter=";", decimal=",")
    form = 'table: {skip: 1, delimiter: ";", decimal: ",", header: true}\n'
    (trial,) = read(tmp_path, text, stage=STAGE + form)
    assert_valid(trial)
    with pytest.raises(TrialError, match=r"column t, row 3: '0,000000000' is not a finite number; .*decimal: ','"):
        read(tmp_path, text, stage=STAGE + form.replace('","', '"."'))


@pytest.mark.parametrize("head", ["", "t,u,y"])
def test_columns_may_be_named_by_number(tmp_path, head):
    (trial,) = read(tmp_path, table(head, T, COMMAND, MEASURED), *NUMBERED)
    assert_valid(trial)


def test_rows_with_missing_values_are_left_out(tmp_path):
    gone = MEASURED.copy()
    gone[50:60] = -9999
    lines = table("t,u,y", T, COMMAND, gone).splitlines()
    lines[101] = lines[101].rpartition(",")[0] + ",n/a"
    (trial,) = read(tmp_path, "\n".join(lines), stage=STAGE + "table: {missing: [-9999, n/a]}\n")
    keep = np.delete(np.arange(200), [*range(50, 60), 100])
    np.testing.assert_allclose(trial.channels["measured"].t_s, T[keep], atol=1e-8)
    np.testing.assert_allclose(trial.channels["measured"]["position"], MEASURED[keep], atol=1e-8)
    assert len(trial.channels["command"]) == 200


def test_a_column_is_scaled_after_others_are_subtracted(tmp_path):
    column = "{source: a, minus: [b, c], scale: 0.087890625, unit: deg, add: 0.1}"
    counts = np.round(np.degrees(MEASURED - 0.1) / 0.087890625)
    text = table("t,u,a,b,c", T, COMMAND, counts + 2048, np.full(200, 2000.0), np.full(200, 48.0))
    (trial,) = read(tmp_path, text, ("{source: y, unit: rad}", column))
    np.testing.assert_allclose(trial.channels["measured"]["position"], MEASURED, atol=1e-3)
    own = trial.stage.units["measured"]["position"]
    assert (own.name, own.standard) == ("deg", "rad")


def test_a_pattern_gives_a_trial_for_each_matching_file(tmp_path):
    stage = changed(STAGE, (ONE, "{files: 'runs/*.csv'}"))
    kinds = {"chirp_7": "chirp", "slow": "slow", "steps-01": "steps", "steps-02": "steps"}
    for name in kinds:
        trials = read(tmp_path, table(), stage=stage, name=f"runs/{name}.csv")
    assert [(t.name, t.kind) for t in trials] == list(kinds.items())
    assert trials[0].source.name == "chirp_7.csv"
    for trial in trials:
        assert_valid(trial)
    stage = changed(stage, ("{files", "{name: week, kind: mixed, files"))
    assert [t.name for t in read(tmp_path, table(), stage=stage)] == [f"week-{name}" for name in kinds]
    stage = changed(stage, ("'runs/*.csv'", "{command: 'runs/*.csv', measured: 'runs/ste*.csv'}"))
    with pytest.raises(TrialError, match=r"there is no .*stechirp_7.csv for the other channels of chirp_7; add it"):
        read(tmp_path, table(), stage=stage)


def test_files_of_two_channels_are_paired_by_the_wildcard(tmp_path):
    for run in ("a", "b"):
        (tmp_path / run).mkdir()
        (tmp_path / run / "sent.csv").write_text(table("t,u", T, COMMAND))
        (tmp_path / run / "seen.csv").write_text(table("t,y", T, MEASURED))
    trials = read(tmp_path, "", (ONE, "{files: {command: '*/sent.csv', measured: '*/seen.csv'}}"))
    assert [t.name for t in trials] == ["a", "b"]
    assert_valid(trials[1])


@pytest.mark.parametrize(
    "pattern",
    ["**/data-*.csv", "deep/d*/data-*.csv", "../*/deep/down/data-?.csv", "deep/**/data-[ab].csv", "**/data-[!c].csv"],
)
def test_a_pattern_may_contain_folders(tmp_path, pattern):
    for name in ("a", "c", "b") if "!" in pattern else ("a", "b"):
        trials = read(tmp_path / "here", table(), (ONE, f"{{files: '{pattern}'}}"), name=f"deep/down/data-{name}.csv")
    assert len({t.name for t in trials}) == 2
    assert all(t.name.endswith(("a", "b")) for t in trials)


SEVERAL = """
mechanisms:
  pan:
    kind: tracking
    channels:
      command: {time: {source: t, unit: s}, columns: {command: {source: u, unit: rad}}}
      measured: {time: {source: t, unit: s}, columns: {position: {source: y, unit: rad}}}
    model: {lag_s: 0.02}
  tilt:
    kind: tracking
    channels:
      command: {time: {source: t, unit: s}, columns: {command: {source: u, unit: rad}}}
      measured: {time: {source: t, unit: s}, columns: {position: {source: y, unit: rad}}}
trials:
  - {name: one, kind: sine, files: data.csv}
"""


def test_one_file_may_describe_several_mechanisms(tmp_path):
    pan, tilt = read(tmp_path, table(), stage=SEVERAL)
    assert (pan.name, pan.stage.name, tilt.name, tilt.stage.name) == ("one/pan", "pan", "one/tilt", "tilt")
    assert (pan.stage.model, tilt.stage.model) == ({"lag_s": 0.02}, {})
    assert_valid(tilt)


ARMS = """
mechanisms:
  left:
    kind: mujoco
    channels: {measured: {time: {source: t, unit: s}, columns: {elbow: {source: u, unit: rad}}}}
    model: {mjcf: left.xml}
  right:
    kind: mujoco
    channels: {measured: {time: {source: t, unit: s}, columns: {elbow: {source: y, unit: rad}}}}
    model: {mjcf: right.xml}
trials:
  - {name: one, kind: sine, files: data.csv}
"""


@pytest.mark.parametrize("stage", [ARMS, ARMS.replace("right.xml", "left.xml")])
def test_two_mechanisms_with_one_joint_are_refused(tmp_path, stage):
    with pytest.raises(TrialError, match="mechanisms left and right both have elbow; allowed is one; rename it"):
        read(tmp_path, table(), stage=stage)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("lag_s", "lags", r"stage.yaml:8: mechanisms.pan.model.lags: unknown key; did you mean lag_s\?"),
        (f"trials:\n  - {ONE}", "", r"trials: pan, tilt has none; add `trials`"),
        ("    kind: tracking\n    chan", "    chan", r"mechanisms.pan: kind is missing; allowed 'tracking' or"),
        ("mechanisms:", "mechanism:", r"stage.yaml:2: mechanism: unknown key; did you mean mechanisms\?"),
    ],
)
def test_a_mistake_in_one_of_several_mechanisms_is_reported_with_its_line(tmp_path, old, new, says):
    with pytest.raises(TrialError, match=says):
        read(tmp_path, table(), stage=SEVERAL.replace(old, new, 1))


@pytest.mark.parametrize(
    ("file", "called"), [("bench 2/stage.yaml", "bench_2"), ("gripper.yaml", "gripper"), ("-/stage.yaml", "stage")]
)
def test_a_mechanism_without_a_name_is_named_after_its_file_or_folder(tmp_path, file, called):
    place = tmp_path / file
    place.parent.mkdir(exist_ok=True)
    place.write_text(STAGE.replace("name: servo\n", ""))
    (place.parent / "data.csv").write_text(table())
    (trial,) = tables.read(place)
    assert trial.stage.name == called


@pytest.mark.parametrize(("name", "kind"), [("steps-01", "steps"), ("chirp7", "chirp"), ("run.3", "run"), ("12", "12")])
def test_the_kind_of_a_trial_is_its_name_without_the_number(name, kind):
    assert kind_of(name) == kind


def test_the_example_in_the_docs_is_valid(tmp_path):
    page = (Path(__file__).parents[3] / "docs" / "reference" / "trials.md").read_text(encoding="utf-8")
    example = page.partition("### An example")[2]
    head = re.search(r"```\n(.*?\n)", example)[1]
    stage = re.search(r"```yaml\n(.*?)```", example, re.DOTALL)[1]
    volts, degrees = np.where(np.sin(2 * T) < 0, 1.0, 9.0), 30 * np.sin(3 * T)
    chamber = np.interp(volts, (0, 5, 10), (0, 400, 1000)) + 1013
    columns = (1e3 * T, volts, chamber, np.full(200, 1013), degrees, 2048 + np.round(degrees / 0.087890625))
    text = table(head.strip(), *columns, delimiter=";", decimal=",")
    for name in ("runs/steps-01.csv", "runs/chirp-01.csv"):
        trials = read(tmp_path, text, stage=stage, name=name)
    names = [f"{kind}-01/{own}" for own in ("chamber", "arm") for kind in ("chirp", "steps")]
    assert [t.name for t in trials] == names
    assert [t.kind for t in trials] == ["chirp", "steps"] * 2
    assert [t.warnings for t in trials] == [()] * 4
    chamber, arm = trials[0], trials[2]
    assert chamber.stage.model["map"] == ((0, 0), (5, 40), (10, 100))
    assert np.unique(chamber.channels["measured"]["pressure"]) == pytest.approx([8, 88])
    np.testing.assert_allclose(np.degrees(arm.channels["measured"]["position"]), degrees, atol=0.05)
