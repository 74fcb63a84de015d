"""Keys of a stage file for untidy recordings: marks, time windows, differences, name patterns, counted rows."""

import numpy as np
import pytest

from softarm.diagnosis.data.trials import TrialError
from tests.diagnosis.data.servo import COMMAND, MEASURED, T, read, table

PAUSED = np.where(T < 1, 0.0, COMMAND)  # starts with a second of zeros
SHIFTED = 0.3 + MEASURED


def seen(value):
    """Return a table in which three rows of the measurement have another value."""
    measured = SHIFTED.copy()
    measured[120:123] = value
    return table("t,u,y", T, PAUSED, measured)


@pytest.mark.parametrize("marks", ["0", "[0, n/a]"])
def test_marks_of_one_column_leave_the_same_number_in_another(tmp_path, marks):
    (trial,) = read(tmp_path, seen(0.0), ("source: y,", f"source: y, missing: {marks},"))
    assert [len(series) for series in trial.channels.values()] == [200, 197]


def test_marks_of_a_column_replace_those_of_the_table(tmp_path):
    changes = (("source: u,", "source: u, missing: [],"), ("name: servo", "name: servo\ntable: {missing: -9}"))
    (trial,) = read(tmp_path, seen(-9), *changes)
    assert [len(series) for series in trial.channels.values()] == [200, 197]


def test_a_number_marks_missing_values_with_decimal_commas_too(tmp_path):
    text = seen(-999).replace(",", ";").replace(".", ",")
    (trial,) = read(tmp_path, text, ("source: y,", "source: y, missing: -999,"))
    assert trial.channels["measured"]["position"].min() > -1


@pytest.mark.parametrize(
    ("window", "first", "last"), [("from_s: 1.5, to_s: 3", 1.5, 3), ("from_s: 1", 1, 3.98), ("to_s: 2", 0, 2)]
)
def test_a_window_limits_a_trial_to_seconds_after_its_first_row(tmp_path, window, first, last):
    text = table("t,u,y", T + 100, COMMAND, MEASURED)
    (trial,) = read(tmp_path, text, ("name: one", f"name: one, {window}"))
    measured = trial.channels["measured"]
    assert measured.t_s[[0, -1]] - 100 == pytest.approx([first, last])
    assert measured["position"][0] == pytest.approx(MEASURED[np.searchsorted(T, first - 1e-9)], abs=1e-6)


def test_a_command_holds_its_last_value_from_before_the_window(tmp_path):
    text = "t,u\n0,0\n0.5,0.2\n3,0.4\n"
    (tmp_path / "sent.csv").write_text(text)
    files = ("files: data.csv", "from_s: 2, files: {command: sent.csv, measured: data.csv}")
    (trial,) = read(tmp_path, table(), files)
    command = trial.channels["command"]
    assert (command.t_s.tolist(), command["command"].tolist()) == ([2.0, 3.0], [0.2, 0.4])


@pytest.mark.parametrize(("window", "count"), [("to_s: 1.98", 100), ("from_s: 100", 100)])
def test_a_window_cuts_a_recording_where_its_clock_jumps(tmp_path, window, count):
    text = table("t,u,y", T + 100 * (T >= 2), COMMAND, MEASURED)
    with pytest.raises(TrialError, match=r"the clock jumps ahead by 100 s at row 102; .* write `to_s: 1.98`"):
        read(tmp_path, text)
    (trial,) = read(tmp_path, text, ("name: one", f"name: one, {window}"))
    assert len(trial.channels["measured"]) == count
    assert trial.warnings == ()


def test_several_windows_of_one_file_are_several_trials(tmp_path):
    one = "{name: one, kind: sine, files: data.csv}"
    trials = read(tmp_path, table(), (one, "{name: a, files: data.csv, to_s: 2}\n  - " + one.replace("one", "b")))
    assert [(trial.name, len(trial.channels["measured"])) for trial in trials] == [("a", 101), ("b", 200)]


@pytest.mark.parametrize(
    ("window", "says"),
    [
        ("from_s: 3, to_s: 3", r"to_s is 3, not after from_s \(3\); allowed above 3 s; correct one"),
        ("from_s: -1", r"from_s: is -1; allowed 0 or more s"),
        ("from_s: 60", r"trial one: from_s is 60, but the recording lasts 3.98 s; allowed below 3.98 s; correct it"),
        ("from_s: 3.505, to_s: 3.515", r"trial one: no row of the measured channel is between .*; .*correct them"),
        ("from: 1", r"from: unknown key; did you mean from_s\?"),
    ],
)
def test_a_wrong_window_is_refused(tmp_path, window, says):
    with pytest.raises(TrialError, match=says):
        read(tmp_path, table(), ("name: one", f"name: one, {window}"))


def test_a_pattern_names_a_column_that_each_recording_calls_otherwise(tmp_path):
    changes = (("source: y,", "source: 'pos*',"), ("name: one, kind: sine, files: data.csv", "files: '*.csv'"))
    read(tmp_path, table("t,u,pos_7"), *changes, name="r1.csv")
    trials = read(tmp_path, table("t,u,pos [2*pi]"), *changes, name="r2.csv")
    assert [trial.name for trial in trials] == ["r1", "r2"]
    np.testing.assert_array_equal(*(trial.channels["measured"]["position"] for trial in trials))


def test_a_name_with_an_asterisk_is_no_pattern_where_a_column_has_it(tmp_path):
    text = table("t,u,y*,y*2", T, COMMAND, MEASURED, 2 * MEASURED)
    (trial,) = read(tmp_path, text, ("source: y,", "source: 'y*',"))
    np.testing.assert_allclose(trial.channels["measured"]["position"], MEASURED, atol=2e-6)


def test_a_pattern_with_several_columns_is_refused(tmp_path):
    with pytest.raises(TrialError, match=r"y\* fits the columns y1, y2; allowed is one; write more of its name"):
        read(tmp_path, table("t,u,y1,y2", T, COMMAND, MEASURED, MEASURED), ("source: y,", "source: 'y*',"))
    with pytest.raises(TrialError, match=r"no column z\*; it has t, u, y"):
        read(tmp_path, table(), ("source: y,", "source: 'z*',"))


def test_rows_are_counted_where_a_table_has_no_time(tmp_path):
    changes = (("source: t, unit: s", "source: rows, unit: ms, scale: 20"),)
    (trial,) = read(tmp_path, table("u,y", COMMAND, MEASURED), *changes)
    np.testing.assert_allclose(trial.channels["measured"].t_s, T, atol=1e-9)
    named = table("rows,u,y", np.arange(200) + 5, COMMAND, MEASURED)  # a column of that name
    (trial,) = read(tmp_path, named, *changes)
    assert trial.channels["measured"].t_s[0] == pytest.approx(0.1)


def test_equal_names_of_trials_are_refused_with_both_files(tmp_path):
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "run.csv").write_text(table())
    both = "{files: a/run.csv}\n  - {files: 'b/*.csv'}"
    with pytest.raises(TrialError, match=r"two trials are called run; .* e.g. `name: b-run` for .*b/run.csv"):
        read(tmp_path, table(), ("{name: one, kind: sine, files: data.csv}", both))
