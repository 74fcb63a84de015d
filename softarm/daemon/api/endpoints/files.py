"""Endpoints for logs, incident files and diagnosis reports. Their docstrings are the texts of /docs."""

import asyncio
import contextlib
import os
import re
import stat
import tempfile
from collections.abc import AsyncIterator, Callable
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import BinaryIO
from urllib.parse import quote

import anyio.to_thread
from fastapi import APIRouter, Request
from fastapi.responses import Response, StreamingResponse
from starlette.types import Receive, Scope, Send

from softarm.daemon.api.bounds import WHO
from softarm.daemon.api.refusals import Refused, answers, content, json_response
from softarm.daemon.api.workers import LISTING_S, LISTINGS_MAX, Workers
from softarm.daemon.logbook import incidents
from softarm.daemon.logbook.recorder import Recorder
from softarm.daemon.runtime.jobs import JobError
from softarm.daemon.runtime.verb_process import VerbProcess
from softarm.recordings import log_file
from softarm.recordings.log_file import listing
from softarm.schemas.config import Config
from softarm.schemas.rest import IncidentsAnswer, LogDeleted, LogsAnswer, ReportEntry, ReportsAnswer

DOWNLOADS_MAX = 4
CHUNK_BYTES = 131_072
OPEN = os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK  # neither follow a link nor block on a pipe
VIEW_S = 300.0  # longest time to make a player page
POLL_S = 0.5  # between checks whether the client of a player page is still connected
HEADERS = {"X-Content-Type-Options": "nosniff", "Cache-Control": "no-store"}
NAME = r"[^/\x00-\x1f\x7f.][^/\x00-\x1f\x7f]*"
NAMES = {"log": re.compile(rf"{NAME}\.mcap"), "report": re.compile(rf"{NAME}\.html")}
# A report contains scripts. The sandbox gives it no origin, so its requests carry no cookie and get no answer.
SANDBOX = (
    "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data:; font-src data:; frame-ancestors 'self'; base-uri 'none'; form-action 'none'"
)


class Files:
    """Endpoints that list, send, show and delete files."""

    def __init__(self, config: Config, recorder: Recorder | None) -> None:
        self._logs = config.recorder.directory.absolute()
        self._reports = config.api.reports.absolute()
        self._recorder = recorder
        self._working = Workers(LISTINGS_MAX, LISTING_S)
        self._viewing = Workers(1, VIEW_S + 10.0)
        self._downloads = 0

    def router(self) -> APIRouter:
        """Return the routes of these endpoints."""
        router = APIRouter(tags=["Files"], default_response_class=Response)
        mcap, page = content("application/octet-stream"), content("text/html", text=True)
        router.get("/api/logs", responses=answers(LogsAnswer, 503, 504))(self.logs)
        router.get("/api/logs/{name}", responses=answers(mcap, 404, 409, 503, 504))(self.log)
        router.delete("/api/logs/{name}", responses=answers(LogDeleted, 404, 409, 503, 504))(self.delete_log)
        shown = answers(page, 404, 409, 422, 503, 504)
        router.get("/api/logs/{name}/view", responses=shown)(self.view_log)
        router.get("/api/incidents", responses=answers(IncidentsAnswer, 503, 504))(self.incidents)
        archive = answers(content("application/zip"), 404, 503, 504)
        router.get("/api/incidents/{name}", responses=archive)(self.incident)
        router.get("/api/reports", responses=answers(ReportsAnswer, 503, 504))(self.reports)
        router.get("/api/reports/{name}", responses=answers(page, 404, 409, 503, 504))(self.report)
        return router

    async def logs(self) -> Response:
        """Return the logs in the recorder's directory, newest first."""
        current = self._recorder.path if self._recorder else None
        found = await self._working.run("listing the logs", lambda: listing(self._logs))
        own = None if current is None else current.name
        entries = tuple(entry.model_copy(update={"recording": entry.name == own}) for entry in found)
        return json_response(LogsAnswer(directory=str(self._logs), logs=entries).model_dump_json())

    async def log(self, name: str) -> Response:
        """Download a log. Of the log being recorded, download what is written so far."""
        saved = {"Content-Disposition": f"attachment; filename*=UTF-8''{quote(name)}"}
        return await self._download(_path(self._logs, name, "log"), "application/octet-stream", saved)

    async def delete_log(self, request: Request, name: str) -> Response:
        """Delete a log. The log being recorded cannot be deleted."""
        path = _path(self._logs, name, "log")
        await self._working.run("deleting a log", partial(_delete, path))
        if self._recorder is not None:
            self._recorder.done("delete_log", f"delete log {name}", request.scope[WHO])
        return json_response(LogDeleted(name=name).model_dump_json())

    async def view_log(self, request: Request, name: str) -> Response:
        """Return the player page of a log, sandboxed. Made in a separate process, one at a time."""
        path = await self._working.run("opening a log", partial(existing_log, self._logs, name))
        with tempfile.TemporaryDirectory(prefix="softarm-") as folder:
            made = Path(folder, "page.html")
            verb = VerbProcess("logs", "view", str(path), "--no-open", "--out", str(made), limit_s=VIEW_S)
            await self._finished(request, verb)
            page = await self._working.run("reading a player page", made.read_bytes)
        return Response(
            page, media_type="text/html; charset=utf-8", headers=HEADERS | {"Content-Security-Policy": SANDBOX}
        )

    async def _finished(self, request: Request, verb: VerbProcess) -> None:
        """Run a verb, which ends when the client leaves, or raise Refused."""
        waiting = asyncio.create_task(self._viewing.run("making a player page", verb.output))
        try:
            while not (await asyncio.wait({waiting}, timeout=POLL_S))[0]:
                if await request.is_disconnected():
                    break
        finally:
            verb.end()
        try:
            ended = await waiting
        except JobError as error:
            raise Refused(504, *error.args) from error
        if ended.code:
            raise Refused(422, ended.last)

    async def incidents(self) -> Response:
        """Return the incident files of emergency stops, newest first."""
        found = await self._working.run("listing the incident files", lambda: incidents.listing(self._logs))
        answer = IncidentsAnswer(directory=str(self._logs / incidents.FOLDER), incidents=found)
        return json_response(answer.model_dump_json())

    async def incident(self, name: str) -> Response:
        """Download the incident file of an emergency stop, a zip."""
        content = await self._working.run("reading an incident file", lambda: incidents.content(self._logs, name))
        if content is None:
            raise _missing(name, "incident file")
        saved = {"Content-Disposition": f'attachment; filename="{name}"'}
        return Response(content, media_type="application/zip", headers=saved)

    async def reports(self) -> Response:
        """Return the diagnosis reports, newest first."""
        found = await self._working.run("listing the reports", lambda: _reports(self._reports))
        return json_response(ReportsAnswer(directory=str(self._reports), reports=found).model_dump_json())

    async def report(self, name: str) -> Response:
        """Return a report as a sandboxed page, which can load nothing else."""
        sandbox = {"Content-Security-Policy": SANDBOX}
        return await self._download(_path(self._reports, name, "report"), "text/html; charset=utf-8", sandbox)

    async def _download(self, path: Path, kind: str, headers: dict[str, str]) -> Response:
        if self._downloads >= DOWNLOADS_MAX:
            raise Refused(503, f"{DOWNLOADS_MAX} downloads are running already: retry when one has finished")
        self._downloads += 1
        try:
            file, size = await self._working.run("opening a file", partial(_opened, path))
        except BaseException:  # includes the cancellation of the request
            self._downloads -= 1
            raise
        headers |= HEADERS | {"Content-Length": str(size)}
        return _Sent(file, size, kind, headers, self._sent)

    def _sent(self) -> None:
        self._downloads -= 1


