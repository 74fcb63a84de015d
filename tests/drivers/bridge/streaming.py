"""Stream of a NatNet server, for tests of the bridge and of its verbs."""

import threading
import time
from collections.abc import Iterator, Mapping
from typing import Self

from softarm.drivers.bridge.frame import Plane
from softarm.drivers.twin import motive
from softarm.drivers.twin.motive import Motive, bodies_of
from softarm.schemas.bridge import Room
from softarm.schemas.messages import Pose


class Streaming:
    """Server that streams `poses` in a room 200 times a second and records the time of each frame.

    Each frame takes the next poses of `motion`, so that a late frame delays the motion too.
    """

    def __init__(self, server: Motive, poses: dict[str, Pose], room: Room, exposed: bool = True) -> None:
        self.taken: dict[int, int] = {}
        self.poses = poses
        self.motion: Iterator[Mapping[str, Pose]] = iter(())
        self._server, self._plane, self._exposed = server, Plane(room), exposed
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        number = 0
        while not self._ended.wait(0.005):
            number += 1
            self.poses.update(next(self.motion, {}))
            taken_ns = time.monotonic_ns() - 8_000_000
            taken = self._server.ticks(taken_ns)
            stamps = (taken if self._exposed else 0, taken + motive.CLOCK_HZ // 200, self._server.ticks())
            self.taken[number] = taken_ns
            self._server.stream(motive.frame(self._server.version, number, bodies_of(self._plane, self.poses), stamps))
