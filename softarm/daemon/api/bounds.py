"""Access check and limits per client: body size, time, number of connections."""

import asyncio
from collections.abc import Mapping
from typing import Any
from urllib.parse import parse_qs

from h11 import LocalProtocolError
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from softarm.daemon.access.auth import AccessControl, Role, Sessions
from softarm.daemon.api.refusals import refusal
from softarm.schemas.rest import API_HEADER, API_VERSION

BODY_MAX = 4096  # bytes; the longest valid body, a goal, has about a hundred
BODY_S = 5.0
HEADER_MAX = 16_384  # bytes
UNREAD_S = 30.0  # a client that reads nothing for longer is disconnected
QUIET_S = 5.0  # time for a complete request after the connection opens or the last answer
CONNECTIONS_MAX = 128
STREAMS_MAX = 32
MESSAGE_MAX = 1024  # bytes of a WebSocket client's message, which is ignored
STOP = "/api/stop"  # carried out whatever its body and version
VERSION = (API_HEADER.encode(), b"%d" % API_VERSION)
# Keys in the ASGI scope: the client as the event history names it, and the role of a logged-in browser.
WHO, SESSION = "softarm.who", "softarm.session"
LOGIN, PAGES = "/api/login", "/dashboard/"
# Changes that need less than the command role: a stop, and what does not affect the robot.
ROLES = {("POST", STOP): Role.STOP, ("POST", "/api/logout"): Role.STOP, ("POST", "/api/ticket"): Role.VIEW}
CLOSE = {"Connection": "close"}  # the rest of a refused body is not read


class Guard:
    """ASGI middleware that checks access and limits every request, WebSockets included."""

    def __init__(self, app: ASGIApp, access: AccessControl, sessions: Sessions) -> None:
        self._app, self._access, self._sessions = app, access, sessions

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on with its complete body, or answer with a refusal."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = dict(scope["headers"])
        session = None if b"authorization" in headers else self._session(scope, headers)
        scope[SESSION] = session
        from_page = session is not None or self._access.from_own_page(headers)
        source, address = "the dashboard" if from_page else "the API", (scope.get("client") or (None,))[0]
        scope[WHO] = self._access.who(source, headers, address, session)
        send = _versioned(send)
        refused = self._access.refusal(headers, _role(scope), session=session) or self._forged(scope, headers, session)
        if refused is None and scope["type"] == "http" and scope["path"] != STOP:
            refused = _too_new(headers.get(VERSION[0])) or _too_long(headers.get(b"content-length", b""))
            if refused is None:
                try:
                    async with asyncio.timeout(BODY_S):
                        body = await _whole(receive)
                except TimeoutError:
                    refused = 408, f"the body did not arrive within {BODY_S:g} s; send it in one piece"
                else:
                    if body is None:
                        return
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
        """Return the role of a logged-in browser: by cookie, or by ticket for a stream, which any page could open."""
        if scope["type"] == "websocket":
            query: bytes = scope["query_string"]
            return self._sessions.tickets.revoke(parse_qs(query.decode("latin-1")).get("ticket", [""])[0])
        return self._sessions.logins.role(self._sessions.of(headers))

    def _forged(self, scope: Scope, headers: Mapping[bytes, bytes], session: Role | None) -> tuple[int, str] | None:
        """Return a refusal if a page of another site may have sent the request with the browser's cookie."""
        if scope["type"] == "websocket" or scope["method"] in ("GET", "HEAD"):
            return None
        asks = session is not None or (scope["path"] == LOGIN and b"origin" in headers)
        if not asks or self._access.from_own_page(headers):
            return None
        page = headers.get(b"origin", b"").decode("latin-1")
        return 403, (
            f"a page of {page[:60]!r} sent the request with a cookie; allowed are pages of this API: open the "
            "dashboard at the daemon's own address, or set api.public_origin to the proxy's"
        )


def _versioned(send: Send) -> Send:
    """Add the API's version to every answer."""

    async def send_versioned(message: Message) -> None:
        if message["type"] in ("http.response.start", "websocket.accept", "websocket.http.response.start"):
            message = {**message, "headers": [*message.get("headers", ()), VERSION]}
        await send(message)

    return send_versioned


