"""Incident file of every emergency stop: it replays, has no secret and outlives the logs."""

import json
import os
import zipfile
from pathlib import Path

import pytest

from softarm.daemon.access.auth import TOKEN_FILES
from softarm.daemon.control.records import EStop, Inputs, Mode, Outputs, TickTiming
from softarm.daemon.logbook import folder, incidents, logs
from softarm.daemon.logbook.recorder import Recorder
from softarm.daemon.runtime.offline import Lockstep
from softarm.daemon.runtime.replay import replay
from softarm.policies.hold import Hold
from softarm.schemas.config import Config
from softarm.schemas.messages import PressureReading

WALL_NS = 1_800_000_000_000_000_000


class Flight:
    """Recorded real ticks on a simulated robot."""

    def __init__(self, config: Config) -> None:
        self.recorder = Recorder(config, Hold().spec, monotonic_ns=lambda: 0, wall_ns=lambda: WALL_NS)
        self.recorder.start()
        self.daemon = Lockstep(config, Hold(), record=self.recorder.tick)

    def ticks(self, seconds: float, *kinds) -> None:
        """Run for a time, with the requests in the first tick."""
        for number in range(round(seconds * 30)):
            self.daemon.tick(*(self.daemon.request(kind) for kind in kinds if number == 0))


def config_of(directory: Path, **recorder) -> Config:
    return Config(recorder={"directory": directory, **recorder})


def files(directory: Path) -> list[Path]:
    return sorted((directory / incidents.FOLDER).iterdir()) if (directory / incidents.FOLDER).exists() else []


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):
    """Return the directory of a daemon with token files that was stopped at 23 s and flew again."""
    directory = tmp_path_factory.mktemp("logs")
    config = config_of(directory).model_copy(update={"api": Config().api.model_copy(update=SECRETS)})
    flight = Flight(config)
    flight.ticks(1)
    flight.daemon.arm()
    flight.ticks(20.5)
    flight.ticks(0.5, "stop")
    flight.ticks(4.7, "acknowledge")
    flight.recorder.stop()
    return directory


SECRETS = {key: Path(f"/etc/secret/{key}") for key in TOKEN_FILES.values()}


@pytest.fixture(scope="module")
def parts(stopped, tmp_path_factory):
    """Return the unpacked content of its only incident file."""
    (path,) = files(stopped)
    unpacked = tmp_path_factory.mktemp("sent")
    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None
        archive.extractall(unpacked)
    return unpacked


@pytest.mark.slow
def test_an_incident_has_the_log_around_the_stop_which_replays(parts, stopped):
    log = logs.read(parts / "log.mcap")
    assert log.finished
    outputs = [made for _, made in log.ticks()]
    stop = next(o.t_ns for o in outputs if o.mode is Mode.STOPPED)
    before_s, after_s = (stop - outputs[0].t_ns) * 1e-9, (outputs[-1].t_ns - stop) * 1e-9
    assert (before_s, after_s) == (pytest.approx(20, abs=0.05), pytest.approx(5, abs=0.05))
    whole = [o.tick for _, o in logs.read(next(stopped.glob("*.mcap"))).ticks()]
    assert [o.tick for o in outputs] == [n for n in whole if outputs[0].tick <= n <= outputs[-1].tick]
    assert log.metadata["policy"]["name"] == "hold"
    replayed = replay(log.ticks(), log.config, lambda name: Hold())
    assert replayed.differences == []
    assert replayed.compared > 600


@pytest.mark.slow
def test_an_incident_names_events_and_software(parts):
    kinds = [entry.kind for entry in logs.read(parts / "log.mcap").entries()]
    assert kinds.count("stop") == 1
    text = (parts / "events.txt").read_text()
    assert "emergency stop: an emergency stop was requested" in text
    assert text.startswith("08:00:")
    assert "emergency stop: an emergency stop was requested" in (parts / "README.txt").read_text()
    versions = json.loads((parts / "versions.json").read_text())
    assert {"softarm", "git_revision", "python", "numpy", "name"} <= set(versions)
    assert sorted(path.name for path in parts.iterdir()) == [
        "README.txt",
        "configuration.json",
        "events.txt",
        "log.mcap",
        "versions.json",
    ]


@pytest.mark.slow
def test_an_incident_has_the_configuration_without_secrets(parts):
    stored = Config.model_validate_json((parts / "configuration.json").read_text())
    assert stored == logs.read(parts / "log.mcap").config
    assert stored.limits == Config().limits
    assert all(b"/etc/secret" not in path.read_bytes() for path in parts.iterdir())
    assert [getattr(stored.api, key) for key in TOKEN_FILES.values()] == [None] * 3


