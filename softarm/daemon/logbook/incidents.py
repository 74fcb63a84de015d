"""Writes an incident file for each emergency stop, to be sent with a question about it.

The zip holds the log around the stop, the events, the configuration without token files, and the versions. It is in a
folder next to the logs and is not deleted with them.
"""

import json
import logging
import re
import threading
import zipfile
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from softarm.common import files, revision
from softarm.daemon.access.auth import TOKEN_FILES
from softarm.daemon.control.records import Outputs
from softarm.daemon.logbook import folder
from softarm.daemon.logbook.ticks import TickFile, running_software
from softarm.policies.base import PolicySpec
from softarm.recordings import log_file
from softarm.recordings.live import LogMessage
from softarm.schemas import log as names
from softarm.schemas.config import Config
from softarm.schemas.events import Entry
from softarm.schemas.rest import IncidentEntry

log = logging.getLogger(__name__)

READINGS = (names.PRESSURE, names.RAIL)  # a tick may use an earlier reading of these channels
FOLDER = "incidents"  # in the recorder's directory
NAME = re.compile(r"incident-\d{8}T\d{6}Z(-\d+)?\.zip")  # only files of this name are deleted or sent
BEFORE_NS, AFTER_NS = 20_000_000_000, 5_000_000_000  # a second stop within AFTER_NS is in the same file
END_S = 5.0  # time limit at the daemon's end
EVENTS = 200  # the newest
TEXT_MAX = 1000  # characters of the reason in the listing

READ_ME = """\
{text}
{time:%Y-%m-%d %H:%M:%S} UTC, softarm {version} on {machine}

log.mcap            log from 20 s before to 5 s after the stop: softarm logs replay log.mcap
events.txt          events until then, UTC
configuration.json  configuration in force, without token files
versions.json       software and computer
"""


class Written(NamedTuple):
    """The messages of a tick as in the log."""

    t_ns: int
    policy: PolicySpec | None  # in use
    messages: tuple[tuple[Any, ...], ...]  # plain tuples, which the garbage collector does not scan


class Incident(NamedTuple):
    """Content of an incident file."""

    stop: Entry
    ticks: Sequence[Written]
    readings: Sequence[tuple[Any, ...]]  # newest readings before the first tick, which it may use
    entries: Sequence[Entry]
    monotonic_ns: int
    wall_ns: int


class Incidents:
    """Keeps the log's last seconds in memory and writes them to a file after a stop. For the recorder's thread."""

    def __init__(self, config: Config, monotonic_ns: Callable[[], int], wall_ns: Callable[[], int]) -> None:
        self._config = config
        self._monotonic_ns, self._wall_ns = monotonic_ns, wall_ns
        self._ticks: deque[Written] = deque()
        self._readings: dict[str, tuple[Any, ...]] = {}  # by topic, the newest before those
        self._entries: deque[Entry] = deque(maxlen=EVENTS)
        self._stop: Entry | None = None  # without a file so far
        self._writer: threading.Thread | None = None

    def happened(self, outputs: Outputs, entries: Iterable[Entry]) -> None:
        """Add the events of a tick, and write the file of a stop when it is due."""
        for entry in entries:
            self._entries.append(entry)
            if entry.kind == "stop" and outputs.last_stop_ns is not None and self._stop is None:
                self._stop = entry
        if self._stop is not None and outputs.t_ns - self._stop.t_ns > AFTER_NS and not self._is_writing():
            self._begin(self._stop)

    def wrote(self, t_ns: int, policy: PolicySpec | None, messages: Iterable[LogMessage]) -> None:
        """Add the messages of a tick that is in the log."""
        self._ticks.append(Written(t_ns, policy, tuple(map(tuple, messages))))
        self._forget(t_ns - BEFORE_NS - AFTER_NS)

    def _forget(self, before_ns: int) -> None:
        while self._ticks and self._ticks[0].t_ns < before_ns:
            messages = self._ticks.popleft().messages
            self._readings |= {message[0]: message for message in messages if message[0] in READINGS}

    def end(self) -> None:
        """Write outstanding files within some seconds, at the daemon's end."""
        for _ in range(2):  # one that is being written, one that waits
            if self._writer is not None:
                self._writer.join(timeout=END_S)
            if self._stop is not None and not self._is_writing():
                self._begin(self._stop)

    def _is_writing(self) -> bool:
        return self._writer is not None and self._writer.is_alive()

    def _begin(self, stop: Entry) -> None:
        """Write the file in a separate thread, since it takes about a second."""
        self._forget(stop.t_ns - BEFORE_NS)
        ticks, readings, entries = tuple(self._ticks), tuple(self._readings.values()), tuple(self._entries)
        incident = Incident(stop, ticks, readings, entries, self._monotonic_ns(), self._wall_ns())
        self._stop = None
        self._writer = threading.Thread(target=self._write, args=(incident,), name="recorder incident", daemon=True)
        self._writer.start()

    def _write(self, incident: Incident) -> None:
        settings = self._config.recorder
        directory = settings.directory.absolute() / FOLDER
        try:
            log.info("incident file: %s", write(directory, self._config, incident))
            delete_oldest(directory, settings.incidents_max, settings.incidents_max_mb)
        except OSError as error:
            log.warning("the incident file of the stop could not be written: %s", folder.advice(directory, error))
        except Exception:
            log.exception("the incident file of the stop could not be written; report this")


