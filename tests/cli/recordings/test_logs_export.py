"""Tests of `softarm logs export`."""

from pathlib import Path

import numpy as np
import pytest

from softarm.diagnosis.data.read import read_all
from tests.cli.invoke import invoke

FLIGHT = Path(__file__).parents[2] / "data" / "flight.mcap"


def export(*arguments):
    return invoke("logs", "export", *arguments)


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_a_log_is_exported_as_a_trial_folder(form, tmp_path):
    result = export("--to", form, "--out", tmp_path / "out", FLIGHT)
    assert (result.exit_code, result.stdout) == (0, f"wrote {tmp_path}/out/flight: 313 ticks over 10.4 s\n")
    names = ("command", "events", "mocap", "observation", "pressure", "rail", "ticks")
    assert {file.name for file in (tmp_path / "out" / "flight").iterdir()} == {
        *(f"{name}.{form}" for name in names),
        "about.json",
        "trial.yaml",
    }
    (trial,) = read_all([tmp_path / "out"])
    (log,) = read_all([FLIGHT])
    assert (trial.name, trial.kind, trial.rail) == (log.name, log.kind, log.rail)
    assert trial.channels.keys() == log.channels.keys()
    for name, series in trial.channels.items():
        np.testing.assert_array_equal(series.t_s, log.channels[name].t_s)
        np.testing.assert_equal(dict(series.columns), dict(log.channels[name].columns))


def test_logs_become_one_dataset_for_lerobot(tmp_path):
    result = export("--to", "lerobot", "--out", tmp_path / "out", FLIGHT, FLIGHT)
    assert result.stdout == f"wrote {tmp_path}/out: 12 episodes (4 reached), 324 frames\n"
    assert {file.name for file in (tmp_path / "out").iterdir()} == {"data", "meta"}


def test_an_export_for_foxglove_includes_its_layout(tmp_path):
    result = export("--to", "foxglove", "--out", tmp_path / "out", FLIGHT)
    assert result.exit_code == 0
    assert result.stdout.startswith(f"wrote {tmp_path}/out/flight-foxglove.mcap (0.4 MB, the log has 0.2) and ")
    assert {file.name for file in (tmp_path / "out").iterdir()} == {"flight-foxglove.mcap", "softarm-layout.json"}


def test_an_unusable_place_is_refused(tmp_path):
    (tmp_path / "file").touch()
    result = export("--to", "csv", "--out", tmp_path / "file" / "below", FLIGHT)
    assert result.exit_code == 1
    assert "cannot be written (Not a directory); choose another --out" in result.stderr
