"""Frames to the daemon over Zenoh, from the moment that it listens; until then they are counted and dropped."""

import contextlib
import threading
from collections.abc import Callable

import zenoh

from softarm.drivers.mocap import payload
from softarm.drivers.mocap.zenoh_session import ClientThread
from softarm.schemas.bridge import Listener

LOOK_S = 0.5  # for who listens


class Publisher:
    """Nothing here waits for the daemon: it may come later, and go and come again."""

    def __init__(self, daemon: Listener, tell: Callable[[str], None]) -> None:
        self.sent = self.unheard = 0
        self.is_heard = False
        self._daemon, self._tell = daemon, tell
        self._client = ClientThread(daemon.endpoint, "publisher", self._use)
        self._publisher: zenoh.Publisher | None = None

    def open(self) -> None:
        """Connect in a thread."""
        self._client.open()

    def close(self) -> None:
        """See `ClientThread.close`."""
        self._client.close()

    def put(self, frame: bytes) -> None:
        """Publish a frame, or drop it."""
        publisher = self._publisher
        if publisher is None:
            self.unheard += 1
            return
        with contextlib.suppress(zenoh.ZError):
            publisher.put(frame)
        self.sent += self.is_heard
        self.unheard += not self.is_heard

    def _use(self, session: zenoh.Session, stopping: threading.Event) -> None:
        publisher = session.declare_publisher(
            self._daemon.key,
            encoding=zenoh.Encoding.APPLICATION_JSON.with_schema(payload.SCHEMA),
            congestion_control=zenoh.CongestionControl.DROP,
            express=True,
        )
        self._publisher = publisher
        while not stopping.is_set():
            heard = bool(publisher.matching_status.matching)  # type: ignore[attr-defined]  # its stub says bool
            if heard != self.is_heard:
                self.is_heard = heard
                self._tell(
                    f"the daemon at {self._daemon.endpoint} {'hears' if heard else 'has gone; it is waited for'}"
                )
            stopping.wait(LOOK_S)
        self._publisher = None
