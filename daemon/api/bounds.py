"""What a guest may take up before it is heard: who may ask, how large a body, how long, how many at once."""

import asyncio
from collections.abc import Mapping
from typing import Any
from urllib.parse import parse_qs

from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from softarm.daemon.api.auth import Door, Role
from softarm.daemon.api.login import Sessions
from softarm.daemon.api.refusals import refusal
from softarm.schemas.rest import API_HEADER, API_VERSION

BODY_MAX = 4096  # bytes; the longest that means anything, a goal, has a hundred
BODY_S = 5.0  # for all of it
HEADER_MAX = 16_384  # bytes
DEAF_S = 30.0  # that a client may leave what it is sent lie
QUIET_S = 5.0  # without a whole request, since the connection was made or answered last
CONNECTIONS_MAX = 128
STREAMS_MAX = 32
MESSAGE_MAX = 1024  # bytes of what a WebSocket client says, which nobody listens to
STOP = "/api/stop"  # is carried out whatever comes along with it
VERSION = (API_HEADER.encode(), b"%d" % API_VERSION)
WHO, SESSION = "softarm.who", "softarm.session"  # in the scope: who asks, and the role of one who has logged in
LOGIN, PAGES = "/api/login", "/dashboard/"
SMALL = {("POST", "/api/logout"): Role.STOP, ("POST", "/api/ticket"): Role.VIEW}  # what changes nothing of the robot
CLOSE = {"Connection": "close"}  # what is left of such a body is not read


class Guard:
    """ASGI middleware in front of everything, WebSockets included: who may ask, then how much they may send."""

    def __init__(self, app: ASGIApp, door: Door, sessions: Sessions) -> None:
        self._app, self._door, self._sessions = app, door, sessions

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on with the whole body, or answer with a sentence."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = dict(scope["headers"])
        session = None if b"authorization" in headers else self._session(scope, headers)
        scope[SESSION] = session
        way = "the API" if session is None else "a browser"
        scope[WHO] = self._door.who(way, headers, (scope.get("client") or (None,))[0], session)
        send = _versioned(send)
        refused = self._door.refusal(headers, _role(scope), session=session) or self._forged(scope, headers, session)
        if refused is None and scope["type"] == "http" and scope["path"] != STOP:
            refused = _too_new(headers.get(VERSION[0])) or _too_long(headers.get(b"content-length", b""))
            if refused is None:
                try:
                    async with asyncio.timeout(BODY_S):
                        body = await _whole(receive)
                except TimeoutError:
                    refused = 408, f"the body did not come within {BODY_S:g} s; send it in one piece"
                else:
                    refused = _too_long(b"%d" % len(body))
                    receive = _again(body, receive)
        if refused is None:
            await self._app(scope, receive, send)
            return
        if scope["type"] == "websocket":
            await receive()  # websocket.connect
        status, sentence = refused
        headers_out = CLOSE | ({"WWW-Authenticate": "Bearer"} if status == 401 else {})
        await refusal(status, (sentence,), headers_out)(scope, receive, send)

    def _session(self, scope: Scope, headers: Mapping[bytes, bytes]) -> Role | None:
        """Of somebody who has logged in: by the cookie; a stream, which any page could open with it, by a ticket."""
        if scope["type"] == "websocket":
            return self._sessions.tickets.back(_ticket(scope))
        return self._sessions.logins.role(self._sessions.of(headers))

    def _forged(self, scope: Scope, headers: Mapping[bytes, bytes], session: Role | None) -> tuple[int, str] | None:
        """Might a page of another site have made a browser ask this, or log in as somebody else?"""
        if scope["type"] == "websocket" or scope["method"] in ("GET", "HEAD"):
            return None
        asks = session is not None or (scope["path"] == LOGIN and b"origin" in headers)
        if not asks or self._door.from_own_page(headers):
            return None
        page = headers.get(b"origin", b"").decode("latin-1")
        return 403, (
            f"the request came with a cookie from the page {page[:60]!r}; allowed are pages of this API itself: open "
            "it at the address that it answers at, or name the proxy's in api.public_origin"
        )


def _ticket(scope: Scope) -> str:
    query: bytes = scope["query_string"]
    return parse_qs(query.decode("latin-1")).get("ticket", [""])[0]


