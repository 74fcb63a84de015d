"""Trial folders of CSV or Parquet files: exact values, and errors that name file, column and row."""

import csv
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import csv as arrow_csv
from pyarrow import parquet

from softarm.diagnosis.data import folder
from softarm.diagnosis.data.read import read_all, sources
from softarm.diagnosis.data.trials import Series, TrialError


def write(trial, folder):
    """Write a trial as a folder that another stack might have recorded."""
    folder.mkdir(parents=True)
    (folder / "trial.yaml").write_text(f"kind: {trial.kind}\nrail: {trial.rail}\n")
    for name, series in trial.channels.items():
        with (folder / f"{name}.csv").open("w", newline="") as file:
            out = csv.writer(file)
            out.writerow(["t_capture" if name == "mocap" else "t", *series.columns])
            out.writerows(zip(series.t_s.tolist(), *(v.tolist() for v in series.columns.values()), strict=True))
    return folder


@pytest.fixture(scope="module")
def short(record):
    return record("pressure-multisine", length_s=1.0)


@pytest.fixture
def written(short, tmp_path):
    return write(short, tmp_path / "campaign" / "one")


def assert_same(trial, recorded):
    assert trial.channels.keys() == recorded.channels.keys()
    for name, series in recorded.channels.items():
        np.testing.assert_array_equal(trial.channels[name].t_s, series.t_s)
        for column, values in series.columns.items():
            np.testing.assert_array_equal(trial.channels[name][column], values, err_msg=f"{name}.{column}")


def test_values_and_stamps_are_read_exactly(short, written):
    trial = folder.read(written)
    assert (trial.kind, trial.rail, trial.name) == ("pressure-multisine", "free", "one")
    assert_same(trial, short)
    assert trial.warnings == ()
    assert set(trial.not_observable) == {"observation"}


def test_a_missing_file_makes_its_stages_unobservable(written):
    (written / "pressure.csv").unlink()
    trial = folder.read(written)
    assert set(trial.not_observable) == {"pressure", "arm", "observation"}
    assert trial.not_observable["arm"] == f"arm is not observable: there is no pressure.csv in {written}"
    with pytest.raises(TrialError, match=r"the pressure channel is missing: there is no pressure\.csv"):
        trial.channel("pressure")


def test_only_an_untracked_marker_may_be_blank(written):
    edit(written / "mocap.csv", 5, "link3_y", "")
    assert np.isnan(folder.read(written).channels["mocap"]["link3_y"][3])
    edit(written / "pressure.csv", 7, "pressure", "")
    with pytest.raises(TrialError, match="column pressure, row 7: '' is not a finite number; leave the row out"):
        folder.read(written)


@pytest.mark.parametrize(
    ("name", "row", "column", "cell", "says"),
    [
        ("rail.csv", 9, "velocity", "fast", r"rail\.csv: column velocity, row 9: 'fast' is not a finite number"),
        ("command.csv", 2, "pressure", "inf", r"command\.csv: column pressure, row 2: 'inf' is not a finite"),
        ("mocap.csv", 4, "t_capture", "", r"mocap\.csv: column t_capture, row 4: '' is not a finite number"),
        ("rail.csv", 1, "velocity", "speed", r"rail\.csv: no column velocity; it has t, position, speed"),
    ],
)
def test_a_bad_cell_is_named_by_file_column_and_row(written, name, row, column, cell, says):
    edit(written / name, row, column, cell)
    with pytest.raises(TrialError, match=says):
        folder.read(written)


def test_an_invalid_trial_yaml_is_rejected(written):
    (written / "trial.yaml").write_text("kind: chirp\nrail: clamped\n")
    with pytest.raises(TrialError, match=r"trial\.yaml:2: rail: is 'clamped'; allowed 'free' or 'held'; change it"):
        folder.read(written)


def test_the_order_of_inputs_does_not_matter(short, tmp_path):
    a, b = write(short, tmp_path / "a"), write(short, tmp_path / "b")
    assert [t.name for t in read_all([b, a])] == [t.name for t in read_all([a, b])] == ["a", "b"]
    assert sources(tmp_path) == (a, b)
    with pytest.raises(TrialError, match="the trial a is given twice"):
        read_all([a, a])
    with pytest.raises(TrialError, match="does not exist; name an MCAP log"):
        read_all([tmp_path / "c"])
    (tmp_path / "empty").mkdir()
    with pytest.raises(TrialError, match="contains no trial"):
        read_all([tmp_path / "empty"])


def edit(path, row, column, cell):
    """Write a cell; rows count from 1, the header is row 1."""
    rows = [line.split(",") for line in path.read_text().splitlines()]
    rows[row - 1][rows[0].index(column)] = cell
    path.write_text("\n".join(",".join(cells) for cells in rows) + "\n")


def test_column_names_may_contain_units_as_in_a_written_folder(short, tmp_path):
    (tmp_path / "one").mkdir()
    folder.write(short, tmp_path / "one", "csv")
    header = (tmp_path / "one" / "command.csv").read_text().partition("\n")[0]
    assert header == "t_s,cart_velocity_m_s,pressure_kpa"
    trial = folder.read(tmp_path / "one")
    assert (trial.kind, trial.rail) == (short.kind, short.rail)
    assert_same(trial, short)


def test_a_nan_reading_is_not_written(short, tmp_path):
    rail = short.channels["rail"]
    odd = Series(rail.t_s, {**rail.columns, "position": np.where(np.arange(len(rail)) == 3, np.nan, rail["position"])})
    folder.write(replace(short, channels={**short.channels, "rail": odd}), tmp_path, "csv")
    read = folder.read(tmp_path).channels["rail"]
    np.testing.assert_array_equal(read.t_s, np.delete(rail.t_s, 3))


def test_a_column_with_and_without_its_unit_is_rejected(written):
    file = written / "pressure.csv"
    for names in ("pressure", "pressure_kpa"), ("pressure_kpa", "pressure"):
        file.write_text("\n".join([f"t,{','.join(names)}", *("0.1,1,1", "0.2,1,1")]))
        with pytest.raises(TrialError, match=f"{names[0]} and {names[1]} are the same column; remove one"):
            folder.read(written)


@pytest.fixture
def in_parquet(short, tmp_path):
    place = write(short, tmp_path / "one")
    for file in place.glob("*.csv"):
        parquet.write_table(arrow_csv.read_csv(file), file.with_suffix(".parquet"))
        file.unlink()
    return place


def change(file, column, values):
    table = parquet.read_table(file)
    parquet.write_table(table.set_column(table.column_names.index(column), column, values), file)


def test_parquet_files_have_the_values_of_csv_files(short, in_parquet):
    trial = folder.read(in_parquet)
    assert (trial.kind, trial.warnings) == (short.kind, ())
    assert_same(trial, short)


def test_an_untracked_marker_is_a_null(short, in_parquet):
    seen = short.channels["mocap"]["link3_y"].tolist()
    change(in_parquet / "mocap.parquet", "link3_y", pa.array([None, *seen[1:]]))
    assert np.isnan(folder.read(in_parquet).channels["mocap"]["link3_y"]).tolist() == [True] + [False] * (len(seen) - 1)


def test_one_channel_in_two_files_is_rejected(short, in_parquet):
    write(short, in_parquet.parent / "other")
    (in_parquet.parent / "other" / "rail.csv").rename(in_parquet / "rail.csv")
    with pytest.raises(TrialError, match=r"contains rail\.csv and rail\.parquet; remove one of them"):
        folder.read(in_parquet)
