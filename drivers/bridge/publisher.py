"""Frames to the daemon over Zenoh, from the moment that it listens; until then they are counted and dropped."""

import contextlib
import threading
from collections.abc import Callable

import zenoh

from softarm.drivers.mocap import payload
from softarm.drivers.mocap.zenoh_session import client
from softarm.schemas.bridge import Listener

RETRY_S = 0.2
LOOK_S = 0.5  # for who listens


class Publisher:
    """Nothing here waits for the daemon: it may come later, and go and come again."""

    def __init__(self, daemon: Listener, tell: Callable[[str], None]) -> None:
        self.sent = self.unheard = 0
        self.is_heard = False
        self._daemon, self._tell = daemon, tell
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._connect, name="publisher", daemon=True)
        self._publisher: zenoh.Publisher | None = None

    def open(self) -> None:
        """Connect in a thread."""
        self._thread.start()

    def close(self) -> None:
        """Close the session; a process that forgets to may never end."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()

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

    def _connect(self) -> None:
        session: zenoh.Session | None = None
        while session is None and not self._stopping.is_set():
            try:
                session = zenoh.open(client(self._daemon.endpoint))
            except zenoh.ZError:
                self._stopping.wait(RETRY_S)
        if session is None:
            return
        publisher = session.declare_publisher(
            self._daemon.key,
            encoding=zenoh.Encoding.APPLICATION_JSON.with_schema(payload.SCHEMA),
            congestion_control=zenoh.CongestionControl.DROP,
            express=True,
        )
        self._publisher = publisher
        while not self._stopping.is_set():
            heard = bool(publisher.matching_status.matching)  # type: ignore[attr-defined]  # its stub says bool
            if heard != self.is_heard:
                self.is_heard = heard
                self._tell(
                    f"the daemon at {self._daemon.endpoint} {'hears' if heard else 'has gone; it is waited for'}"
                )
            self._stopping.wait(LOOK_S)
        self._publisher = None
        session.close()  # type: ignore[no-untyped-call]
