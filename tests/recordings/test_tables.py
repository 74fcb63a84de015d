"""Logs as tables and as the motion of the rail: what is read, and formats of other versions."""

import csv
import json
import math

import numpy as np
import pytest
from pyarrow import parquet

from softarm.daemon.logbook import logs
from softarm.recordings import flight, rail_motion, tables
from softarm.recordings.mcap_file import LogError
from softarm.schemas.config import Config
from tests.recordings.conftest import write


@pytest.fixture(scope="module")
def ticks(log):
    return tables.ticks(log)


def test_a_row_contains_the_inputs_and_outputs_of_a_tick(log, ticks):
    recorded = list(log)
    assert {len(column) for column in ticks.values()} == {len(recorded)}
    begin_ns = recorded[0][0].mocap[0].t_capture_ns
    for row, (inputs, outputs, timing) in enumerate(recorded):
        cell = {name: column[row] for name, column in ticks.items()}
        assert cell["t_s"] == (inputs.t_ns - begin_ns) * 1e-9
        assert (cell["tick"], cell["mode"], cell["policy"]) == (outputs.tick, outputs.mode, outputs.policy)
        assert (cell["sent_enable"], cell["sent_cart_velocity_m_s"], cell["sent_pressure_kpa"]) == outputs.sent
        assert (cell["measured_pressure_kpa"], cell["rail_position_m"]) == (
            inputs.pressure.pressure_kpa,
            inputs.rail.position_m,
        )
        assert (cell["observed_tip_y_m"], cell["observed_tip_vz_m_s"]) == (
            outputs.observed.values.tip_y_m,
            outputs.observed.values.tip_vz_m_s,
        )
        assert cell["clamps"].split() == list(outputs.clamps)
        assert cell["events"].split() == [event.name for event in outputs.events]
        assert cell["compute_ms"] == timing.compute_ns * 1e-6
        if outputs.action is None:
            assert math.isnan(cell["action_pressure_kpa"])
        else:
            assert cell["action_pressure_kpa"] == outputs.action[1]
    assert {"reach", "pid"} == set(ticks["policy"])
    assert {"armed", "disarmed", "stopped"} <= set(ticks["mode"])


def test_the_times_are_wall_clock_times(log, ticks):
    offset_ns = int(log.metadata["clock"]["wall_minus_monotonic_ns"])
    first = next(log.ticks())[0].t_ns + offset_ns
    assert ticks["time_utc"][0] == np.datetime64(first, "ns")
    assert str(ticks["time_utc"][0])[:10] == "2026-11-23"


def test_csv_and_parquet_give_every_digit_back(ticks, tmp_path):
    for form in ("csv", "parquet"):
        tables.write(tmp_path / f"ticks.{form}", ticks)
    with (tmp_path / "ticks.csv").open() as file:
        rows = list(csv.DictReader(file))
    table = parquet.read_table(tmp_path / "ticks.parquet")
    assert table.column_names == list(rows[0]) == list(ticks)
    for name, column in ticks.items():
        if name == "time_utc":
            assert [np.datetime64(row[name].removesuffix("Z")) for row in rows] == list(column)
            assert table[name].cast("int64").to_pylist() == column.astype(int).tolist()
        elif isinstance(column[0], float):
            np.testing.assert_array_equal([float(row[name] or "nan") for row in rows], column)
            np.testing.assert_array_equal(table[name].to_numpy().astype(float), column)
        else:
            assert [row[name] for row in rows] == [str(cell) for cell in column]
            assert table[name].to_pylist() == list(column)


def test_events_are_a_table_too(log):
    entries = tuple(log.entries())
    events = tables.events(log, entries)
    assert list(events["text"]) == [entry.text for entry in entries]
    assert list(events["kind"]).count("goal") >= 2
    assert set(events["t_s"]) <= set(tables.ticks(log)["t_s"])


def test_the_header_of_the_log_is_exported(log):
    about = json.loads(tables.about(log))
    assert about["configuration"]["control"]["rate_hz"] == 30
    assert [policy["name"] for policy in about["policies"]] == ["reach", "pid"]


def test_a_log_without_wall_clock_time_is_reported(killed):
    with pytest.raises(LogError, match="does not say what time it was"):
        tables.ticks(logs.read(killed))


def test_seconds_count_from_the_first_measurement_and_of_nothing_there_are_none(tmp_path, killed, readings):
    assert flight.first_stamp_ns(killed) == readings[0].t_receive_ns
    empty = write(tmp_path / "empty.mcap", ())
    with pytest.raises(LogError, match=r"empty\.mcap: holds nothing to show; was the daemon stopped before its first"):
        flight.first_stamp_ns(empty)


@pytest.mark.parametrize(
    ("data", "what"),
    [(b'{"position_m": 0}', "t_receive_ns: Field required"), (b"{", "Invalid JSON")],
    ids=["field", "json"],
)
def test_a_message_of_another_kind_is_reported_with_its_place(tmp_path, data, what):
    odd = write(tmp_path / "odd.mcap", [(1, data)])
    for read in (lambda path: list(flight.records(path)), rail_motion.read):
        with pytest.raises(
            LogError, match=rf"odd\.mcap: a message on /rail: {what}.*; was it edited, or recorded by another"
        ):
            read(odd)


def test_a_log_contains_commands_and_their_effects(flight_file):
    motion = rail_motion.read(flight_file)
    assert motion.config == Config.model_validate(motion.config.model_dump())
    assert len(motion.sent_s) == len(motion.set_point_m_s) == len(motion.obeyed) > 200
    assert len(motion.t_s) == len(motion.position_m) == len(motion.velocity_m_s) > 200
    assert np.diff(motion.t_s).min() > 0
    assert np.median(np.diff(motion.sent_s)) == pytest.approx(1 / 30, abs=1e-6)
    # The drive was off before it was armed, and after the stop; it stood still there.
    assert not motion.obeyed[:30].any()
    assert 0.5 < motion.obeyed.mean() < 0.95
    assert not motion.set_point_m_s[~motion.obeyed].any()
    assert np.abs(motion.velocity_m_s).max() > 0.5


def test_readings_that_are_no_numbers_are_left_out_and_a_log_without_ticks_is_empty(killed):
    motion = rail_motion.read(killed)
    assert (len(motion.t_s), len(motion.sent_s), motion.config) == (29, 0, None)
