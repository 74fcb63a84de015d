"""Dedicated stop port: `POST /api/stop` over HTTP, served by a thread that does nothing else.

State: the list of open clients (at most 64, oldest first), each with its received bytes, its pending stop request and a
deadline. With the daemon it shares the inbox and the snapshots; from the API it reads the log-in sessions.

HTTP is written by hand on a selector because a web framework shares its event loop between clients: with 1100 idle
clients the slowest answer of the API took 1078 ms and one stop stayed unanswered, while this port answered all within
36 ms, including up to 33 ms until the next tick (docs/evidence/results.md, "Stop under attack").
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

from softarm.common import realtime
from softarm.daemon.access.auth import AccessControl, Role, Sessions
from softarm.daemon.access.sockets import listen
from softarm.daemon.control.inbox import ANSWER_S, Inbox, unanswered
from softarm.daemon.control.records import Outputs
from softarm.schemas.config import Api
from softarm.schemas.rest import API_HEADER, API_VERSION

log = logging.getLogger(__name__)

CLIENTS_MAX = 64
REQUEST_MAX = 8192  # bytes
CLIENT_TIMEOUT_S = 2.0  # to send a request, and to receive its answer
POLL_S = 0.002  # between checks for the tick that stops
PREFLIGHT = (
    "Access-Control-Allow-Methods: POST",
    "Access-Control-Allow-Headers: Authorization, Content-Type",
    "Access-Control-Max-Age: 600",
)
CREDENTIALS = ("Access-Control-Allow-Credentials: true", "Vary: Origin")  # allows the session cookie
PRIORITY = 2  # of SCHED_FIFO: above the daemon's other threads, below the control loop


@dataclass(eq=False, slots=True)
class _Client:
    socket: socket.socket
    until_s: float  # deadline, then closed
    received: bytearray = field(default_factory=bytearray)
    asked: tuple[int, int] | None = None  # number and time of the pending stop request
    answered: bool = False
    page: str | None = None  # origin, if a page of the REST API sends the request
    address: str | None = None
    who: str = ""


class StopListener:
    """HTTP listener of the dedicated stop port."""

    def __init__(
        self,
        config: Api,
        inbox: Inbox,
        snapshot: Callable[[], Outputs | None],
        realtime_priority: int = 0,
        pages_at: Callable[[], int] | None = None,
        sessions: Sessions | None = None,
    ) -> None:
        """Create a listener that is not bound yet.

        Args:
            config: Host, ports and tokens; the same clients may stop as over the REST API.
            inbox: Takes the stop requests.
            snapshot: Returns the outputs of the newest tick.
            realtime_priority: Priority of the control loop.
            pages_at: Returns the REST API's port, whose pages may stop as well; `api.port` by default.
            sessions: Log-in sessions of the REST API; on its pages a session cookie replaces the token.

        Raises:
            AuthError: The tokens cannot be used.
        """
        self._config, self._inbox, self._snapshot = config, inbox, snapshot
        self._pages_at = pages_at or (lambda: config.port)
        self._access, self._sessions = AccessControl(config), sessions
        self._priority = min(PRIORITY, realtime_priority)
        self._clients: list[_Client] = []  # oldest first
        self._thread: threading.Thread | None = None

    def start(self) -> int:
        """Bind, start the thread and return the port, which the system chooses for port 0, or raise ApiError."""
        listener = listen(self._config.host, self._config.stops_at, "api.stop_port", CLIENTS_MAX)
        listener.setblocking(False)
        self._selector = selectors.DefaultSelector()
        self._selector.register(listener, selectors.EVENT_READ, lambda: self._accept(listener))
        self._wakeup, self._wake = socket.socketpair()
        self._selector.register(self._wakeup, selectors.EVENT_READ)
        self._thread = threading.Thread(target=self._serve, args=(listener,), name="stop", daemon=True)
        self._thread.start()
        return int(listener.getsockname()[1])

    def stop(self) -> None:
        """Close every connection and end the thread."""
        if self._thread is None:
            return
        self._wake.send(b"!")
        self._thread.join(timeout=1.0)
        self._thread = None
        for end in (self._wakeup, self._wake, self._selector):
            end.close()

    def _serve(self, listener: socket.socket) -> None:
        realtime.outrank_own_threads(self._priority)
        with listener:
            while True:
                for key, _ in self._selector.select(self._timeout_s()):
                    if key.fileobj is self._wakeup:
                        for client in tuple(self._clients):
                            self._close(client)
                        return
                    key.data()
                self._update_clients()

    def _timeout_s(self) -> float | None:
        if any(client.asked is not None for client in self._clients):
            return POLL_S
        return CLIENT_TIMEOUT_S / 4 if self._clients else None

    def _accept(self, listener: socket.socket) -> None:
        try:
            connection, address = listener.accept()
        except OSError:  # the client has left, or no descriptor is free: then the oldest client gives way
            if self._clients:
                self._close(self._clients[0])
            time.sleep(POLL_S)
            return
        if len(self._clients) >= CLIENTS_MAX:
            self._close(next((client for client in self._clients if client.asked is None), self._clients[0]))
        connection.setblocking(False)
        client = _Client(connection, time.monotonic() + CLIENT_TIMEOUT_S, address=str(address[0]))
        self._clients.append(client)
        self._selector.register(connection, selectors.EVENT_READ, lambda: self._receive(client))
        self._receive(client)  # the request has often arrived already

    def _close(self, client: _Client) -> None:
        self._clients.remove(client)
        self._selector.unregister(client.socket)
        client.socket.close()

    def _receive(self, client: _Client) -> None:
        if client not in self._clients:
            return  # closed to make room for another client
        try:
            self._process(client, client.socket.recv(REQUEST_MAX))
        except BlockingIOError:
            return
        except OSError:
            self._close(client)
        except Exception:  # no client may end the thread
            log.exception("the stop port closed a connection after an error")
            self._close(client)

    def _process(self, client: _Client, part: bytes) -> None:
        if not part:
            self._close(client)
            return
        if client.answered or client.asked is not None:
            return  # a body, which is ignored
        client.received += part
        if b"\r\n\r\n" in client.received:
            self._handle(client)
        elif len(client.received) > REQUEST_MAX:
            self._refuse(client, 431, f"the request's header is longer than {REQUEST_MAX} bytes")

    def _handle(self, client: _Client) -> None:
        """Request a stop, if the client asks for one and is authorised."""
        first, *lines = bytes(client.received).partition(b"\r\n\r\n")[0].split(b"\r\n")
        headers = {name.strip().lower(): value.strip() for name, _, value in (line.partition(b":") for line in lines)}
        asked = first.split(b" ")[:2]
        client.page = self._access.own_page(headers, self._pages_at())
        session = self._session(headers) if client.page is not None else None
        client.who = self._access.who("the dedicated stop port", headers, client.address, session)
        if client.page is not None and asked == [b"OPTIONS", b"/api/stop"]:
            self._answer(client, 204, None, *PREFLIGHT)  # a browser asks before it sends a token to another port
            return
        refused = self._access.refusal(headers, Role.STOP, client.page, session)
        if refused is not None:
            self._refuse(client, *refused)
        elif asked != [b"POST", b"/api/stop"]:
            self._refuse(client, 404, f"this port accepts POST /api/stop only; the API is at port {self._config.port}")
        else:
            client.asked = self._inbox.post("stop", who=client.who), time.monotonic_ns()
            client.until_s = time.monotonic() + ANSWER_S

    def _session(self, headers: Mapping[bytes, bytes]) -> Role | None:
        """Return the role of the client's log-in session. Valid for `page` only: a browser sends cookies for any."""
        if self._sessions is None or b"authorization" in headers:
            return None
        return self._sessions.logins.role(self._sessions.of(headers))

    def _update_clients(self) -> None:
        """Answer clients whose stop was carried out, and close those past their deadline."""
        now_s, snapshot = time.monotonic(), self._snapshot()
        for client in tuple(self._clients):
            if client.asked is not None and snapshot is not None and snapshot.has_stopped(*client.asked):
                done = {"stopped": True, "mode": snapshot.mode, "estop": snapshot.estop, "tick": snapshot.tick}
                self._answer(client, 200, done)
            elif now_s < client.until_s:
                continue
            elif client.asked is not None:
                self._refuse(client, 503, *unanswered("stop"))
            else:
                self._close(client)

    def _refuse(self, client: _Client, status: int, *reasons: str) -> None:
        self._answer(client, status, {"detail": "; ".join(reasons), "reasons": reasons})

    def _answer(self, client: _Client, status: int, body: object, *headers: str) -> None:
        """Send an answer and leave closing to the client: closing during its transmission could discard the answer."""
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
        client.until_s = time.monotonic() + CLIENT_TIMEOUT_S
