"""Files that lie beside the daemon: logs (to keep, to delete, to replay), incident files, reports of the diagnosis."""

import asyncio
import contextlib
import os
import re
import stat
from collections.abc import AsyncIterator, Callable
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import BinaryIO
from urllib.parse import quote

import anyio.to_thread
from fastapi import Request
from fastapi.responses import Response, StreamingResponse
from starlette.types import Receive, Scope, Send

from softarm.daemon.api.aside import Aside
from softarm.daemon.api.bounds import WHO
from softarm.daemon.api.refusals import Refused, json_response
from softarm.daemon.api.status import RecorderState
from softarm.daemon.logbook import incidents
from softarm.daemon.shell import replay_aside
from softarm.recordings import finishing
from softarm.recordings.listing import listing
from softarm.schemas.config import Config
from softarm.schemas.rest import IncidentsAnswer, LogDeleted, LogsAnswer, ReplayAnswer, ReportEntry, ReportsAnswer

LISTINGS_MAX, LISTING_S = 8, 30.0
DOWNLOADS_MAX = 4  # at once
CHUNK = 131_072  # bytes
OPEN = os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK  # a link leads nowhere, a pipe holds up nobody
REPLAY_S = 300.0
GONE_S = 0.5  # between looks whether somebody still waits for a replay
LOG, REPORT = (re.compile(rf"[^/\x00-\x1f\x7f.][^/\x00-\x1f\x7f]*\.{kind}") for kind in ("mcap", "html"))
# A report has scripts. In a sandbox it is a page of nobody: no cookie goes with what it asks, and nothing is answered.
SANDBOX = (
    "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data:; font-src data:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)


class Files:
    """Answers with files, and deletes them."""

    def __init__(self, config: Config, recorder: RecorderState | None) -> None:
        self._logs = config.recorder.directory.absolute()
        self._reports = config.api.reports.absolute()
        self._recorder = recorder
        self._looking = Aside(LISTINGS_MAX, LISTING_S)
        self._replaying = Aside(1, REPLAY_S + 10.0)
        self._downloads = 0

    async def logs(self) -> Response:
        """The logs in the recorder's directory."""
        current = self._recorder.path if self._recorder else None
        found = await self._looking.run("listing the logs", lambda: listing(self._logs))
        own = None if current is None else current.name
        entries = tuple(entry.model_copy(update={"recording": entry.name == own}) for entry in found)
        return json_response(LogsAnswer(directory=str(self._logs), logs=entries).model_dump_json())

    async def log(self, name: str) -> Response:
        """A log, to be kept; of the one being recorded what there is of it now."""
        file, size = await self._open(_path(self._logs, name, LOG, "log", "logs"))
        saved = {"Content-Disposition": f"attachment; filename*=UTF-8''{quote(name)}"}
        return self._download(file, size, "application/octet-stream", saved)

    async def delete_log(self, request: Request, name: str) -> Response:
        """Delete a log; not one that is being written."""
        path = _path(self._logs, name, LOG, "log", "logs")
        await self._looking.run("deleting a log", partial(_delete, path))
        if self._recorder is not None:
            self._recorder.done("delete_log", f"delete log {name}", request.scope[WHO])
        return json_response(LogDeleted(name=name).model_dump_json())

    async def replay_log(self, request: Request, name: str) -> Response:
        """Run a log through the tick again, elsewhere: the same commands, bit for bit? Takes up to five minutes."""
        path = _path(self._logs, name, LOG, "log", "logs")
        one = replay_aside.Replay(path, REPLAY_S)
        waiting = asyncio.create_task(self._replaying.run("replaying a log", partial(_replayed, one)))
        try:
            while not (await asyncio.wait({waiting}, timeout=GONE_S))[0]:
                if await request.is_disconnected():
                    break
        finally:
            one.end()
        return json_response((await waiting).model_dump_json())

    async def incidents(self) -> Response:
        """The files of emergency stops; GET /api/incidents/NAME gives one."""
        found = await self._looking.run("listing the incident files", lambda: incidents.listing(self._logs))
        answer = IncidentsAnswer(directory=str(self._logs / incidents.FOLDER), incidents=found)
        return json_response(answer.model_dump_json())

    async def incident(self, name: str) -> Response:
        """The file of an emergency stop, a zip to be sent."""
        content = await self._looking.run("reading an incident file", lambda: incidents.content(self._logs, name))
        if content is None:
            raise _missing(name, "incident file", "incidents")
        saved = {"Content-Disposition": f'attachment; filename="{name}"'}
        return Response(content, media_type="application/zip", headers=saved)

    async def reports(self) -> Response:
        """The reports of the diagnosis; GET /api/reports/NAME shows one."""
        found = await self._looking.run("listing the reports", lambda: _reports(self._reports))
        return json_response(ReportsAnswer(directory=str(self._reports), reports=found).model_dump_json())

    async def report(self, name: str) -> Response:
        """A report, a page in a sandbox: it can show itself and nothing else."""
        file, size = await self._open(_path(self._reports, name, REPORT, "report", "reports"))
        return self._download(file, size, "text/html; charset=utf-8", {"Content-Security-Policy": SANDBOX})

    async def _open(self, path: Path) -> tuple[BinaryIO, int]:
        if self._downloads >= DOWNLOADS_MAX:
            raise Refused(503, f"{DOWNLOADS_MAX} files are being sent already: wait for one to end")
        return await self._looking.run("opening a file", partial(_opened, path))

    def _download(self, file: BinaryIO, size: int, kind: str, headers: dict[str, str]) -> Response:
        headers |= {"Content-Length": str(size), "X-Content-Type-Options": "nosniff", "Cache-Control": "no-store"}
        self._downloads += 1
        return _Sent(file, size, kind, headers, self._sent)

    def _sent(self) -> None:
        self._downloads -= 1


class _Sent(StreamingResponse):
    """So many bytes of a file, read in a thread a piece at a time as the client takes them."""

    def __init__(
        self, file: BinaryIO, size: int, kind: str, headers: dict[str, str], afterwards: Callable[[], None]
    ) -> None:
        async def pieces() -> AsyncIterator[bytes]:
            left = size
            while left and (piece := await anyio.to_thread.run_sync(file.read, min(CHUNK, left))):
                left -= len(piece)
                yield piece

        super().__init__(pieces(), headers=headers, media_type=kind)
        self._file, self._afterwards = file, afterwards

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """However it ends, the file is closed."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._afterwards()
            self._file.close()


def _path(directory: Path, name: str, allowed: re.Pattern[str], what: str, listed: str) -> Path:
    """In the directory itself, nowhere else. Raises Refused for a name that none there has."""
    if not allowed.fullmatch(name):
        raise _missing(name, what, listed)
    return directory / name


def _missing(name: str, what: str, listed: str) -> Refused:
    return Refused(404, f"no {what} '{name[:60]}'; GET /api/{listed} lists them")


def _opened(path: Path) -> tuple[BinaryIO, int]:
    """A file and its size now. Raises Refused."""
    what = "log" if path.suffix == ".mcap" else "report"
    try:
        descriptor = os.open(path, OPEN)
    except (FileNotFoundError, IsADirectoryError):
        raise _missing(path.name, what, f"{what}s") from None
    except OSError as error:
        raise Refused(409, f"{path}: cannot be read ({error.strerror}); look at its owner and mode") from error
    state = os.fstat(descriptor)
    if not stat.S_ISREG(state.st_mode):
        os.close(descriptor)
        raise _missing(path.name, what, f"{what}s")
    return os.fdopen(descriptor, "rb"), state.st_size


def _delete(path: Path) -> None:
    """Raises Refused."""
    file, _ = _opened(path)
    with file:
        if finishing.is_held(path):
            raise Refused(409, f"{path.name} is being recorded: a log is deleted once it is finished")
        try:
            path.unlink()
        except OSError as error:
            raise Refused(409, f"{path}: cannot be deleted ({error.strerror}); look at its folder's mode") from error


def _replayed(one: replay_aside.Replay) -> ReplayAnswer:
    """Raises Refused."""
    _opened(one.path)[0].close()
    try:
        return one.run()
    except replay_aside.ReplayError as error:
        raise Refused(422, str(error)) from error
    except TimeoutError as error:
        raise Refused(504, f"{error}; `softarm replay` on the machine itself has no limit") from error


def _reports(directory: Path) -> tuple[ReportEntry, ...]:
    """Newest first. A directory that is not there holds none."""
    entries = []
    for path in directory.glob("*.html"):
        with contextlib.suppress(OSError):  # gone meanwhile
            state = path.stat()
            if REPORT.fullmatch(path.name) and stat.S_ISREG(state.st_mode):
                modified = datetime.fromtimestamp(state.st_mtime, UTC)
                entries.append(ReportEntry(name=path.name, bytes=state.st_size, modified=modified))
    return tuple(sorted(entries, key=lambda entry: (entry.modified, entry.name), reverse=True))