def _too_new(version: bytes | None) -> tuple[int, str] | None:
    """Refuse a newer API version, except for a stop."""
    if version is None or (version.isdigit() and int(version[:20]) <= API_VERSION):
        return None
    requested = version[:20].decode("latin-1")
    reason = f"the request has version {requested} of the API, this daemon supports {API_VERSION}: update the daemon"
    return 400, reason


def _role(scope: Scope) -> Role | None:
    """Return the role that a request requires; None for the log-in and the dashboard's files."""
    if scope["type"] == "websocket":
        return Role.VIEW
    method, path = scope["method"], scope["path"]
    if path == LOGIN and method in ("GET", "POST"):
        return None
    if method == "GET" and (path == "/" or path.startswith(PAGES)):
        return None
    return ROLES.get((method, path), Role.VIEW if method in ("GET", "HEAD") else Role.COMMAND)


def _too_long(length: bytes) -> tuple[int, str] | None:
    if not length.isdigit() or int(length[:20]) <= BODY_MAX:
        return None
    return 413, f"the body has more than {BODY_MAX} bytes, the limit; see /docs for the bodies"


async def _whole(receive: Receive) -> bytes | None:
    """Read the body, at most one chunk beyond the limit; return None if the client left before its end."""
    body = b""
    while len(body) <= BODY_MAX:
        message = await receive()
        if message["type"] == "http.disconnect":
            return None
        body += message.get("body", b"")
        if not message.get("more_body", False):
            break
    return body


def _again(body: bytes, receive: Receive) -> Receive:
    """Return a receiver that delivers the body again, then what follows."""
    first: list[Message] = [{"type": "http.request", "body": body, "more_body": False}]

    async def next_message() -> Message:
        return first.pop() if first else await receive()

    return next_message


class BoundedHttp(H11Protocol):
    """uvicorn's HTTP protocol that closes idle connections, at once if a new connection needs the place."""

    _unread: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Make room for the connection and start the time limit for its request."""
        if len(self.connections) >= CONNECTIONS_MAX:
            idle = [each for each in self.connections if isinstance(each, BoundedHttp) and each.is_idle()]
            oldest = min(idle, key=lambda each: each.since, default=None)
            (transport if oldest is None else oldest.transport).abort()
        self.since = self.loop.time()
        super().connection_made(transport)
        self._time_limit = self.loop.call_later(QUIET_S, self._hang_up)

    def connection_lost(self, exc: Exception | None) -> None:
        """Cancel the time limits of a closed connection."""
        self._time_limit.cancel()
        self._reset_unread()
        super().connection_lost(exc)

    def pause_writing(self) -> None:
        """Start the time limit for a client that reads nothing."""
        self._unread = self.loop.call_later(UNREAD_S, self.transport.abort)
        super().pause_writing()

    def resume_writing(self) -> None:
        """Cancel the time limit of a client that reads again."""
        self._reset_unread()
        super().resume_writing()

    def _reset_unread(self) -> None:
        if self._unread is not None:
            self._unread.cancel()
        self._unread = None

    def handle_websocket_upgrade(self, event: Any) -> None:
        """Remove the time limit from a connection that becomes a stream."""
        self._time_limit.cancel()
        super().handle_websocket_upgrade(event)

    def send_400_response(self, msg: str) -> None:
        """Answer an invalid request, or hang up if it has an answer already or must have one without a body."""
        try:
            super().send_400_response(msg)
        except LocalProtocolError:
            self.transport.close()

    def on_response_complete(self) -> None:
        """Start the time limit for the next request."""
        self._time_limit.cancel()
        self.since = self.loop.time()
        self._time_limit = self.loop.call_later(QUIET_S, self._hang_up)
        super().on_response_complete()

    def is_idle(self) -> bool:
        """Return whether the connection waits for a request or its rest and is still open."""
        waiting = self.cycle is None or self.cycle.response_complete or self.cycle.more_body
        return waiting and not self.transport.is_closing()

    def _hang_up(self) -> None:
        if self.cycle is None or self.cycle.response_complete:
            self.transport.abort()
