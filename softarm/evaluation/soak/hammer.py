"""Misbehaving clients of the API, all at the same time."""

import contextlib
import random
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Self

import httpx
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

IDLE_CLIENTS = 20
PAUSE_S = (0.02, 0.2)  # range between two requests of one client
ANSWER_S = 10.0
# Server errors, which no request may receive, except those of a refusal.
NEVER = range(500, 600)
REFUSALS = (503, 504)

_PATHS = ("/api/status", "/api/health", "/api/goal", "/api/policies", "/api/logs", "/openapi.json", "/nothing")
_BODIES = (
    b'{"kind": "reach", "y_m": 9, "z_m": 9}',
    b'{"kind": "fly"}',
    b"[" * 4000,
    b"x" * 9000,
    b'{"kind": "hold", ' + b", ".join(b'"k%d": 1' % i for i in range(300)) + b"}",
)

Action = Callable[[random.Random], None]


class Hammer:
    """Context in which clients send requests, stream, send half a request or stay silent; none moves the robot.

    `answers` counts statuses; `wrong` counts forbidden answers by request.
    """

    def __init__(self, url: str, stop_port: int, seed: int) -> None:
        self._url, self._stop_port = url, stop_port
        self._stopping = threading.Event()
        # Each action draws from its own generator, so that one does not influence the others.
        actions: tuple[Action, ...] = (self._ask, self._ask, self._stream, self._idle)
        self._threads = [
            threading.Thread(target=self._work, args=(action, random.Random(seed + n)), daemon=True)
            for n, action in enumerate(actions)
        ]
        self.answers: Counter[int] = Counter()
        self.wrong: Counter[str] = Counter()

    def __enter__(self) -> Self:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping.set()
        for thread in self._threads:
            thread.join(ANSWER_S)

    def _work(self, action: Action, chance: random.Random) -> None:
        while not self._stopping.wait(chance.uniform(*PAUSE_S)):
            try:
                action(chance)
            except (httpx.TransportError, OSError, WebSocketException) as error:
                # The API may close a connection, but not leave a request without an answer.
                if "Timeout" in type(error).__name__ and not self._stopping.is_set():
                    self.wrong[f"no answer within {ANSWER_S:g} s ({type(error).__name__})"] += 1

    def _ask(self, chance: random.Random) -> None:
        with httpx.Client(base_url=self._url, timeout=ANSWER_S) as client:
            for _ in range(20):
                if self._stopping.wait(chance.uniform(*PAUSE_S)):
                    return
                if chance.random() < 0.7:
                    asked = "GET", chance.choice(_PATHS)
                    answer = client.get(asked[1])
                else:
                    asked = "POST", "/api/goal"
                    answer = client.post(asked[1], content=chance.choice(_BODIES))
                self.answers[answer.status_code] += 1
                if answer.status_code in NEVER and answer.status_code not in REFUSALS:
                    self.wrong[f"{' '.join(asked)}: {answer.status_code} {answer.text[:100]}"] += 1

    def _stream(self, chance: random.Random) -> None:
        address = f"{self._url.replace('http', 'ws', 1)}/api/stream?hz={chance.choice((5, 30))}"
        with connect(address, open_timeout=ANSWER_S, close_timeout=1.0, compression=None) as stream:
            until_s = time.monotonic() + chance.uniform(0.1, 5.0)
            while time.monotonic() < until_s and not self._stopping.is_set():
                with contextlib.suppress(TimeoutError):
                    stream.recv(timeout=0.5)

    def _idle(self, chance: random.Random) -> None:
        """Open connections that send nothing or half a request to the API and the dedicated stop port."""
        api_port = int(self._url.rpartition(":")[2])
        with contextlib.ExitStack() as opened:
            for _ in range(IDLE_CLIENTS):
                port = chance.choice((api_port, self._stop_port))
                one = opened.enter_context(socket.create_connection(("127.0.0.1", port), timeout=ANSWER_S))
                one.sendall(chance.choice((b"", b"GET /api/status HT", b"POST /api/goal HTTP/1.1\r\nHost: x\r\n")))
            self._stopping.wait(chance.uniform(0.5, 3.0))
