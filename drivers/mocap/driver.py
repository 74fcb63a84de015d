"""Motion capture over Zenoh: the daemon listens, whatever sees the arm connects and publishes.

Samples are stamped, bounded, parsed and judged on Zenoh's thread; the control loop only takes what is good.
"""

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable

import zenoh

from softarm.drivers.base import DeviceError
from softarm.drivers.mocap import payload as mocap_payload
from softarm.drivers.mocap.zenoh_session import listener
from softarm.schemas.config import ZenohMocap
from softarm.schemas.messages import MocapFrame

RING = 64  # frames kept between two ticks: half a second at 120 Hz
RETRY_S = 1.0
SILENCE_S = 0.1
COMPLAINT_S = 1.0  # how long a bad sample is remembered
CLOCK_TOLERANCE_NS = 5_000_000  # a capture stamp further ahead than this is not of this host's clock


class ZenohMocapSource:
    """A `softarm.drivers.base.MocapSource`. Counts: `frames`, `oversized` (never parsed), `malformed` (not a frame),
    `misplaced` (a frame out of order or from another clock); none of the last three reaches the loop.
    """

    def __init__(self, config: ZenohMocap, clock: Callable[[], int] = time.monotonic_ns) -> None:
        self.frames = self.oversized = self.malformed = self.misplaced = 0
        self._config, self._clock = config, clock
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        self._session: zenoh.Session | None = None
        self._good: deque[MocapFrame] = deque(maxlen=RING)  # Zenoh's thread appends, the loop takes
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
        self._good.clear()

    def read(self, now_ns: int) -> tuple[MocapFrame, ...]:
        """See `softarm.drivers.base.MocapSource.read`."""
        good = self._good
        return tuple(good.popleft() for _ in range(len(good)))  # what comes meanwhile is the next tick's

    def reset_fault(self) -> None:
        """A camera system has no fault of this kind."""

    def problem(self) -> str | None:
        """See `softarm.drivers.base.Device.problem`."""
        if self._link_problem is not None:
            return self._say("listen", self._link_problem, "stop the other daemon, or correct drivers.mocap")
        now_ns = self._clock()
        if self._complaint is not None and now_ns - self._complaint[0] < COMPLAINT_S * 1e9:
            counts = f"{self.oversized} oversized, {self.malformed} malformed, {self.misplaced} misplaced so far"
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
                self._session.declare_subscriber(self._config.key, self._hear)
            except zenoh.ZError as error:
                self._link_problem = str(error).split(" at /")[0]
                self._close()
                self._stopping.wait(RETRY_S)
                continue
            self._link_problem = None
            self._stopping.wait()
        self._close()

    def _close(self) -> None:
        session, self._session = self._session, None
        if session is not None:
            session.close()  # type: ignore[no-untyped-call]

    def _hear(self, sample: zenoh.Sample) -> None:
        """Zenoh's thread calls this for each sample, one at a time."""
        now_ns, size = self._clock(), len(sample.payload)
        if size > mocap_payload.MAX_BYTES:
            self.oversized += 1
            self._complaint = (now_ns, f"a sample of {size} bytes, at most {mocap_payload.MAX_BYTES}: not parsed")
            return
        try:
            mocap_payload.check_schema(str(sample.encoding))
            frame = mocap_payload.decode(sample.payload.to_bytes(), now_ns)
        except ValueError as error:
            self.malformed += 1
            self._complaint = (now_ns, f"a malformed sample: {error}")
            return
        misplaced = self._misplaced(frame)
        if misplaced is not None:
            self.misplaced += 1
            self._complaint = (now_ns, misplaced)
            return
        self._last_frame_ns, self._last_capture_ns = now_ns, frame.t_capture_ns
        self._good.append(frame)
        self.frames += 1

    def _misplaced(self, frame: MocapFrame) -> str | None:
        ahead_ns = frame.t_capture_ns - frame.t_receive_ns
        if ahead_ns > CLOCK_TOLERANCE_NS:
            return f"a capture stamp {ahead_ns / 1e9:.3f} s ahead of CLOCK_MONOTONIC here"
        if frame.t_capture_ns <= self._last_capture_ns:
            return "a frame no newer than the last: repeated, or two bridges publish"
        return None
