"""A log of rail readings, complete and as a kill leaves it."""

from collections.abc import Iterable
from pathlib import Path

import pytest

from softarm.daemon.logbook import logs
from softarm.recordings.live import RAIL, LiveFile, LogMessage
from softarm.schemas.messages import RailReading

READINGS = [RailReading(n * 100_000_000, n / 7, float("nan") if n == 3 else -0.0, True) for n in range(30)]


def write(path: Path, messages: Iterable[tuple[int, bytes]]) -> Path:
    """Write messages of the rail, each with its stamp, as a daemon does that is then killed."""
    with path.open("wb") as file:
        live = LiveFile(file, [RAIL])
        live.note("machine", {"name": "a test's"})
        for stamp_ns, data in messages:
            live.add(LogMessage(RAIL.topic, stamp_ns, stamp_ns, data))
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
    return write(tmp_path / "killed.mcap", ((each.t_receive_ns, RAIL.encode(each)) for each in READINGS))
