"""Zenoh sessions: the daemon is a listening peer, all other processes are its clients, without discovery.

In Zenoh 1.9 and later, peers do not relay between peers, but clients of one peer can communicate.
"""

import json
import threading

import zenoh

# Until the daemon listens for the first time; afterwards the session reconnects by itself.
RETRY_S = 0.1

_COMMON = {
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "transport/shared_memory/enabled": False,
    # A peer that hangs is dropped after a second, not after the default ten.
    "transport/link/tx/lease": 1000,
}


def listener(endpoint: str) -> zenoh.Config:
    """Return the configuration of the daemon: a peer at `endpoint`, e.g. tcp/127.0.0.1:7447."""
    return _config({"mode": "peer", "listen/endpoints": [endpoint]})


def client(endpoint: str) -> zenoh.Config:
    """Return the configuration of a client: a bridge, the twin or a tool.

    With it `zenoh.open` raises ZError at once if the daemon does not listen. An open session reconnects by itself
    within 0.1 s of the listener's return.
    """
    return _config(
        {
            "mode": "client",
            "listen/endpoints": [],
            "connect/endpoints": [endpoint],
            "connect/retry": {"period_init_ms": 50, "period_max_ms": 100, "period_increase_factor": 1.5},
        }
    )


class ClientThread:
    """Session of a client on a thread of its own; the daemon may start later.

    A subclass overrides `_use`, which receives the open session and returns once `_stopping` is set.
    """

    def __init__(self, endpoint: str, name: str) -> None:
        self._endpoint = endpoint
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def open(self) -> None:
        """Connect in the thread."""
        self._thread.start()

    def close(self, wait_s: float | None = None) -> None:
        """Close the session; a process with an open session may never end. Wait for it, at most `wait_s`."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(wait_s)

    def _run(self) -> None:
        session: zenoh.Session | None = None
        while session is None and not self._stopping.is_set():
            try:
                session = zenoh.open(client(self._endpoint))
            except zenoh.ZError:
                self._stopping.wait(RETRY_S)
        if session is None:
            return
        try:
            self._use(session)
        finally:
            session.close()  # type: ignore[no-untyped-call]

    def _use(self, session: zenoh.Session) -> None:
        raise NotImplementedError


def _config(entries: dict[str, object]) -> zenoh.Config:
    config = zenoh.Config()
    for key, value in (_COMMON | entries).items():
        config.insert_json5(key, json.dumps(value))
    return config
