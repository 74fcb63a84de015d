"""The one slot through which people reach the control loop."""

import threading
from itertools import count
from typing import NamedTuple

from softarm.daemon.control.records import Request, RequestKind
from softarm.policies.runner import PolicyRunner
from softarm.schemas.goals import Goal

ANSWER_S = 0.5  # the control loop answers within a tick or two
STOP_WAITS = "use the emergency-stop button; the request stays in the inbox and is answered first"


class Post(NamedTuple):
    """A request and, for a change of policy, the loaded and warmed-up runner."""

    request: Request
    runner: PolicyRunner | None = None


class InboxFull(Exception):
    """The control loop is not taking requests."""


class Inbox:
    """One slot that holds the requests since the last tick. A stop is always taken and always comes first."""

    def __init__(self, capacity: int = 16) -> None:
        self._slot: tuple[Post, ...] = ()
        self._lock = threading.Lock()  # held for one tuple assignment, never across I/O
        self._numbers = count(1)
        self._capacity = capacity

    def post(
        self,
        kind: RequestKind,
        *,
        goal: Goal | None = None,
        policy: str | None = None,
        runner: PolicyRunner | None = None,
        who: str = "",
    ) -> int:
        """Leave a request; returns its number, under which `Outputs.results` will answer it.

        who: asks, as the history of events tells it. A stop that still waits there is every later one's, too: a
        thousand of them are one, the first one's.
        Raises InboxFull when the loop has not emptied the slot for `capacity` requests (never for a stop).
        """
        with self._lock:
            if kind == "stop" and self._slot and self._slot[0].request.kind == "stop":
                return self._slot[0].request.number
            post = Post(Request(next(self._numbers), kind, goal, policy, who), runner)
            if kind == "stop":
                self._slot = (post, *self._slot)
            elif len(self._slot) >= self._capacity:
                raise InboxFull(f"the control loop has not taken the last {self._capacity} requests; see /api/health")
            else:
                self._slot = (*self._slot, post)
            return post.request.number

    def take(self) -> tuple[Post, ...]:
        """Empty the slot. Called once a tick."""
        if not self._slot:  # reading a reference is atomic: an idle tick takes no lock
            return ()
        with self._lock:
            taken, self._slot = self._slot, ()
        return taken
