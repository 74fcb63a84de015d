"""Stamps as dates, in all common forms; stamps that cannot belong to one clock are rejected."""

from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from softarm.diagnosis.data import tables
from softarm.diagnosis.data.trials import TrialError
from tests.diagnosis.data import servo
from tests.diagnosis.data.servo import COMMAND, MEASURED, T, changed

NOON = datetime(2026, 11, 22, 12, 0, 0, tzinfo=UTC)
STAGE = changed(servo.STAGE, ("files: data.csv", "files: {command: sent.csv, measured: seen.csv}"))


def stamps(form, zone=UTC):
    """Return the stamps of every row in a form."""
    return [form((NOON + timedelta(seconds=float(t))).astimezone(zone)) for t in T]


def plain(moment):
    return moment.replace(tzinfo=None).isoformat()


def zulu(moment):
    return moment.strftime("%Y-%m-%dT%H:%M:%S.%fZ")


def read(folder, sent, seen, stage=STAGE, delimiter=",", head=True):
    """Read a trial with these stamps."""
    for name, times, column, values in (("sent", sent, "u", COMMAND), ("seen", seen, "y", MEASURED)):
        rows = [f"{t}{delimiter}{x:.9f}" for t, x in zip(times, values, strict=True)]
        (folder / f"{name}.csv").write_text("\n".join([f"t{delimiter}{column}"] * head + rows) + "\n")
    (folder / "stage.yaml").write_text(stage)
    (trial,) = tables.read(folder / "stage.yaml")
    return trial


@pytest.mark.parametrize(
    ("form", "zone"),
    [
        (zulu, UTC),
        (datetime.isoformat, timezone(timedelta(hours=5, minutes=30))),
        (lambda moment: moment.isoformat(" "), UTC),
        (plain, UTC),
        (lambda moment: plain(moment).replace("T", " "), UTC),
    ],
    ids=["Z", "+05:30", "a blank", "no zone", "no zone, a blank"],
)
def test_dates_are_seconds_of_one_clock(tmp_path, form, zone):
    trial = read(tmp_path, stamps(form, zone), stamps(form, zone))
    for name in ("command", "measured"):
        np.testing.assert_allclose(trial.channels[name].t_s - NOON.timestamp(), T, atol=2e-6)
    assert trial.warnings == ()


def test_dates_may_have_decimal_commas_and_no_header(tmp_path):
    stage = changed(STAGE, ("source: t,", "source: 1,"), ("source: u,", "source: 2,"), ("source: y", "source: 2"))
    trial = read(tmp_path, *[[t.replace(".", ",") for t in stamps(plain)]] * 2, stage=stage, delimiter=";", head=False)
    np.testing.assert_allclose(trial.channels["measured"].t_s - NOON.timestamp(), T, atol=2e-6)


def test_a_parquet_tables_dates_are_seconds(tmp_path):
    moments = pa.array([NOON + timedelta(seconds=float(t)) for t in T], pa.timestamp("us", tz="Europe/Berlin"))
    table = pa.table({"t": moments, "u": COMMAND, "y": MEASURED})
    parquet.write_table(table, tmp_path / "data.parquet")
    (tmp_path / "stage.yaml").write_text(STAGE.replace("{command: sent.csv, measured: seen.csv}", "data.parquet"))
    (trial,) = tables.read(tmp_path / "stage.yaml")
    np.testing.assert_allclose(trial.channels["measured"].t_s - NOON.timestamp(), T, atol=2e-6)


def mixed():
    return [*stamps(zulu)[:100], *stamps(plain)[100:]]


@pytest.mark.parametrize(
    ("sent", "seen", "says"),
    [
        (stamps(zulu), mixed(), r"seen\.csv: column t: row 2 has a time zone \(2026.*Z\), row 102 has none \("),
        (stamps(zulu), stamps(plain), r"sent\.csv: column t has time zones, .*seen\.csv: column t has none; write"),
        ([*stamps(zulu)[:9], "later", *stamps(zulu)[10:]], stamps(zulu), r"column t, row 11: 'later' is not"),
        (stamps(zulu), [f"{t:.3f}" for t in T], r"they do not overlap"),
    ],
    ids=["in a file", "between files", "no date", "dates and seconds"],
)
def test_stamps_of_different_clocks_are_rejected(tmp_path, sent, seen, says):
    with pytest.raises(TrialError, match=says):
        read(tmp_path, sent, seen)


def test_dates_with_another_unit_than_seconds_are_rejected(tmp_path):
    with pytest.raises(TrialError, match=r"column t: contains dates with a time of day; write only `unit: s`"):
        read(tmp_path, stamps(zulu), stamps(zulu), STAGE.replace("unit: s}", "unit: ms}"))
