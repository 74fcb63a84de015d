"""An incident file for each emergency stop: all that a person sends who asks what happened.

A zip of the log around it (which replays by itself), the events up to there, the configuration without the files of
tokens, and versions. It lies beside the logs and is none: what deletes those leaves it alone.
"""

import json
import logging
import re
import threading
import time
import zipfile
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from softarm.common import files, revision
from softarm.daemon.api.auth import TOKEN_FILES
from softarm.daemon.control.records import Outputs
from softarm.daemon.logbook import folder
from softarm.daemon.logbook.tick_file import PACKAGES, TickFile
from softarm.policies.base import PolicySpec
from softarm.recordings import finishing
from softarm.recordings.live import LogMessage
from softarm.schemas import log as names
from softarm.schemas.config import Config
from softarm.schemas.events import Entry
from softarm.schemas.rest import IncidentEntry

log = logging.getLogger(__name__)

READINGS = (names.PRESSURE, names.RAIL)  # channels of which a tick may use what an earlier one brought
FOLDER = "incidents"  # in the recorder's directory
NAME = re.compile(r"incident-\d{8}T\d{6}Z(-\d+)?\.zip")  # only what was named here is ever deleted, or handed out
BEFORE_NS, AFTER_NS = 20_000_000_000, 5_000_000_000  # of the stop; one that follows so soon is in the same file
END_S = 5.0  # for the file of a daemon that ends
EVENTS = 200  # the newest
TEXT_MAX = 1000  # characters of the reason in the listing
BREATH_RECORDS, BREATH_S = 20, 0.002

READ_ME = """\
{text}
{time:%Y-%m-%d %H:%M:%S} UTC, softarm {version} on {machine}

log.mcap            the log from 20 s before to 5 s after: softarm replay log.mcap
events.txt          what happened up to there, UTC
configuration.json  as it was in force, without the files of tokens
versions.json       software and machine
"""


class Written(NamedTuple):
    """A tick as the log has it."""

    t_ns: int
    policy: PolicySpec | None  # in use
    messages: tuple[tuple[Any, ...], ...]  # bare tuples of numbers and bytes: no garbage collection looks into those


class Incident(NamedTuple):
    """What the file of one is made of."""

    stop: Entry
    ticks: Sequence[Written]
    readings: Sequence[tuple[Any, ...]]  # of the devices, the newest before the first tick: it may use them
    entries: Sequence[Entry]
    monotonic_ns: int
    wall_ns: int


class Incidents:
    """Keeps the log's last seconds in memory, has a file written of them after a stop. For the recorder's thread."""

    def __init__(self, config: Config, monotonic_ns: Callable[[], int], wall_ns: Callable[[], int]) -> None:
        self._config = config
        self._monotonic_ns, self._wall_ns = monotonic_ns, wall_ns
        self._ticks: deque[Written] = deque()
        self._readings: dict[str, tuple[Any, ...]] = {}  # by topic, the newest before those
        self._entries: deque[Entry] = deque(maxlen=EVENTS)
        self._stop: Entry | None = None  # of which no file is begun yet
        self._writer: threading.Thread | None = None

    def happened(self, outputs: Outputs, entries: Iterable[Entry]) -> None:
        """One tick more, and what happened in it."""
        for entry in entries:
            self._entries.append(entry)
            if entry.kind == "stop" and outputs.last_stop_ns is not None and self._stop is None:
                self._stop = entry
        if self._stop is not None and outputs.t_ns - self._stop.t_ns > AFTER_NS and not self._is_writing():
            self._begin(self._stop)

    def wrote(self, t_ns: int, policy: PolicySpec | None, messages: Iterable[LogMessage]) -> None:
        """The messages of one tick more are in the log."""
        self._ticks.append(Written(t_ns, policy, tuple(map(tuple, messages))))
        self._forget(t_ns - BEFORE_NS - AFTER_NS)

    def _forget(self, before_ns: int) -> None:
        while self._ticks and self._ticks[0].t_ns < before_ns:
            messages = self._ticks.popleft().messages
            self._readings |= {message[0]: message for message in messages if message[0] in READINGS}

    def end(self) -> None:
        """The daemon ends: what has happened is written. Takes some seconds at most."""
        for _ in range(2):  # one that is being written, one that waits
            if self._writer is not None:
                self._writer.join(timeout=END_S)
            if self._stop is not None and not self._is_writing():
                self._begin(self._stop)

    def _is_writing(self) -> bool:
        return self._writer is not None and self._writer.is_alive()

    def _begin(self, stop: Entry) -> None:
        """In a thread of its own: it takes a second, and the log goes on."""
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
            log.warning("no incident file of the stop: %s", folder.advice(directory, error))
        except Exception:
            log.exception("no incident file of the stop: report this")