def _versioned(send: Send) -> Send:
    """Every answer says the API's version."""

    async def saying(message: Message) -> None:
        if message["type"] in ("http.response.start", "websocket.accept", "websocket.http.response.start"):
            message = {**message, "headers": [*message.get("headers", ()), VERSION]}
        await send(message)

    return saying


def _too_new(version: bytes | None) -> tuple[int, str] | None:
    """A stop is never asked this."""
    if version is None or (version.isdigit() and int(version[:20]) <= API_VERSION):
        return None
    said = version[:20].decode("latin-1")
    return 400, f"this daemon speaks version {API_VERSION} of the API, the request version {said}: update the daemon"


def _role(scope: Scope) -> Role | None:
    """That a request takes; None: to log in takes none, nor does the dashboard, which holds nothing."""
    if scope["path"] == LOGIN and scope["type"] == "http" and scope["method"] in ("GET", "POST"):
        return None
    if scope["type"] == "http" and scope["method"] == "GET" and _is_page(scope["path"]):
        return None
    if scope["type"] == "http" and (scope["method"], scope["path"]) in SMALL:
        return SMALL[scope["method"], scope["path"]]
    if scope["type"] == "websocket" or scope["method"] in ("GET", "HEAD"):
        return Role.VIEW
    return Role.STOP if (scope["method"], scope["path"]) == ("POST", STOP) else Role.COMMAND


def _is_page(path: str) -> bool:
    return path == "/" or path.startswith(PAGES)


def _too_long(length: bytes) -> tuple[int, str] | None:
    if not length.isdigit() or int(length[:20]) <= BODY_MAX:
        return None
    return 413, f"the body has more than {BODY_MAX} bytes, which is all that is allowed; see /docs for what to send"


async def _whole(receive: Receive) -> bytes:
    """The body; of a longer one no more than it takes to know."""
    body = b""
    while len(body) <= BODY_MAX:
        message = await receive()
        body += message.get("body", b"")
        if not message.get("more_body", False):
            break
    return body


def _again(body: bytes, receive: Receive) -> Receive:
    """Receive a body that was read already, then whatever comes."""
    first: list[Message] = [{"type": "http.request", "body": body, "more_body": False}]

    async def next_message() -> Message:
        return first.pop() if first else await receive()

    return next_message


class BoundedHttp(H11Protocol):
    """uvicorn's HTTP, where a connection that does nothing is closed, or gives its place to one that comes."""

    _deaf: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Make room, then wait for a request, not for ever."""
        if len(self.connections) >= CONNECTIONS_MAX:
            idle = [one for one in self.connections if isinstance(one, BoundedHttp) and one.gives_way()]
            oldest = min(idle, key=lambda one: one.since, default=None)
            (transport if oldest is None else oldest.transport).abort()
        self.since = self.loop.time()
        super().connection_made(transport)
        self._patience = self.loop.call_later(QUIET_S, self._hang_up)

    def connection_lost(self, exc: Exception | None) -> None:
        """Nothing more to wait for."""
        self._patience.cancel()
        self._heard()
        super().connection_lost(exc)

    def pause_writing(self) -> None:
        """The client takes no more for now."""
        self._deaf = self.loop.call_later(DEAF_S, self.transport.abort)
        super().pause_writing()

    def resume_writing(self) -> None:
        """It has taken what there was."""
        self._heard()
        super().resume_writing()

    def _heard(self) -> None:
        if self._deaf is not None:
            self._deaf.cancel()
        self._deaf = None

    def handle_websocket_upgrade(self, event: Any) -> None:
        """From here on it is a stream."""
        self._patience.cancel()
        super().handle_websocket_upgrade(event)

    def on_response_complete(self) -> None:
        """Wait for the next request, whatever else comes."""
        self._patience.cancel()
        self.since = self.loop.time()
        self._patience = self.loop.call_later(QUIET_S, self._hang_up)
        super().on_response_complete()

    def gives_way(self) -> bool:
        """It waits for a request, or for the rest of one, and has not been closed yet."""
        waiting = self.cycle is None or self.cycle.response_complete or self.cycle.more_body
        return waiting and not self.transport.is_closing()

    def _hang_up(self) -> None:
        if self.cycle is None or self.cycle.response_complete:
            self.transport.abort()
