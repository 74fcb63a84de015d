"""Publisher of frames to the daemon over Zenoh; without a listening daemon frames are counted and dropped."""

import contextlib
from collections.abc import Callable

import zenoh

from softarm.drivers.mocap import payload
from softarm.drivers.mocap.zenoh_session import ClientThread
from softarm.schemas.bridge import Listener

# Interval of the checks for a listening daemon.
CHECK_S = 0.5


class Publisher(ClientThread):
    """Publisher that never waits for the daemon, which may start later or restart."""

    def __init__(self, daemon: Listener, report: Callable[[str], None]) -> None:
        super().__init__(daemon.endpoint, "publisher")
        self.sent = self.without_daemon = 0
        self.daemon_listens = False
        self._daemon, self._report = daemon, report
        self._publisher: zenoh.Publisher | None = None

    def put(self, frame: bytes) -> None:
        """Publish a frame, or drop it."""
        publisher = self._publisher
        if publisher is None:
            self.without_daemon += 1
            return
        with contextlib.suppress(zenoh.ZError):
            publisher.put(frame)
        self.sent += self.daemon_listens
        self.without_daemon += not self.daemon_listens

    def _use(self, session: zenoh.Session) -> None:
        publisher = session.declare_publisher(
            self._daemon.key,
            encoding=zenoh.Encoding.APPLICATION_JSON.with_schema(payload.SCHEMA),
            congestion_control=zenoh.CongestionControl.DROP,
            express=True,
        )
        self._publisher = publisher
        while not self._stopping.is_set():
            listens = bool(publisher.matching_status.matching)  # type: ignore[attr-defined]  # its stub says bool
            if listens != self.daemon_listens:
                self.daemon_listens = listens
                self._report(
                    f"the daemon at {self._daemon.endpoint} {'listens' if listens else 'is gone; waiting for it'}"
                )
            self._stopping.wait(CHECK_S)
        self._publisher = None
