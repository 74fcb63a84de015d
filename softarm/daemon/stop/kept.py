"""Inbox whose stops outlive a control loop that hangs."""

import threading
import time
from collections.abc import Callable
from typing import Any

from softarm.daemon.control.inbox import ANSWER_S, Inbox
from softarm.daemon.control.records import Outputs, RequestKind

HUNG = "an emergency stop was requested while the control loop did not answer"


class KeptInbox(Inbox):
    """Inbox that keeps the stop of any sender for the next daemon if no tick begins within `ANSWER_S`."""

    def __init__(self, snapshot: Callable[[], Outputs | None], keep: Callable[[str], object]) -> None:
        """Create an inbox whose thread is not started yet.

        Args:
            snapshot: Returns the outputs of the newest tick.
            keep: Stores the reason of a stop for the next daemon.
        """
        super().__init__()
        self._snapshot, self._keep = snapshot, keep
        self._asked_ns = 0
        self._asked, self._over = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._watch, name="kept stop", daemon=True)

    def start(self) -> None:
        """Start the thread that looks for ticks."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread that looks for ticks."""
        self._over.set()
        self._asked.set()

    def post(self, kind: RequestKind, **content: Any) -> int:
        """Add a request as `Inbox.post` does."""
        number = super().post(kind, **content)
        if kind == "stop":
            self._asked_ns = time.monotonic_ns()
            self._asked.set()
        return number

    def _watch(self) -> None:
        while self._asked.wait():
            self._asked.clear()
            asked_ns = self._asked_ns
            if self._over.wait(ANSWER_S):
                return
            newest = self._snapshot()
            if newest is None or newest.t_ns < asked_ns:
                self._keep(HUNG)
