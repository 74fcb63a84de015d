"""Clients of a soak test: an operator by script, and others that misbehave, all at the same time."""

import contextlib
import json
import random
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Any, NamedTuple, Self

import httpx
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from softarm.common import http
from softarm.daemon.control.failsafe import TABLE
from softarm.schemas.flights import TEST_TARGETS

AFTERMATH_S = 6.0  # a fault may stop the robot until connections are restored
ASKED_S = 5.0  # a requested stop or disarm shows in the status within this time
REQUEST_S = 0.5  # a request shows in the status within this time
POLICIES = ("reach", "reach-wide", "reach-robust", "pid")

# Faults of the twin, their shortest and longest duration in s, and the events that they may cause.
MOCAP, REGULATOR, RAIL = ("mocap_", "rail_disagrees"), ("pressure_", "regulator_"), ("rail_", "remote_off")
FAULTS: dict[str, tuple[float, float, tuple[str, ...]]] = {
    "mocap_freeze": (0.05, 2.0, MOCAP),
    "mocap_stuck": (0.05, 2.0, MOCAP),
    "mocap_drop_body": (0.05, 2.0, MOCAP),
    "mocap_garbage": (0.0, 0.0, MOCAP),
    "serial_silence": (0.05, 2.0, REGULATOR),
    "serial_garbage": (0.05, 2.0, REGULATOR),
    "serial_unplug": (0.1, 3.0, REGULATOR),
    "rail_silence": (0.05, 2.0, RAIL),
    "rail_segment": (0.1, 2.0, RAIL),
    "rail_drop_connection": (0.0, 0.0, RAIL),
    "rail_fault": (0.0, 0.0, RAIL),
    "remote_low": (0.1, 2.0, RAIL),
}


class Unexpected(NamedTuple):
    """Unexpected event of a soak test."""

    time_s: float  # since the beginning
    what: str
    log: str | None  # the recording that holds it


class Act(NamedTuple):
    """Action of the script: a fault for the twin, or a request to the daemon."""

    kind: str  # fault, or a request's method
    path: str  # or the fault's JSON
    body: dict[str, Any] | None = None


class Script:
    """Script without I/O: the same seed and statuses give the same actions."""

    def __init__(self, seed: int, fault_every_s: float = 15.0, change_every_s: float = 45.0) -> None:
        """Set the mean times between faults, and between changes of policy or stops, in s."""
        self._chance = random.Random(seed)
        self._every = {"fault": fault_every_s, "change": change_every_s}
        self._due_s = {what: self._chance.expovariate(1 / every) for what, every in self._every.items()}
        self._broken: list[tuple[float, tuple[str, ...]]] = []  # until when, which events
        self._was: dict[str, Any] = {}
        self._waiting_until_s = 0.0
        self._asked_s = -AFTERMATH_S  # when the script itself last ended a flight
        self.looks = self.armed = 0
        self.counts: Counter[str] = Counter()
        self.unexpected: list[Unexpected] = []

    def acts(self, status: dict[str, Any], now_s: float) -> list[Act]:
        """Return the actions that follow a status."""
        self._look(status, now_s)
        self._was = status
        if found := [*self._break(now_s), *self._change(now_s)]:
            return found
        if now_s < self._waiting_until_s:
            return []
        if found := self._next(status):
            self._waiting_until_s = now_s + REQUEST_S
        return found

    def _next(self, status: dict[str, Any]) -> list[Act]:
        """Return the next request of an operator."""
        if status["mode"] == "stopped":  # refused while a cause is present, but it resets a drive in fault
            return [Act("POST", "/api/acknowledge")]
        if status["mode"] == "disarmed":  # a fault of a device is acknowledged too, when its cause is gone
            return [Act("POST", "/api/acknowledge" if status["arming_refusals"] else "/api/arm")]
        if status["mode"] == "armed" and status["goal"]["state"] != "running":
            goal = self._chance.choice(TEST_TARGETS)
            self.counts["goals"] += 1
            return [Act("POST", "/api/goal", {"kind": "reach", "y_m": goal.y_m, "z_m": goal.z_m})]
        return []

    def _look(self, status: dict[str, Any], now_s: float) -> None:
        """Count events since the last status."""
        was = self._was
        self.looks += 1
        self.armed += status["mode"] == "armed"
        if not was:
            return
        if status["goal"]["number"] == was["goal"]["number"] and was["goal"]["state"] == "running":
            self.counts["reached"] += status["goal"]["state"] == "reached"
        ended = was["mode"] in ("arming", "armed") and status["mode"] not in ("arming", "armed")
        again = status["last_stop"] != was["last_stop"]
        if not (ended or again) or now_s - self._asked_s < ASKED_S:
            return
        event = _event(status["last_stop"] or "")
        self.counts[f"stop: {event}"] += 1
        if not self._foreseen(event, now_s):
            log = status["recorder"]["log"]
            self.unexpected.append(Unexpected(now_s, f"stopped: {status['last_stop']}", log))

    def _foreseen(self, event: str, now_s: float) -> bool:
        broken = [names for until_s, names in self._broken if now_s <= until_s + AFTERMATH_S]
        return any(event.startswith(name) for names in broken for name in (*names, "arming_timeout"))

    def _break(self, now_s: float) -> list[Act]:
        if not self._is_due("fault", now_s):
            return []
        name = self._chance.choice(tuple(FAULTS))
        least_s, most_s, events = FAULTS[name]
        fault: dict[str, Any] = {"fault": name}
        if most_s:
            fault["seconds"] = round(self._chance.uniform(least_s, most_s), 3)
        if name == "mocap_drop_body":
            fault["body"] = self._chance.choice(("cart", "link1", "link5"))
        self.counts[f"fault: {name}"] += 1
        self._broken = [each for each in self._broken if each[0] + AFTERMATH_S >= now_s]
        self._broken.append((now_s + fault.get("seconds", 0.0), events))
        return [Act("fault", json.dumps(fault))]

    def _change(self, now_s: float) -> list[Act]:
        if not self._is_due("change", now_s):
            return []
        what = self._chance.choice(("stop", "disarm", "policy", "policy"))
        if what == "policy":
            self.counts["asked: policy"] += 1
            return [Act("PUT", "/api/policy", {"name": self._chance.choice(POLICIES)})]
        self.counts[f"asked: {what}"] += 1
        self._asked_s = now_s
        return [Act("POST", f"/api/{what}")]

    def _is_due(self, what: str, now_s: float) -> bool:
        due = now_s >= self._due_s[what]
        if due:
            self._due_s[what] = now_s + self._chance.expovariate(1 / self._every[what])
        return due


def _event(sentence: str) -> str:
    """Return the event of the failsafe table that a stop's message begins with, or the message itself."""
    fitting = [name for name, rule in TABLE.items() if sentence.startswith(rule.meaning)]
    return max(fitting, key=lambda name: len(TABLE[name].meaning), default=sentence)


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
        with http.client(self._url, timeout_s=ANSWER_S) as client:
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
