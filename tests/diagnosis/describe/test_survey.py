"""Survey of recordings: files that belong together, columns, marks of missing values."""

import time

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from scipy.io import savemat

from softarm.diagnosis.data.trials import TrialError
from softarm.diagnosis.describe.survey import survey
from tests.diagnosis.describe.conftest import T, U, Y


def labels(found):
    return [signal.label for signal in found.signals]


def test_files_with_the_same_columns_are_recordings(table, tmp_path):
    for name in ("steps-1.csv", "steps-2.csv", "deep/steps-1.csv"):
        table(name, "t,u,y", T, U, Y)
    (tmp_path / "README.txt").write_text("about these\n")
    found = survey([tmp_path])
    assert [(r.name, r.kind) for r in found.recordings] == [
        ("deep-steps-1", "steps"),
        (f"{tmp_path.name}-steps-1", "steps"),
        ("steps-2", "steps"),
    ]
    assert labels(found) == ["t", "u", "y"]
    assert found.unused == ("README.txt: has no rows; record some, or remove the file",)


def test_files_of_two_devices_are_paired_by_folder(table, tmp_path):
    for run in ("a", "b"):
        table(f"{run}/control.csv", "t,angle", T, U)
        table(f"{run}/state.csv", "t,angle,rate", T, Y, Y)
        table(f"{run}/note.csv", "t", T)
    found = survey([tmp_path])
    assert [(r.name, [f.name for f in r.files.values()]) for r in found.recordings] == [
        ("a", ["control.csv", "state.csv"]),
        ("b", ["control.csv", "state.csv"]),
    ]
    assert labels(found) == ["control:t", "control:angle", "state:t", "state:angle", "rate"]
    assert found.unused == ("note.csv: has no two columns of numbers (2 files)",)


def test_files_of_two_devices_are_paired_by_the_varying_part_of_their_names(table, tmp_path):
    for run in ("1", "2"):
        table(f"run{run}_cmd.csv", "t,u", T, U)
        table(f"run{run}_seen.csv", "t,y", T, Y)
    assert [r.name for r in survey([tmp_path]).recordings] == ["run1", "run2"]


def test_extra_columns_of_some_recordings_are_left_out(table, tmp_path):
    table("one.csv", "t,u,y", T, U, Y)
    table("two.csv", "t,u,y,z", T, U, Y, Y)
    assert labels(survey([tmp_path])) == ["t", "u", "y"]


def test_a_file_without_its_partner_is_left_out(table, tmp_path):
    for run in ("a", "b"):
        table(f"{run}/sent.csv", "t,u", T, U)
    table("a/seen.csv", "t,y", T, Y)
    found = survey([tmp_path])
    assert [r.name for r in found.recordings] == ["a"]
    assert found.unused == ("sent.csv: has no file with the other columns",)


def test_files_that_do_not_pair_up_are_refused(table, tmp_path):
    for name, head in (("a", "t,u"), ("b", "x,y"), ("c", "t,u")):
        table(f"{name}.csv", head, T, U)
    with pytest.raises(TrialError, match=r"files with different columns do not pair up: .*a.csv: t, u; .*b.csv: x, y;"):
        survey([tmp_path])


@pytest.mark.parametrize(
    ("value", "rows", "marks"),
    [
        (-999.0, range(100, 180), (-999,)),
        (0.0, (150,), (0,)),
        (0.0, range(200, 300), ()),  # the end of an excitation
        (60.0, (150,), ()),  # a step that a sensor may show
    ],
)
def test_numbers_that_stand_for_missing_values_are_found(table, value, rows, marks):
    seen = 80 + Y
    seen[list(rows)] = value
    found = survey([table("run.csv", "t,u,y", T, U, seen)])
    assert found.signals[2].marks == marks
    assert np.isnan(found.signals[2].values[0]).sum() == (len(list(rows)) if marks else 0)


def test_a_pause_of_a_command_is_no_missing_value(table):
    t = np.arange(400) * 0.02
    u = np.where(t % 2 < 1, 5.0, 0.0)
    assert survey([table("run.csv", "t,u,y", t, u, u + 0.01 * t)]).signals[1].marks == ()


def test_texts_in_a_column_of_numbers_are_marks_and_a_row_of_units_is_read(table):
    path = table("run.csv", "t;eins;zwei\ns;deg;bar", T, U, Y, delimiter=";", decimal=",")
    path.write_text(path.read_text().replace("\n0,100000000;", "\n---;"))
    t, one, two = survey([path]).signals
    assert [each.header.unit for each in (t, one, two)] == ["s", "deg", "bar"]
    assert (t.marks, one.marks) == (("---", "s"), ("deg",))


