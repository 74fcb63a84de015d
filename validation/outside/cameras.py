"""Motion capture: frames to the daemon's endpoint as soon as it listens."""

import collections
import json
import random
import threading
import time
from collections.abc import Mapping

import zenoh


class Cameras:
    """Cameras that see the body `delay_s` late and with noise (angles: 10 rad for each metre)."""

    def __init__(self, endpoint: str, key: str, delay_s: float, noise_m: float) -> None:
        self._delay_ns, self._noise_m, self._key = int(delay_s * 1e9), noise_m, key
        self._random = random.Random(1)
        self._count = 0
        self._due: collections.deque[tuple[int, bytes]] = collections.deque()
        self._session: zenoh.Session | None = None
        self._publisher: zenoh.Publisher | None = None
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([endpoint]))
        for switch in ("scouting/multicast", "scouting/gossip", "transport/shared_memory"):
            config.insert_json5(f"{switch}/enabled", "false")
        threading.Thread(target=self._open, args=(config,), daemon=True).start()

    def _open(self, config: zenoh.Config) -> None:
        while self._session is None:
            try:
                self._session = zenoh.open(config)
            except zenoh.ZError:
                time.sleep(0.2)
        self._publisher = self._session.declare_publisher(self._key, encoding="application/json;softarm.mocap.v1")

    def take(self, t_ns: int, poses: Mapping[str, tuple[float, float, float]]) -> None:
        """Take a frame now and queue it."""
        noise = self._random.gauss
        bodies = {
            name: (y + noise(0, self._noise_m), z + noise(0, self._noise_m), angle + noise(0, 10 * self._noise_m))
            for name, (y, z, angle) in poses.items()
        }
        self._count += 1
        frame = {"sequence": self._count, "t_capture_ns": t_ns, "bodies": bodies}
        self._due.append((t_ns + self._delay_ns, json.dumps(frame).encode()))

    def send(self, now_ns: int) -> None:
        """Send the frames whose delay has passed."""
        while self._due and self._due[0][0] <= now_ns:
            payload = self._due.popleft()[1]
            if self._publisher is not None:
                self._publisher.put(payload)

    def close(self) -> None:
        """Close the Zenoh session."""
        if self._session is not None:
            self._session.close()  # type: ignore[no-untyped-call]
