"""A trial folder whose channels are Parquet files: what its CSV files hold, and what is wrong with one in words."""

import math

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import csv, parquet

from softarm.diagnosis.data import folder
from softarm.diagnosis.data.trials import TrialError


@pytest.fixture(scope="module")
def short(record):
    return record("pressure-multisine")


@pytest.fixture
def written(short, write, tmp_path):
    """The trial, its channels in Parquet."""
    place = write(short, tmp_path / "one")
    for file in place.glob("*.csv"):
        parquet.write_table(csv.read_csv(file), file.with_suffix(".parquet"))
        file.unlink()
    return place


def change(file, column, values):
    table = parquet.read_table(file)
    parquet.write_table(table.set_column(table.column_names.index(column), column, values), file)


def test_it_holds_what_the_csv_files_held(short, written):
    trial = folder.read(written)
    assert (trial.kind, trial.warnings) == (short.kind, ())
    assert trial.channels.keys() == short.channels.keys()
    for name, series in short.channels.items():
        np.testing.assert_array_equal(trial.channels[name].t_s, series.t_s)
        for column, values in series.columns.items():
            np.testing.assert_array_equal(trial.channels[name][column], values, err_msg=f"{name}.{column}")


def test_a_marker_out_of_sight_is_a_null(short, written):
    seen = short.channels["mocap"]["link3_y"].tolist()
    change(written / "mocap.parquet", "link3_y", pa.array([None, *seen[1:]]))
    assert np.isnan(folder.read(written).channels["mocap"]["link3_y"]).tolist() == [True] + [False] * (len(seen) - 1)


def test_one_channel_in_two_files_is_refused(short, written, write):
    write(short, written.parent / "other")
    (written.parent / "other" / "rail.csv").rename(written / "rail.csv")
    with pytest.raises(TrialError, match=r"holds rail\.csv and rail\.parquet; take the one away that is not meant"):
        folder.read(written)


@pytest.mark.parametrize(
    ("value", "says"),
    [
        (None, r"column velocity, row 1: nan is not a finite number; leave the row out if nothing was measured"),
        (math.inf, r"column velocity, row 1: inf is not a finite number"),
        ("fast", r"column velocity holds string; write it as numbers"),
        (np.datetime64("2026-11-22T12:00:00"), r"column velocity holds timestamp\[ms\]; write it as numbers"),
    ],
)
def test_a_column_of_no_numbers_is_told(short, written, value, says):
    count = len(short.channels["rail"])
    one = type(value) in (str, np.datetime64)
    change(written / "rail.parquet", "velocity", pa.array([value] * count if one else [value] + [0.1] * (count - 1)))
    with pytest.raises(TrialError, match=r"rail\.parquet: " + says):
        folder.read(written)


def test_what_is_no_parquet_file_lacks_a_column_or_rows_is_told(written):
    table = parquet.read_table(written / "rail.parquet")
    parquet.write_table(table.drop_columns(["velocity"]), written / "rail.parquet")
    with pytest.raises(TrialError, match=r"rail\.parquet: no column velocity; it has t, position"):
        folder.read(written)
    parquet.write_table(table.slice(0, 0), written / "rail.parquet")
    with pytest.raises(TrialError, match=r"rail\.parquet: has no rows"):
        folder.read(written)
    (written / "rail.parquet").write_bytes(b"t,position,velocity\n")
    with pytest.raises(
        TrialError, match=r"rail\.parquet: cannot be read as Parquet \(.*\); export it again, or as CSV"
    ):
        folder.read(written)
