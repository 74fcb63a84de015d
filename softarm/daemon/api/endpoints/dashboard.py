"""The dashboard's files at `/` and `/dashboard/`. They contain no data of the robot, so they require no log-in.

The daemon reads all files of `softarm.daemon.dashboard`, and those that it shares with the reports, once at its start.
A request therefore cannot name any other file, and a slow disk cannot delay the API. A changed file is served after the
next start.
"""

import hashlib
import re
from collections.abc import Callable, Iterator
from importlib import resources
from importlib.resources.abc import Traversable
from typing import NamedTuple

from fastapi import APIRouter, Request
from fastapi.responses import Response

from softarm.daemon.api.refusals import Refused

# Files of other types are not served.
TYPES = {
    "css": "text/css; charset=utf-8",
    "html": "text/html; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "svg": "image/svg+xml",
}
INDEX = "index.html"
STOP_PORT = '<meta name="stop-port" content="{port}">'
HOST = re.compile(r"([A-Za-z0-9.-]+)(:\d+)?")  # a content security policy cannot name an IPv6 address
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; font-src 'self'; "
    "manifest-src 'self'; frame-src 'self'; connect-src 'self'{stop}; frame-ancestors 'none'; "
    "base-uri 'none'; form-action 'none'"
)
# Browsers revalidate a file each time and get 304 if it is unchanged.
HEADERS = {
    "Cache-Control": "no-cache",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
}


class _File(NamedTuple):
    content: bytes
    kind: str


class DashboardFiles:
    """Endpoints that serve the dashboard's files; they are not part of the API's schema."""

    def __init__(self, stop_port: Callable[[], int | None]) -> None:
        """Read the files; `stop_port` returns the dedicated stop port, which the page needs at once."""
        self._stop_port = stop_port
        self._files = dict(_files(resources.files("softarm.daemon.dashboard")))
        self._files |= _files(resources.files("softarm.reporting") / "shared", "shared/")

    def router(self) -> APIRouter:
        """Return the routes of these endpoints."""
        router = APIRouter(include_in_schema=False, default_response_class=Response)
        router.get("/")(self.index)
        router.get("/dashboard/{path:path}")(self.file)
        return router

    async def index(self, request: Request) -> Response:
        """Return the dashboard's page."""
        return self.answer(INDEX, request)

    async def file(self, request: Request, path: str) -> Response:
        """Return a script, style or picture of the dashboard."""
        return self.answer(path, request)

    def answer(self, path: str, request: Request) -> Response:
        """Return a file, or 304 if the browser has it. Raises Refused for an unknown path."""
        file = self._files.get(path)
        if file is None:
            raise Refused(404, f"the dashboard has no file '{path[:60]}'; its page is /")
        content, port = file.content, self._stop_port()
        if path == INDEX:
            empty, filled = (STOP_PORT.format(port=each).encode() for each in ("", port or ""))
            content = content.replace(empty, filled)
        etag = f'"{hashlib.sha256(content).hexdigest()[:32]}"'
        stop = stop_source(request.headers.get("host", ""), port)
        headers = HEADERS | {"Content-Security-Policy": POLICY.format(stop=stop), "ETag": etag}
        if etag in request.headers.get("if-none-match", ""):
            return Response(status_code=304, headers=headers)
        return Response(content, headers=headers | {"Content-Type": file.kind})


def stop_source(host: str, port: int | None) -> str:
    """Return the dedicated stop port on this host as a CSP source with a leading blank, or an empty text."""
    named = HOST.fullmatch(host)
    return f" http://{named[1]}:{port}" if named and port else ""


def _files(folder: Traversable, above: str = "") -> Iterator[tuple[str, _File]]:
    for entry in folder.iterdir():
        kind = TYPES.get(entry.name.rpartition(".")[2].lower())
        if entry.is_dir():
            yield from _files(entry, f"{above}{entry.name}/")
        elif kind is not None:
            yield above + entry.name, _File(entry.read_bytes(), kind)
