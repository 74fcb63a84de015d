"""Inbox of requests to the control loop."""

import threading
from itertools import count
from typing import NamedTuple

from softarm.daemon.control.records import Request, RequestKind
from softarm.policies.runner import PolicyRunner
from softarm.schemas.goals import Goal

ANSWER_S = 0.5  # longest wait for an answer; the control loop needs a tick or two


class Post(NamedTuple):
    """A request and, for a change of policy, the loaded policy."""

    request: Request
    runner: PolicyRunner | None = None


class InboxFull(Exception):
    """The control loop does not take requests."""


def unanswered(kind: RequestKind) -> tuple[str, str]:
    """Return problem and advice for a request that the control loop has not answered within `ANSWER_S`."""
    advice = "see `softarm status`; the request is still in the inbox"
    if kind == "stop":
        advice = "use the emergency-stop button; the request stays in the inbox and will be answered first"
    return f"{kind}: the control loop did not answer within {ANSWER_S:g} s", advice


class Inbox:
    """Requests since the last tick. A stop is always accepted and always first."""

    def __init__(self, capacity: int = 16) -> None:
        self._slot: tuple[Post, ...] = ()
        self._lock = threading.Lock()  # held for one assignment, never across I/O
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
        """Add a request and return its number, under which `Outputs.results` will hold the answer.

        A stop that still waits also serves later stops: all of them get its number. `who` is the sender for the event
        history, `runner` the loaded policy of a policy request.

        Raises:
            InboxFull: The loop has not taken the last `capacity` requests (never for a stop).
        """
        with self._lock:
            if kind == "stop" and self._slot and self._slot[0].request.kind == "stop":
                return self._slot[0].request.number
            post = Post(Request(next(self._numbers), kind, goal, policy, who), runner)
            if kind == "stop":
                self._slot = (post, *self._slot)
            elif len(self._slot) >= self._capacity:
                problem = f"the control loop has not taken the last {self._capacity} requests"
                raise InboxFull(f"{problem}: run `softarm status`")
            else:
                self._slot = (*self._slot, post)
            return post.request.number

    def take(self) -> tuple[Post, ...]:
        """Return and remove all requests. Called once a tick."""
        if not self._slot:  # reading a reference is atomic: an idle tick takes no lock
            return ()
        with self._lock:
            taken, self._slot = self._slot, ()
        return taken
