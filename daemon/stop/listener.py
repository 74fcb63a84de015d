"""The stop's own way: HTTP on a port of its own, served by a thread of its own that does nothing else.

It answers `POST /api/stop` to whoever may ask the REST API, with the standard library alone: what clients do to the API
cannot hold it up. Of the daemon it shares the inbox and the snapshots, of the API it looks up who has logged in.
"""

import contextlib
import json
import logging
import selectors
import socket
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from http import HTTPStatus

from softarm.daemon.api.auth import Door, Role
from softarm.daemon.api.login import Sessions
from softarm.daemon.api.sockets import listen
from softarm.daemon.control.inbox import ANSWER_S, STOP_WAITS, Inbox
from softarm.daemon.control.records import Outputs
from softarm.daemon.shell import realtime
from softarm.schemas.config import Api
from softarm.schemas.rest import API_HEADER, API_VERSION

log = logging.getLogger(__name__)

CLIENTS_MAX = 64
REQUEST_MAX = 8192  # bytes
PATIENCE_S = 2.0  # for a request, and for a client to take its answer
POLL_S = 0.002  # between looks for the tick that stops
PREFLIGHT = (
    "Access-Control-Allow-Methods: POST",
    "Access-Control-Allow-Headers: Authorization, Content-Type",
    "Access-Control-Max-Age: 600",
)
CREDENTIALS = ("Access-Control-Allow-Credentials: true", "Vary: Origin")  # its cookie, too
PRIORITY = 2  # of SCHED_FIFO: above the daemon's other guests, below the control loop


@dataclass(eq=False, slots=True)
class _Client:
    socket: socket.socket
    until_s: float  # is closed then
    heard: bytearray = field(default_factory=bytearray)
    asked: tuple[int, int] | None = None  # the stop's number, and when it lay in the inbox; None before and after
    answered: bool = False
    page: str | None = None  # of the REST API, that asks from a browser
    address: str | None = None
    who: str = ""


