"""The dashboard's files at `/` and `/dashboard/`: they hold nothing of the robot, so they take no log-in.

All of `softarm.daemon.dashboard` is read once, when the daemon starts: what is not among its files cannot be asked for,
whatever the path, and no disk holds up the API. A file that is changed is served after the next start.
"""

import hashlib
import re
from collections.abc import Callable, Iterator
from importlib import resources
from importlib.resources.abc import Traversable
from typing import NamedTuple

from fastapi import Request
from fastapi.responses import Response

from softarm.daemon.api.refusals import Refused

TYPES = {  # what a browser may be given; other files stay where they are
    "css": "text/css; charset=utf-8",
    "html": "text/html; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "json": "application/json",
    "mjs": "text/javascript; charset=utf-8",
    "png": "image/png",
    "svg": "image/svg+xml",
    "txt": "text/plain; charset=utf-8",
    "webmanifest": "application/manifest+json",
    "woff2": "font/woff2",
}
INDEX = "index.html"
HOST = re.compile(r"([A-Za-z0-9.-]+)(:\d+)?")  # a policy of contents has no word for an IPv6 address
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; font-src 'self'; "
    "manifest-src 'self'; connect-src 'self'{stop}; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
ALWAYS = {
    "Cache-Control": "no-cache",  # asked for anew each time, and answered by 304 where nothing has changed
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
}


class _File(NamedTuple):
    content: bytes
    kind: str
    etag: str


class Pages:
    """Answers with the dashboard's files."""

    def __init__(self, stop_port: Callable[[], int | None], folder: Traversable | None = None) -> None:
        """folder: another one than the installed."""
        self._stop_port = stop_port
        self._files = dict(_files(folder or resources.files("softarm.daemon.dashboard")))

    async def index(self, request: Request) -> Response:
        """The dashboard."""
        return self._answer(INDEX, request)

    async def file(self, request: Request, path: str) -> Response:
        """A file of the dashboard: script, style, picture."""
        return self._answer(path, request)

    def _answer(self, path: str, request: Request) -> Response:
        file = self._files.get(path)
        if file is None:
            raise Refused(404, f"the dashboard has no file '{path[:60]}'; it begins at /")
        stop = stop_source(request.headers.get("host", ""), self._stop_port())
        headers = ALWAYS | {"Content-Security-Policy": POLICY.format(stop=stop), "ETag": file.etag}
        if file.etag in request.headers.get("if-none-match", ""):
            return Response(status_code=304, headers=headers)
        return Response(file.content, headers=headers | {"Content-Type": file.kind})


def stop_source(host: str, port: int | None) -> str:
    """Of the stop's own way on the host that a page was asked of, as a policy of contents names it; else nothing."""
    named = HOST.fullmatch(host)
    return f" http://{named[1]}:{port}" if named and port else ""


def _files(folder: Traversable, above: str = "") -> Iterator[tuple[str, _File]]:
    """All that may be served of a folder, by path."""
    for entry in folder.iterdir():
        kind = TYPES.get(entry.name.rpartition(".")[2].lower())
        if entry.is_dir():
            yield from _files(entry, f"{above}{entry.name}/")
        elif kind is not None:
            content = entry.read_bytes()
            yield above + entry.name, _File(content, kind, f'"{hashlib.sha256(content).hexdigest()[:32]}"')