def write(directory: Path, config: Config, incident: Incident) -> Path:
    """Write an incident file and return its path. Raises OSError, also when the disk is nearly full."""
    directory.mkdir(parents=True, exist_ok=True)
    folder.need_room(directory)
    config, stop = without_secrets(config), incident.stop
    stem = f"incident-{stop.time:%Y%m%dT%H%M%SZ}"
    names = (f"{stem}{suffix}.zip" for suffix in ("", *(f"-{n}" for n in range(2, 1000))))
    path = next(directory / name for name in names if not (directory / name).exists())
    software, machine = running_software(), revision.machine()
    with TemporaryDirectory(prefix="softarm-") as scratch:
        ticks = Path(scratch) / "log.mcap"
        with ticks.open("wb") as file:
            _fill(TickFile(file), config, incident)
        log_file.finish(ticks, folder.Pause())
        with files.replacing(path) as draft, zipfile.ZipFile(draft, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.comment = json.dumps({"time": stop.time.isoformat(), "text": stop.text[:TEXT_MAX]}).encode()
            about = READ_ME.format(text=stop.text, time=stop.time, version=software["softarm"], machine=machine["name"])
            archive.writestr("README.txt", about)
            archive.writestr("events.txt", "".join(f"{e.time:%H:%M:%S.%f} {e.text}\n" for e in incident.entries))
            archive.writestr("configuration.json", config.model_dump_json(indent=1))
            archive.writestr("versions.json", json.dumps(software | machine, indent=1))
            archive.write(ticks, "log.mcap", zipfile.ZIP_STORED)  # already compressed
    return path


def _fill(live: TickFile, config: Config, incident: Incident) -> None:
    """Write the ticks as a log, each after its events."""
    pause, policy = folder.Pause(), incident.ticks[0].policy if incident.ticks else None
    live.head(config, policy, incident.monotonic_ns, incident.wall_ns)
    for reading in incident.readings:
        live.add(LogMessage(*reading))
    for t_ns, now, messages in incident.ticks:
        if now is not policy and now is not None:
            policy = now
            live.policy(policy)
        for entry in incident.entries:
            if entry.t_ns == t_ns:
                live.entry(entry)
        for message in messages:
            live.add(LogMessage(*message))
        pause()
    live.flush()


def without_secrets(config: Config) -> Config:
    """Return a configuration without the names of token files."""
    return config.model_copy(update={"api": config.api.model_copy(update=dict.fromkeys(TOKEN_FILES.values()))})


def listing(directory: Path) -> tuple[IncidentEntry, ...]:
    """Return the incident files of a log directory, newest first."""
    found = (_entry(path) for path in (directory / FOLDER).glob("*.zip") if NAME.fullmatch(path.name))
    return tuple(sorted((entry for entry in found if entry), key=lambda entry: (entry.time, entry.name), reverse=True))


def _entry(path: Path) -> IncidentEntry | None:
    """Return the entry of a file, or None if it is damaged, foreign or deleted meanwhile."""
    try:
        with zipfile.ZipFile(path) as archive:
            comment = json.loads(archive.comment)
        return IncidentEntry(name=path.name, bytes=path.stat().st_size, time=comment["time"], text=comment["text"])
    except (OSError, zipfile.BadZipFile, ValueError, KeyError, TypeError):
        return None


def content(directory: Path, name: str) -> bytes | None:
    """Return the content of a file, or None if there is none. Raises OSError."""
    path = directory / FOLDER / name
    return path.read_bytes() if NAME.fullmatch(name) and path.is_file() else None


def delete_oldest(directory: Path, number_max: int, mb_max: int) -> None:
    """Delete the oldest files beyond a number and total size, never the newest. Raises OSError."""
    paths = sorted((p for p in directory.glob("*.zip") if NAME.fullmatch(p.name)), key=lambda p: p.stat().st_mtime)
    total = sum(path.stat().st_size for path in paths)
    for place, path in enumerate(paths[:-1]):
        if len(paths) - place <= number_max and total <= mb_max * 1e6:
            break
        total -= path.stat().st_size
        path.unlink()
        log.info("deleted an old incident file: %s (recorder.incidents_max, recorder.incidents_max_mb)", path)