def write(directory: Path, config: Config, incident: Incident) -> Path:
    """Write the file of an incident; returns its path. Raises OSError, also when the disk is nearly full."""
    directory.mkdir(parents=True, exist_ok=True)
    folder.need_room(directory)
    config, stop = without_secrets(config), incident.stop
    stem = f"incident-{stop.time:%Y%m%dT%H%M%SZ}"
    names = (f"{stem}{suffix}.zip" for suffix in ("", *(f"-{n}" for n in range(2, 1000))))
    path = next(directory / name for name in names if not (directory / name).exists())
    software, machine = revision.software(PACKAGES), revision.machine()
    with TemporaryDirectory(prefix="softarm-") as scratch:
        ticks = Path(scratch) / "log.mcap"
        with ticks.open("wb") as file:
            _fill(TickFile(file), config, incident)
        finishing.finish(ticks, _Breath())
        with files.replacing(path) as draft, zipfile.ZipFile(draft, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.comment = json.dumps({"time": stop.time.isoformat(), "text": stop.text[:TEXT_MAX]}).encode()
            about = READ_ME.format(text=stop.text, time=stop.time, version=software["softarm"], machine=machine["name"])
            archive.writestr("README.txt", about)
            archive.writestr("events.txt", "".join(f"{e.time:%H:%M:%S.%f} {e.text}\n" for e in incident.entries))
            archive.writestr("configuration.json", config.model_dump_json(indent=1))
            archive.writestr("versions.json", json.dumps(software | machine, indent=1))
            archive.write(ticks, "log.mcap", zipfile.ZIP_STORED)  # is compressed already
    return path


def _fill(live: TickFile, config: Config, incident: Incident) -> None:
    """The ticks as a log, each after what happened in it."""
    breathe, policy = _Breath(), incident.ticks[0].policy if incident.ticks else None
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
        breathe()
    live.flush()


class _Breath:
    """Called for each record, gives the interpreter back now and then: the control loop needs it, too."""

    def __init__(self) -> None:
        self._records = 0

    def __call__(self) -> None:
        self._records += 1
        if self._records % BREATH_RECORDS == 0:
            time.sleep(BREATH_S)


def without_secrets(config: Config) -> Config:
    """A configuration that a stranger may read: without the files that hold tokens."""
    return config.model_copy(update={"api": config.api.model_copy(update=dict.fromkeys(TOKEN_FILES.values()))})


def listing(directory: Path) -> tuple[IncidentEntry, ...]:
    """The incident files beside the logs in a directory, newest first."""
    found = (_entry(path) for path in (directory / FOLDER).glob("*.zip") if NAME.fullmatch(path.name))
    return tuple(sorted((entry for entry in found if entry), key=lambda entry: (entry.time, entry.name), reverse=True))


def _entry(path: Path) -> IncidentEntry | None:
    """None for what is none of ours, damaged, or gone between the listing and the look."""
    try:
        with zipfile.ZipFile(path) as archive:
            told = json.loads(archive.comment)
        return IncidentEntry(name=path.name, bytes=path.stat().st_size, time=told["time"], text=told["text"])
    except (OSError, zipfile.BadZipFile, ValueError, KeyError, TypeError):
        return None


def content(directory: Path, name: str) -> bytes | None:
    """A file by its name; None where there is none. Raises OSError."""
    path = directory / FOLDER / name
    return path.read_bytes() if NAME.fullmatch(name) and path.is_file() else None


def delete_oldest(directory: Path, number_max: int, mb_max: int) -> list[Path]:
    """Delete the oldest until no more than so many and so large are left; never the newest. Raises OSError."""
    paths = sorted((p for p in directory.glob("*.zip") if NAME.fullmatch(p.name)), key=lambda p: p.stat().st_mtime)
    total = sum(path.stat().st_size for path in paths)
    deleted = []
    for place, path in enumerate(paths[:-1]):
        if len(paths) - place <= number_max and total <= mb_max * 1e6:
            break
        total -= path.stat().st_size
        path.unlink()
        deleted.append(path)
        log.info("deleted an old incident file: %s (recorder.incidents_max, recorder.incidents_max_mb)", path)
    return deleted
