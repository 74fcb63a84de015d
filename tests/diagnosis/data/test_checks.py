"""Checks before a fit: gaps, repeated stamps, jumps of the clock and wrong units."""

import numpy as np
import pytest

from softarm.diagnosis.data import checks
from softarm.diagnosis.data.trials import Series

T = np.arange(100) / 100


def series(t):
    return Series(np.asarray(t, dtype=float), {"value": np.arange(len(t), dtype=float)})


def test_valid_stamps_are_unchanged():
    good = series(T)
    assert checks.tidy_stamps(good, "x") == (good, ())


def test_repeated_stamps_are_left_out_and_counted():
    tidy, warnings = checks.tidy_stamps(series(np.concatenate((T[:50], T[49:]))), "x.csv")
    np.testing.assert_array_equal(tidy.t_s, T)
    assert tidy["value"][49] == 49  # the first of the two
    assert warnings[0].startswith("x.csv: 1 rows repeat a stamp and were left out")


def test_time_that_runs_backwards_is_sorted_with_a_warning():
    tidy, warnings = checks.tidy_stamps(series(np.concatenate((T[50:], T[:50]))), "x.csv")
    np.testing.assert_array_equal(tidy.t_s, T)
    assert "time runs backwards at 1 rows, first at row 51" in warnings[0]
    assert "split the recording in two" in warnings[0]


def test_a_gap_is_reported_with_its_length():
    _, warnings = checks.tidy_stamps(series(np.concatenate((T[:30], T[50:]))), "x.csv")
    assert warnings == (
        "x.csv: 1 gaps, 0.21 s in all, the longest 0.210 s at 0.290 s (usual step 10.0 ms); data in gaps are "
        "not compared: record again if they are long",
    )


def test_a_clock_jump_and_milliseconds_are_reported():
    _, warnings = checks.tidy_stamps(series(np.concatenate((T, T + 3600))), "x.csv")
    assert "the clock jumps by 3599 s" in warnings[0]
    _, warnings = checks.tidy_stamps(series(T * 1e6), "x.csv")
    assert "stamps are seconds: divide ms by 1e3" in warnings[0]


@pytest.fixture(scope="module")
def channels(record):
    return record("both").channels


@pytest.mark.parametrize("kind", ["both", "rail-multisine"], ids=["in motion", "with a muscle at rest"])
def test_correct_units_give_no_warning(record, kind):
    assert checks.unit_warnings(record(kind).channels, "trial") == ()


@pytest.mark.parametrize(
    ("channel", "columns", "factor", "says"),
    [
        ("pressure", ["pressure"], 0.01, "is it in bar?"),
        ("pressure", ["pressure"], 1 / 6.894757, "is it in psi?"),
        ("command", ["pressure"], 10.0, "is it in mbar or hPa?"),
        ("mocap", None, 1000.0, "positions look like millimetres"),
        ("mocap", ["link3_angle"], 57.29578, "link3_angle does not agree with the positions; it looks like degrees"),
        ("mocap", ["link2_angle"], -1.0, "radians of the opposite sign"),
        ("rail", ["position"], 1000.0, "is it in millimetres?"),
        ("rail", ["velocity"], 1000.0, "velocity is 1e+03 times the slope of position"),
    ],
)
def test_a_wrong_unit_is_named(channels, channel, columns, factor, says):
    old = channels[channel]
    columns = columns or [c for c in old.columns if c.endswith(("_y", "_z"))]
    changed = Series(old.t_s, {c: v * factor if c in columns else v for c, v in old.columns.items()})
    warnings = checks.unit_warnings({**channels, channel: changed}, "trial")
    assert any(says in warning for warning in warnings), warnings