@pytest.mark.slow
def test_an_incident_is_listed_with_time_and_reason_and_outlives_the_logs(stopped):
    (entry,) = incidents.listing(stopped)
    assert incidents.NAME.fullmatch(entry.name)
    assert entry.text.startswith("emergency stop: an emergency stop was requested")
    assert entry.time.isoformat().startswith("2027-01-15T08:00:2")
    (path,) = files(stopped)
    assert entry.bytes == path.stat().st_size < 3_000_000
    folder.delete_oldest(stopped, stopped / "own.mcap", config_of(stopped, keep_days=1e-9, keep_mb=2_000).recorder)
    assert list(stopped.glob("*.mcap")) == []
    assert files(stopped) == [path]


def test_an_incident_has_earlier_readings_that_its_ticks_used(tmp_path):
    recorder = Recorder(config_of(tmp_path), Hold().spec)
    recorder.start()
    pressure = PressureReading(1, 2.5, True)  # the device says nothing new for 40 s
    for number in range(1, 1201):
        mode = Mode.STOPPED if number == 1200 else Mode.ARMED
        outputs = Outputs(number * 33_333_333, number, 0, 0, 0, mode, EStop.CLEAR, last_stop="a hand", last_stop_ns=1)
        recorder.tick(Inputs(outputs.t_ns, pressure=pressure), outputs, TickTiming(0, 0, 0, None))
    recorder.stop()
    (path,) = files(tmp_path)
    with zipfile.ZipFile(path) as archive:
        archive.extract("log.mcap", tmp_path)
    ticks = [inputs for inputs, _ in logs.read(tmp_path / "log.mcap").ticks()]
    assert len(ticks) == pytest.approx(600, abs=2)
    assert {inputs.pressure.pressure_kpa for inputs in ticks} == {2.5}


def test_later_logs_and_incidents_name_the_revision_of_the_first_log(tmp_path, monkeypatch):
    for part in ("first", "later"):
        recorder = Recorder(config_of(tmp_path / part), Hold().spec)
        recorder.start()
        stop = Outputs(1, 1, 0, 0, 0, Mode.STOPPED, EStop.CLEAR, last_stop="a hand", last_stop_ns=1)
        recorder.tick(Inputs(1), stop, TickTiming(0, 0, 0, None))
        recorder.stop()
        monkeypatch.setattr("softarm.common.revision.revision", lambda: "a later commit")
    revisions = {logs.read(path).metadata["software"]["git_revision"] for path in tmp_path.rglob("*.mcap")}
    for path in tmp_path.rglob("*.zip"):
        with zipfile.ZipFile(path) as archive:
            revisions.add(json.loads(archive.read("versions.json"))["git_revision"])
    assert len(revisions) == 1


@pytest.mark.slow
def test_stops_within_seconds_share_one_incident_and_the_last_is_written_at_the_end(tmp_path):
    flight = Flight(config_of(tmp_path))
    flight.daemon.arm()
    for wait_s in (0.5, 5.2, 0.1):
        flight.ticks(0.2, "stop")
        flight.ticks(wait_s, "acknowledge")
    assert len(files(tmp_path)) < 2
    flight.recorder.stop()
    assert len(incidents.listing(tmp_path)) == 2


def test_without_a_stop_or_a_recorder_there_is_no_incident(tmp_path):
    flight = Flight(config_of(tmp_path / "flown"))
    flight.daemon.arm()
    flight.ticks(1, "disarm")
    flight.recorder.stop()
    off = Flight(config_of(tmp_path / "off", enabled=False))
    off.ticks(0.2, "stop")
    off.recorder.stop()
    assert files(tmp_path / "flown") == []
    assert list(tmp_path.iterdir()) == [tmp_path / "flown"]


def test_a_full_disk_prevents_the_incident_and_is_reported(tmp_path, monkeypatch, caplog):
    flight = Flight(config_of(tmp_path))
    flight.ticks(0.2, "stop")
    monkeypatch.setattr(folder, "FREE_MIN_BYTES", 1 << 62)
    flight.recorder.stop()
    assert "the incident file of the stop could not be written" in caplog.text
    assert "the disk is full" in caplog.text
    assert files(tmp_path) == []


@pytest.mark.parametrize(
    ("number_max", "mb_max", "left"),
    [(50, 200, [1, 2, 3, 4, 5]), (5, 5, [1, 2, 3, 4, 5]), (3, 200, [3, 4, 5]), (50, 2, [4, 5]), (1, 0, [5])],
)
def test_the_oldest_incidents_are_deleted_and_the_newest_never(tmp_path, number_max, mb_max, left):
    for number in range(1, 6):
        path = tmp_path / f"incident-2026010{number}T000000Z.zip"
        path.write_bytes(b"0" * 1_000_000)
        os.utime(path, (number, number))
    (tmp_path / "mine.zip").write_bytes(b"0" * 9_000_000)
    incidents.delete_oldest(tmp_path, number_max, mb_max)
    assert (tmp_path / "mine.zip").exists()
    assert [int(path.name[16]) for path in sorted(tmp_path.glob("incident*"))] == left