def test_lines_above_the_header_and_decimal_commas_in_quotes_are_found(table):
    path = table("run.csv", "Logger 3\nmade on Tuesday\nt,u,y", T, U, Y)
    assert survey([path]).form.skip == 2
    path.write_text("t,u\n" + "".join(f'"{k},5","{k},25"\n' for k in range(50)))
    found = survey([path])
    assert found.form.decimal == ","
    assert found.signals[1].all[:2].tolist() == [0.25, 1.25]


def test_columns_without_a_header_are_numbered(table):
    assert [s.source for s in survey([table("run.csv", "", T, U, Y)]).signals] == [1, 2, 3]


def test_matlab_cells_become_segments_and_rows_become_signals(tmp_path):
    cells = {name: np.empty((1, 2), dtype=object) for name in ("Time_id", "Y_id")}
    for i in range(2):
        cells["Time_id"][0, i], cells["Y_id"][0, i] = T[None], np.stack([U, Y])
    savemat(tmp_path / "swing.mat", cells | {"about": "text", "mass": 3.0})
    found = survey([tmp_path])
    assert [(r.name, r.segment) for r in found.recordings] == [("swing-id-0", "id[0]"), ("swing-id-1", "id[1]")]
    assert labels(found) == ["Time_{segment}", "Y_{segment}#0", "Y_{segment}#1"]


def test_matlab_signals_of_one_length_share_a_clock(tmp_path):
    savemat(tmp_path / "run.mat", {"t": T, "cmd": U, "t2": T[::2], "pos": Y[::2], "alone": np.arange(70.0)})
    assert [(s.label, s.group) for s in survey([tmp_path]).signals] == [("t", 0), ("cmd", 0), ("t2", 1), ("pos", 1)]


def test_two_columns_of_one_name_are_refused(table):
    with pytest.raises(TrialError, match="two columns are called a; rename one"):
        survey([table("run.csv", "t,a,a", T, U, Y)])


def test_lists_of_different_lengths_are_no_signal(tmp_path):
    rows = "".join(f'{k / 50},{k % 7},"{[k] * (1 + k % 2)}"\n' for k in range(50))
    (tmp_path / "run.csv").write_text("t,u,lists\n" + rows)
    assert labels(survey([tmp_path])) == ["t", "u"]


def test_parquet_dates_lists_and_gaps_are_read(tmp_path):
    stamps = np.datetime64("2026-11-23T10:00:00", "us") + (T * 1e6).astype("timedelta64[us]")
    lists = [[0.0, value] for value in U]
    parquet.write_table(pa.table({"at": stamps, "cmd": lists, "y": Y}), tmp_path / "run.parquet")
    at, cmd, seen = survey([tmp_path]).signals
    assert at.dates
    assert (cmd.elements, seen.elements) == (2, 0)
    np.testing.assert_allclose(cmd.values[0], U)


def test_dates_without_a_time_zone_are_not_local_times(tmp_path, monkeypatch):
    """The stamps cross the end of summer time in Berlin."""
    monkeypatch.setenv("TZ", "Europe/Berlin")
    time.tzset()
    rows = (f"2026-10-25T02:59:{30 + k / 2:04.1f},{k % 7}" for k in range(60))
    (tmp_path / "run.csv").write_text("\n".join(["t,u", *rows, "2026-10-25T03:00:00.0,1", ""]))
    try:
        stamps = survey([tmp_path]).signals[0].values[0]
    finally:
        monkeypatch.undo()
        time.tzset()
    np.testing.assert_allclose(np.diff(stamps), 0.5)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("nowhere", "nowhere: does not exist; name the files or folders of your recordings"),
        ("empty", "empty: contains no table"),
        ("robot", "robot: a trial of the robot; `softarm diagnose` reads it without a stage file"),
        ("words.csv", "words.csv: no file has two columns of numbers; name others"),
    ],
)
def test_what_is_no_recording_of_a_rig_is_refused(tmp_path, name, says):
    (tmp_path / "empty").mkdir()
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot" / "trial.yaml").write_text("kind: chirp\n")
    (tmp_path / "words.csv").write_text("a,b\n" + "x,y\n" * 30)
    with pytest.raises(TrialError, match=says):
        survey([tmp_path / name])
