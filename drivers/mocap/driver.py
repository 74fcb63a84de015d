"""Motion capture over Zenoh: the daemon listens, whatever sees the arm connects and publishes."""

import asyncio
import threading
import time
from collections.abc import Callable
from typing import Any

import zenoh

from softarm.drivers.base import DeviceError
from softarm.drivers.mocap import payload as mocap_payload
from softarm.drivers.mocap.zenoh_session import listener
from softarm.schemas.config import ZenohMocap
from softarm.schemas.messages import MocapFrame

RING = 64  # half a second at 120 Hz; a ring, since a full FIFO would block Zenoh's receiving thread
RETRY_S = 1.0
SILENCE_S = 0.1
COMPLAINT_S = 1.0  # how long a bad sample is remembered
CLOCK_TOLERANCE_NS = 5_000_000  # a capture stamp further ahead than this is not of this host's clock


class ZenohMocapSource:
    """A `softarm.drivers.base.MocapSource`. Counts: `frames`, `malformed` (not a frame), `misplaced` (a frame out of
    order or from another clock); none of the last two reaches the loop.
    """

    def __init__(self, config: ZenohMocap, clock: Callable[[], int] = time.monotonic_ns) -> None:
        self.frames = self.malformed = self.misplaced = 0
        self._config, self._clock = config, clock
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        self._session: zenoh.Session | None = None
        self._subscriber: zenoh.Subscriber[Any] | None = None
        self._link_problem: str | None = "the endpoint is being opened"
        self._last_frame_ns: int | None = None
        self._last_capture_ns = -1
        self._complaint: tuple[int, str] | None = None

    def start(self) -> None:
        """Open the endpoint in a thread: `zenoh.open` may take its time."""
        self._thread = threading.Thread(target=self._listen, name="mocap", daemon=True)
        self._thread.start()

    async def stop(self) -> None:
        """Close the session; a process that forgets to may never end."""
        self._stopping.set()
        if self._thread is not None:
            await asyncio.to_thread(self._thread.join, 0.9)

    def read(self, now_ns: int) -> tuple[MocapFrame, ...]:
        """See `softarm.drivers.base.MocapSource.read`."""
        frames: list[MocapFrame] = []
        for _ in range(RING):
            sample = self._next_sample()
            if sample is None:
                break
            frame = self._accept(sample.payload.to_bytes(), now_ns)
            if frame is not None:
                frames.append(frame)
        return tuple(frames)

    def reset_fault(self) -> None:
        """A camera system has no fault of this kind."""

    def problem(self) -> str | None:
        """See `softarm.drivers.base.Device.problem`."""
        if self._link_problem is not None:
            return self._say("listen", self._link_problem, "stop the other daemon, or correct drivers.mocap")
        now_ns = self._clock()
        if self._complaint is not None and now_ns - self._complaint[0] < COMPLAINT_S * 1e9:
            counts = f"{self.malformed} malformed, {self.misplaced} misplaced so far"
            return self._say("read", f"{self._complaint[1]} ({counts})", "correct the bridge: docs/wires.md")
        if self._last_frame_ns is None:
            return self._say("read", "no frame yet", "start the bridge, or `softarm twin`")
        silent_s = (now_ns - self._last_frame_ns) / 1e9
        if silent_s > SILENCE_S:
            return self._say("read", f"no frame for {silent_s:.1f} s", "see to the cameras and the bridge")
        return None

    def _say(self, command: str, problem: str, remedy: str) -> str:
        return str(DeviceError(f"{self._config.endpoint} {self._config.key}", command, problem, remedy))

    def _listen(self) -> None:
        while not self._stopping.is_set():
            try:
                self._session = zenoh.open(listener(self._config.endpoint))
                self._subscriber = self._session.declare_subscriber(self._config.key, zenoh.handlers.RingChannel(RING))
            except zenoh.ZError as error:
                self._link_problem = str(error).split(" at /")[0]
                self._close()
                self._stopping.wait(RETRY_S)
                continue
            self._link_problem = None
            self._stopping.wait()
        self._close()

    def _close(self) -> None:
        session, self._session, self._subscriber = self._session, None, None
        if session is not None:
            session.close()  # type: ignore[no-untyped-call]

    def _next_sample(self) -> zenoh.Sample | None:
        subscriber = self._subscriber
        try:
            return None if subscriber is None else subscriber.try_recv()
        except zenoh.ZError:  # closed in this very moment
            return None

    def _accept(self, payload: bytes, now_ns: int) -> MocapFrame | None:
        try:
            frame = mocap_payload.decode(payload, now_ns)
        except ValueError as error:
            self.malformed += 1
            self._complaint = (now_ns, f"a malformed sample: {error}")
            return None
        ahead_ns = frame.t_capture_ns - now_ns
        if ahead_ns > CLOCK_TOLERANCE_NS:
            self.misplaced += 1
            self._complaint = (
                now_ns,
                f"a capture stamp {ahead_ns / 1e9:.3f} s ahead of CLOCK_MONOTONIC here",
            )
            return None
        if frame.t_capture_ns <= self._last_capture_ns:
            self.misplaced += 1
            self._complaint = (now_ns, "a frame no newer than the last: repeated, or two bridges publish")
            return None
        self.frames += 1
        self._last_frame_ns, self._last_capture_ns = now_ns, frame.t_capture_ns
        return frame