class _Sent(StreamingResponse):
    """Response that reads a file in a thread, chunk by chunk, as fast as the client accepts it."""

    def __init__(
        self, file: BinaryIO, size: int, kind: str, headers: dict[str, str], afterwards: Callable[[], None]
    ) -> None:
        async def pieces() -> AsyncIterator[bytes]:
            left = size
            while left and (piece := await anyio.to_thread.run_sync(file.read, min(CHUNK_BYTES, left))):
                left -= len(piece)
                yield piece

        super().__init__(pieces(), headers=headers, media_type=kind)
        self._file, self._afterwards = file, afterwards

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the response and close the file in every case."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._afterwards()
            self._file.close()


def existing_log(directory: Path, name: str) -> Path:
    """Return the path of a log that can be read, or raise Refused."""
    path = _path(directory, name, "log")
    _opened(path)[0].close()
    return path


def _path(directory: Path, name: str, kind: str) -> Path:
    """Return the path of a file in the directory itself. Raises Refused for any other name."""
    if not NAMES[kind].fullmatch(name):
        raise _missing(name, kind)
    return directory / name


def _missing(name: str, kind: str) -> Refused:
    return Refused(404, f"no {kind} '{name[:60]}'; GET /api/{kind.partition(' ')[0]}s lists them")


def _opened(path: Path) -> tuple[BinaryIO, int]:
    """Return an open file and its present size. Raises Refused."""
    kind = "log" if path.suffix == ".mcap" else "report"
    try:
        descriptor = os.open(path, OPEN)
    except (FileNotFoundError, IsADirectoryError):
        raise _missing(path.name, kind) from None
    except OSError as error:
        raise Refused(409, f"{path}: cannot be read ({error.strerror}); check its owner and mode") from error
    state = os.fstat(descriptor)
    if not stat.S_ISREG(state.st_mode):
        os.close(descriptor)
        raise _missing(path.name, kind)
    return os.fdopen(descriptor, "rb"), state.st_size


def _delete(path: Path) -> None:
    """Delete a log, or raise Refused."""
    file, _ = _opened(path)
    with file:
        if log_file.is_held(path):
            raise Refused(409, f"{path.name} is being recorded: delete it when it is finished")
        try:
            path.unlink()
        except OSError as error:
            raise Refused(409, f"{path}: cannot be deleted ({error.strerror}); check its folder's mode") from error


def _reports(directory: Path) -> tuple[ReportEntry, ...]:
    """Return the reports newest first; none if the directory is missing."""
    entries = []
    for path in directory.glob("*.html"):
        with contextlib.suppress(OSError):  # deleted meanwhile
            state = path.stat()
            if NAMES["report"].fullmatch(path.name) and stat.S_ISREG(state.st_mode):
                modified = datetime.fromtimestamp(state.st_mtime, UTC)
                entries.append(ReportEntry(name=path.name, bytes=state.st_size, modified=modified))
    return tuple(sorted(entries, key=lambda entry: (entry.modified, entry.name), reverse=True))