class StopListener:
    """Listens until it is stopped."""

    def __init__(
        self,
        config: Api,
        inbox: Inbox,
        snapshot: Callable[[], Outputs | None],
        realtime_priority: int = 0,
        pages_at: Callable[[], int] | None = None,
        sessions: Sessions | None = None,
    ) -> None:
        """Raises AuthError like the REST API: the same may ask.

        realtime_priority: the control loop's. pages_at: the REST API's port, whose pages may ask, too; default
        `api.port`. sessions: who has logged in there; from those pages a cookie is enough.
        """
        self._config, self._inbox, self._snapshot = config, inbox, snapshot
        self._pages_at = pages_at or (lambda: config.port)
        self._door, self._sessions = Door(config), sessions
        self._priority = min(PRIORITY, realtime_priority)
        self._clients: list[_Client] = []  # oldest first
        self._thread: threading.Thread | None = None

    def start(self) -> int:
        """Bind, serve, return the port (which the system chooses for port 0).

        Raises ApiError when the address cannot be bound.
        """
        listener = listen(self._config.host, self._config.stops_at, "api.stop_port", CLIENTS_MAX)
        listener.setblocking(False)
        self._selector = selectors.DefaultSelector()
        self._selector.register(listener, selectors.EVENT_READ, lambda: self._accept(listener))
        self._bell, self._ring = socket.socketpair()
        self._selector.register(self._bell, selectors.EVENT_READ)
        self._thread = threading.Thread(target=self._serve, args=(listener,), name="stop", daemon=True)
        self._thread.start()
        return int(listener.getsockname()[1])

    def stop(self) -> None:
        """Close every connection."""
        if self._thread is None:
            return
        self._ring.send(b"!")
        self._thread.join(timeout=1.0)
        self._thread = None
        for end in (self._bell, self._ring, self._selector):
            end.close()

    def _serve(self, listener: socket.socket) -> None:
        realtime.outrank_guests(self._priority)
        with listener:
            while True:
                for key, _ in self._selector.select(self._timeout_s()):
                    if key.fileobj is self._bell:
                        for client in tuple(self._clients):
                            self._close(client)
                        return
                    key.data()
                self._look_after_all()

    def _timeout_s(self) -> float | None:
        if any(client.asked is not None for client in self._clients):
            return POLL_S
        return PATIENCE_S / 4 if self._clients else None

    def _accept(self, listener: socket.socket) -> None:
        try:
            connection, address = listener.accept()
        except OSError:  # it left again; or no descriptor is free, and then the oldest client's is taken
            if self._clients:
                self._close(self._clients[0])
            time.sleep(POLL_S)
            return
        if len(self._clients) >= CLIENTS_MAX:
            self._close(next((client for client in self._clients if client.asked is None), self._clients[0]))
        connection.setblocking(False)
        client = _Client(connection, time.monotonic() + PATIENCE_S, address=str(address[0]))
        self._clients.append(client)
        self._selector.register(connection, selectors.EVENT_READ, lambda: self._hear(client))
        self._hear(client)  # the request often came along

    def _close(self, client: _Client) -> None:
        self._clients.remove(client)
        self._selector.unregister(client.socket)
        client.socket.close()

    def _hear(self, client: _Client) -> None:
        if client not in self._clients:
            return  # it gave way a moment ago
        try:
            self._take(client, client.socket.recv(REQUEST_MAX))
        except BlockingIOError:
            return
        except OSError:
            self._close(client)
        except Exception:  # whatever one client sends, the next is heard
            log.exception("a client of the stop's own way was hung up on")
            self._close(client)

    def _take(self, client: _Client, part: bytes) -> None:
        if not part:
            self._close(client)
            return
        if client.answered or client.asked is not None:
            return  # a body: nothing in it can matter
        client.heard += part
        if b"\r\n\r\n" in client.heard:
            self._judge(client)
        elif len(client.heard) > REQUEST_MAX:
            self._refuse(client, 431, f"the request's header has more than {REQUEST_MAX} bytes")

    def _judge(self, client: _Client) -> None:
        """Take the stop, if it is one and the client may ask for it."""
        first, *lines = bytes(client.heard).partition(b"\r\n\r\n")[0].split(b"\r\n")
        headers = {name.strip().lower(): value.strip() for name, _, value in (line.partition(b":") for line in lines)}
        asked = first.split(b" ")[:2]
        client.page = self._door.own_page(headers, self._pages_at())
        session = self._session(headers) if client.page is not None else None
        client.who = self._door.who("the stop's own way", headers, client.address, session)
        if client.page is not None and asked == [b"OPTIONS", b"/api/stop"]:
            self._answer(client, 204, None, *PREFLIGHT)  # a browser's question, before it sends a token to another port
            return
        refused = self._door.refusal(headers, Role.STOP, client.page, session)
        if refused is not None:
            self._refuse(client, *refused)
        elif asked != [b"POST", b"/api/stop"]:
            self._refuse(client, 404, f"here is POST /api/stop alone; all else is at port {self._config.port}")
        else:
            client.asked = self._inbox.post("stop", who=client.who), time.monotonic_ns()
            client.until_s = time.monotonic() + ANSWER_S

    def _session(self, headers: Mapping[bytes, bytes]) -> Role | None:
        """Of somebody who has logged in at the API. A browser sends the cookie along for whatever page: see `page`."""
        if self._sessions is None or b"authorization" in headers:
            return None
        return self._sessions.logins.role(self._sessions.of(headers))

    def _look_after_all(self) -> None:
        """Answer those whose stop was carried out, end what has lasted too long."""
        now_s, snapshot = time.monotonic(), self._snapshot()
        for client in tuple(self._clients):
            if client.asked is not None and snapshot is not None and snapshot.has_stopped(*client.asked):
                done = {"stopped": True, "mode": snapshot.mode, "estop": snapshot.estop, "tick": snapshot.tick}
                self._answer(client, 200, done)
            elif now_s < client.until_s:
                continue
            elif client.asked is not None:
                self._refuse(client, 503, f"stop: the control loop did not answer within {ANSWER_S:g} s", STOP_WAITS)
            else:
                self._close(client)

    def _refuse(self, client: _Client, status: int, *reasons: str) -> None:
        self._answer(client, status, {"detail": "; ".join(reasons), "reasons": reasons})

    def _answer(self, client: _Client, status: int, body: object, *headers: str) -> None:
        """Say it; the client closes then, so that what it may still be sending does not make it lose the answer."""
        data = b"" if body is None else json.dumps(body).encode()
        if data:
            headers = ("Content-Type: application/json", f"Content-Length: {len(data)}", *headers)
        if client.page is not None:
            headers = (f"Access-Control-Allow-Origin: {client.page}", *CREDENTIALS, *headers)
        first = (f"HTTP/1.1 {status} {HTTPStatus(status).phrase}", f"{API_HEADER}: {API_VERSION}")
        head = (*first, *headers, "Connection: close")
        with contextlib.suppress(OSError):
            client.socket.sendall("\r\n".join((*head, "", "")).encode() + data)
            client.socket.shutdown(socket.SHUT_WR)
        client.asked, client.answered = None, True
        client.until_s = time.monotonic() + PATIENCE_S
