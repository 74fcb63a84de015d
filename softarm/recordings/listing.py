"""List of the logs in a directory."""

from datetime import UTC, datetime
from pathlib import Path

from mcap.reader import make_reader

from softarm.recordings import mcap_file
from softarm.schemas.log import LogEntry


def listing(directory: Path) -> tuple[LogEntry, ...]:
    """Return the logs of a directory, newest first; none if the directory does not exist."""
    entries = (_entry(path) for path in directory.glob("*.mcap"))
    return tuple(sorted((e for e in entries if e is not None), key=lambda e: (e.modified, e.name), reverse=True))


def _entry(path: Path) -> LogEntry | None:
    try:
        state = path.stat()
        finished = mcap_file.is_finished(path)
        duration = _summarised_duration_s(path) if finished else None
    except FileNotFoundError:  # deleted since the listing
        return None
    except Exception:  # unreadable or damaged logs are listed, too
        finished, duration = False, None
    modified = datetime.fromtimestamp(state.st_mtime, UTC)
    return LogEntry(name=path.name, bytes=state.st_size, modified=modified, duration_s=duration, finished=finished)


def _summarised_duration_s(path: Path) -> float | None:
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    if summary is None or summary.statistics is None:
        return None
    return float(summary.statistics.message_end_time - summary.statistics.message_start_time) * 1e-9
