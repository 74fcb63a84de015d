"""A log of rail readings, complete and as a kill leaves it."""

from pathlib import Path

import pytest

from softarm.daemon.logbook import logs
from softarm.recordings.channels import RAIL
from softarm.recordings.live import LiveFile, LogMessage
from softarm.schemas.messages import RailReading

READINGS = [RailReading(n * 100_000_000, n / 7, float("nan") if n == 3 else -0.0, True) for n in range(30)]


def write(path: Path, readings=READINGS) -> Path:
    with path.open("wb") as file:
        live = LiveFile(file, [RAIL])
        live.note("machine", {"name": "a test's"})
        for reading in readings:
            live.add(LogMessage(RAIL.topic, reading.t_receive_ns, reading.t_receive_ns, RAIL.encode(reading)))
        live.flush()
    return path


@pytest.fixture(scope="session")
def flight_file():
    """The recorded flight of a simulated robot."""
    return Path(__file__).parents[1] / "data" / "flight.mcap"


@pytest.fixture(scope="session")
def log(flight_file):
    return logs.read(flight_file)


@pytest.fixture
def readings():
    return READINGS


@pytest.fixture
def killed(tmp_path):
    """Log of a killed daemon, without chunks and end."""
    return write(tmp_path / "killed.mcap")
