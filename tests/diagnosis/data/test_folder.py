"""A trial folder gives back what was recorded; what is wrong with it is said by file, column and row."""

from dataclasses import replace

import numpy as np
import pytest

from softarm.diagnosis.data import folder
from softarm.diagnosis.data.read import read_all, sources
from softarm.diagnosis.data.trials import Series, TrialError


@pytest.fixture(scope="module")
def short(record):
    return record("pressure-multisine")


@pytest.fixture
def written(short, write, tmp_path):
    return write(short, tmp_path / "campaign" / "one")


def test_numbers_and_stamps_come_back_exactly(short, written):
    trial = folder.read(written)
    assert (trial.kind, trial.rail, trial.name) == ("pressure-multisine", "free", "one")
    for name, series in short.channels.items():
        np.testing.assert_array_equal(trial.channels[name].t_s, series.t_s)
        for column, values in series.columns.items():
            np.testing.assert_array_equal(trial.channels[name][column], values, err_msg=f"{name}.{column}")
    assert trial.warnings == ()
    assert set(trial.not_observable) == {"observation"}


def test_a_missing_file_makes_its_stages_unobservable_in_words(written):
    (written / "pressure.csv").unlink()
    trial = folder.read(written)
    assert set(trial.not_observable) == {"pressure", "arm", "observation"}
    assert trial.not_observable["arm"] == f"arm is not observable: there is no pressure.csv in {written}"
    with pytest.raises(TrialError, match=r"the pressure channel is needed: there is no pressure\.csv"):
        trial.channel("pressure")


def test_an_unseen_marker_is_nan_and_nothing_else_may_be(written):
    edit(written / "mocap.csv", 5, "link3_y", "")
    assert np.isnan(folder.read(written).channels["mocap"]["link3_y"][3])
    edit(written / "pressure.csv", 7, "pressure", "")
    with pytest.raises(TrialError, match=r"pressure\.csv: column pressure, row 7: '' is not a finite number"):
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


def test_trial_yaml_is_checked(written):
    (written / "trial.yaml").write_text("kind: chirp\nrail: clamped\n")
    with pytest.raises(
        TrialError,
        match=r"trial\.yaml:2: rail: is 'clamped'; allowed 'free' or 'held'; change it",
    ):
        folder.read(written)


def test_a_row_of_another_length_is_named(written):
    path = written / "rail.csv"
    path.write_text(path.read_text() + "1.0,2.0\n")
    with pytest.raises(TrialError, match=r"rail\.csv: row \d+ has 2 cells, the header 3"):
        folder.read(written)


def test_inputs_in_any_order_are_the_same_trials(short, write, tmp_path):
    a, b = write(short, tmp_path / "a"), write(short, tmp_path / "b")
    assert [t.name for t in read_all([b, a])] == [t.name for t in read_all([a, b])] == ["a", "b"]
    assert sources(tmp_path) == (a, b)
    with pytest.raises(TrialError, match="the trial a is given twice"):
        read_all([a, a])
    with pytest.raises(TrialError, match="is not there; name an MCAP log"):
        read_all([tmp_path / "c"])
    (tmp_path / "empty").mkdir()
    with pytest.raises(TrialError, match="holds no trial"):
        read_all([tmp_path / "empty"])


def edit(path, row, column, cell):
    """Write a cell; rows count from 1, the header is row 1."""
    rows = [line.split(",") for line in path.read_text().splitlines()]
    rows[row - 1][rows[0].index(column)] = cell
    path.write_text("\n".join(",".join(cells) for cells in rows) + "\n")


def test_columns_may_carry_their_units_and_a_written_folder_has_them(short, tmp_path):
    (tmp_path / "one").mkdir()
    folder.write(short, tmp_path / "one", "csv")
    header = (tmp_path / "one" / "command.csv").read_text().partition("\n")[0]
    assert header == "t_s,cart_velocity_m_s,pressure_kpa"
    trial = folder.read(tmp_path / "one")
    assert (trial.kind, trial.rail) == (short.kind, short.rail)
    for name, series in short.channels.items():
        np.testing.assert_array_equal(trial.channels[name].t_s, series.t_s)
        for column, values in series.columns.items():
            np.testing.assert_array_equal(trial.channels[name][column], values, err_msg=f"{name}.{column}")


def test_a_reading_that_is_no_number_has_no_row_in_what_is_written(short, tmp_path):
    rail = short.channels["rail"]
    odd = Series(rail.t_s, {**rail.columns, "position": np.where(np.arange(len(rail)) == 3, np.nan, rail["position"])})
    folder.write(replace(short, channels={**short.channels, "rail": odd}), tmp_path, "csv")
    read = folder.read(tmp_path).channels["rail"]
    np.testing.assert_array_equal(read.t_s, np.delete(rail.t_s, 3))


def test_a_column_with_and_without_its_unit_is_one_too_many(written):
    file = written / "pressure.csv"
    file.write_text(
        "\n".join(f"{line},{'pressure_kpa' if i == 0 else 1}" for i, line in enumerate(file.read_text().splitlines()))
    )
    with pytest.raises(TrialError, match=r"pressure\.csv: pressure and pressure_kpa are one column; take one away"):
        folder.read(written)
