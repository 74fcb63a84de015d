"""`softarm logs export`: what is written where, and what is said when it cannot be."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from softarm.cli.main import main
from softarm.diagnosis.data.read import read_all

FLIGHT = Path(__file__).parents[1] / "data" / "flight.mcap"


def export(*arguments):
    return CliRunner().invoke(main, ["logs", "export", *map(str, arguments)])


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_a_log_becomes_a_folder_of_tables_which_is_a_trial(form, tmp_path):
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
    assert {name: len(series) for name, series in trial.channels.items()} == {
        name: len(series) for name, series in log.channels.items()
    }


def test_a_log_for_foxglove_has_its_layout_beside_it(tmp_path):
    result = export("--to", "foxglove", "--out", tmp_path / "out", FLIGHT)
    assert result.exit_code == 0
    assert result.stdout.startswith(f"wrote {tmp_path}/out/flight-foxglove.mcap (0.4 MB, the log has 0.2) and ")
    assert {file.name for file in (tmp_path / "out").iterdir()} == {"flight-foxglove.mcap", "softarm-layout.json"}


def test_what_is_no_log_and_a_place_that_is_none_are_told(tmp_path):
    rubbish = tmp_path / "a.mcap"
    rubbish.write_text("nothing")
    result = export("--to", "csv", "--out", tmp_path, rubbish)
    assert (result.exit_code, result.stderr) == (
        1,
        f"{rubbish}: not a log; a log is an MCAP file, as the recorder writes it\n",
    )
    result = export("--to", "csv", "--out", rubbish / "under", FLIGHT)
    assert result.exit_code == 1
    assert "cannot be written (Not a directory); name another --out" in result.stderr
    assert export("--to", "xls", FLIGHT).exit_code == 2
