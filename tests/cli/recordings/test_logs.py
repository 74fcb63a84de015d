"""`softarm logs`: recordings are played, exported, repaired and replayed."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softarm.daemon.logbook import logs
from softarm.daemon.logbook.ticks import TickFile
from softarm.diagnosis.data.read import read_all
from softarm.recordings import mcap_file
from softarm.recordings.live import RAIL
from softarm.schemas.messages import RailReading
from tests.cli.invoke import invoke, refuse, succeed
from tests.recordings.conftest import write

FLIGHT = Path(__file__).parents[2] / "data" / "flight.mcap"


@pytest.fixture
def browser(monkeypatch):
    """Return the list of addresses that a browser has to open."""
    asked = []
    monkeypatch.setattr("webbrowser.open", lambda url: asked.append(url) or True)
    return asked


def view(*arguments):
    return succeed("logs", "view", *arguments)


def test_a_page_is_written_and_opened(browser, tmp_path):
    assert view("--out", tmp_path / "swing.html", FLIGHT).stdout == f"wrote {tmp_path}/swing.html\n"
    assert browser == [(tmp_path / "swing.html").as_uri()]
    assert (tmp_path / "swing.html").read_text().startswith("<!doctype html>")


def test_without_opening_the_page_is_written_to_this_folder(browser, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert view("--no-open", FLIGHT).stdout == "wrote flight.html\n"
    assert (tmp_path / "flight.html").stat().st_size < 200_000  # chart library included
    assert browser == []


def test_view_writes_the_layout(tmp_path):
    assert view("--layout", tmp_path / "layout.json").stdout == f"wrote {tmp_path}/layout.json\n"
    assert "3D!softarm" in json.loads((tmp_path / "layout.json").read_text())["configById"]


def export(*arguments):
    return succeed("logs", "export", *arguments)


def test_a_log_is_exported_as_a_trial_folder_that_replaces_an_earlier_one(tmp_path):
    export("--to", "csv", "--out", tmp_path / "out", FLIGHT)
    result = export("--to", "parquet", "--out", tmp_path / "out", FLIGHT)
    assert result.stdout == f"wrote {tmp_path}/out/flight: 313 ticks over 10.4 s\n"
    names = ("command", "events", "mocap", "observation", "pressure", "rail", "ticks")
    assert {file.name for file in (tmp_path / "out" / "flight").iterdir()} == {
        *(f"{name}.parquet" for name in names),
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


def test_the_ticks_of_a_log_without_devices_are_exported_as_well(tmp_path):
    whole, path = logs.read(FLIGHT), tmp_path / "alone.mcap"
    inputs, outputs, timing = next(iter(whole))
    with path.open("wb") as file:
        live = TickFile(file)
        live.head(whole.config, None, 0, 0)
        live.write((replace(inputs, mocap=(), pressure=None, rail=None), outputs, timing))
        live.flush()
    result = export("--to", "csv", "--out", tmp_path / "out", path, FLIGHT)
    assert result.stderr.startswith(f"{path}: contains no readings")
    assert result.stdout.count("wrote ") == 2
    assert {file.name for file in (tmp_path / "out" / "alone").iterdir()} == {"about.json", "events.csv", "ticks.csv"}


def test_logs_become_one_dataset_for_lerobot(tmp_path):
    result = export("--to", "lerobot", "--out", tmp_path / "out", FLIGHT, FLIGHT)
    assert result.stdout == f"wrote {tmp_path}/out: 12 episodes (4 reached), 324 frames\n"
    assert {file.name for file in (tmp_path / "out").iterdir()} == {"data", "meta"}


def test_an_export_for_foxglove_includes_its_layout(tmp_path):
    result = export("--to", "foxglove", "--out", tmp_path / "out", FLIGHT)
    assert result.stdout.startswith(f"wrote {tmp_path}/out/flight-foxglove.mcap (0.4 MB, the log has 0.2) and ")
    assert {file.name for file in (tmp_path / "out").iterdir()} == {"flight-foxglove.mcap", "softarm-layout.json"}


def test_an_unusable_place_is_refused(tmp_path):
    (tmp_path / "file").touch()
    message = "cannot be read or written (Not a directory); choose another place"
    refuse(message, "logs", "export", "--to", "csv", "--out", tmp_path / "file" / "below", FLIGHT)


@pytest.fixture
def cut_off(tmp_path):
    """Return a log as a killed daemon leaves it: no index, the last record incomplete."""
    path = tmp_path / "logs" / "softarm-20260101T000000Z.mcap"
    path.parent.mkdir()
    write(path, ((n, RAIL.encode(RailReading(n, n / 7, 0.0, True))) for n in range(100)))
    path.write_bytes(path.read_bytes()[:-5])
    return path


def test_a_truncated_log_is_repaired_once(cut_off):
    repaired = f"{cut_off}: repaired; 99 complete records over 0.00 s (0.0 MB, now "
    assert succeed("logs", "recover", cut_off).stdout.startswith(repaired)
    assert mcap_file.is_finished(cut_off)
    assert len(list(mcap_file.messages(cut_off))) == 99
    assert succeed("logs", "recover", cut_off).stdout == f"{cut_off}: is finished, nothing to repair\n"


def test_every_log_of_a_folder_is_repaired_and_a_failure_exits_with_1(cut_off):
    rubbish, empty = cut_off.with_name("a.mcap"), cut_off.with_name("b.mcap")
    rubbish.write_bytes(b"no log at all, but long enough")
    empty.touch()
    result = invoke("logs", "recover", cut_off.parent)
    assert result.exit_code == 1
    assert f"{cut_off}: repaired" in result.stdout
    assert result.stderr.splitlines() == [
        f"{rubbish}: not a log; a log is an MCAP file, as the recorder writes it",
        f"{empty}: has no complete record and was not changed; delete it",
    ]
    assert rubbish.read_bytes().startswith(b"no log")


@pytest.mark.parametrize(
    ("lost", "sentence"),
    [
        (range(4, 28), "not in this log: 24 ticks (1 s) of a still, disarmed arm"),
        (range(1, 61), "the log begins at tick 61 of its run: an earlier file holds the ticks before"),
        (range(70, 71), "tick 71: 1 ticks before it are missing, and the drive was on: later ticks may differ "),
    ],
)
def test_ticks_that_a_log_lacks_are_counted_and_the_others_compared(lost, sentence, tmp_path):
    whole = logs.read(FLIGHT)
    with (tmp_path / "gap.mcap").open("wb") as file:
        live = TickFile(file)
        live.head(whole.config, None, 0, 0)
        for tick in whole:
            if tick[1].tick not in lost:
                live.write(tick)
        live.flush()
    _, gap, unsure, verdict = succeed("logs", "replay", tmp_path / "gap.mcap").stdout.splitlines()
    assert gap.startswith(sentence)
    assert unsure.startswith("replayed but not compared: ")
    compared = int(verdict.removesuffix(" ticks, every command the same"))
    assert compared + int(unsure.split()[4]) + len(lost) == len(list(whole.ticks()))
