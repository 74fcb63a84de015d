"""Reception of motion capture frames, shared by all sources.

A source judges each frame in its own thread; the control loop takes the accepted frames once a tick.
"""

import asyncio
import threading
from collections import deque
from collections.abc import Callable

from softarm.drivers.base import DeviceError
from softarm.schemas.messages import MocapFrame

# Longest wait for the thread at the end.
JOIN_S = 0.9
# Frames kept between two ticks: half a second at 120 Hz.
RING = 64
SILENCE_S = 0.1
# A rejected sample is reported for this long.
COMPLAINT_S = 1.0


class Reception:
    """Buffer between the thread that receives frames and the control loop.

    Counts `frames` (accepted), `malformed` (not a frame) and `misplaced` (out of order).
    A frame stamped in the future is accepted: the failsafe rejects it and raises `mocap_clock`.
    A source overrides `_run`, which receives frames in a thread of its own until `_stopping` is set.
    """

    def __init__(self, place: str, remedy: str, start: str, clock: Callable[[], int]) -> None:
        """Create an empty buffer.

        Args:
            place: Name of the source in problem reports.
            remedy: What to do about rejected samples.
            start: What to do when no frame has arrived.
            clock: Returns CLOCK_MONOTONIC, ns.
        """
        self.frames = self.malformed = self.misplaced = 0
        self.clock = clock
        self._place, self._remedy, self._start = place, remedy, start
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        self._good: deque[MocapFrame] = deque(maxlen=RING)
        self._last_frame_ns: int | None = None
        self._last_capture_ns = -1
        self._complaint: tuple[int, str] | None = None

    def start(self) -> None:
        """Receive frames in a thread."""
        self._thread = threading.Thread(target=self._run, name="mocap", daemon=True)
        self._thread.start()

    async def stop(self) -> None:
        """Request the thread to end; one that does not is abandoned."""
        await asyncio.to_thread(self.end)

    def end(self) -> None:
        """Request the thread to end, and wait for it up to `JOIN_S`."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join(JOIN_S)
        self._good.clear()

    def _run(self) -> None:
        raise NotImplementedError

    def read(self, now_ns: int) -> tuple[MocapFrame, ...]:
        """Return and remove the buffered frames, oldest first."""
        # Frames that arrive meanwhile belong to the next tick.
        return tuple(self._good.popleft() for _ in range(len(self._good)))

    def reset_fault(self) -> None:
        """Do nothing: a motion capture source has no fault to reset."""

    def accept(self, frame: MocapFrame) -> None:
        """Buffer a frame, or reject it if it is out of order. Call from one thread only."""
        if not frame.from_another_clock and frame.t_capture_ns <= self._last_capture_ns:
            self.misplaced += 1
            self.complain(frame.t_receive_ns, "a frame no newer than the last: repeated, or two bridges publish")
            return
        # Otherwise every frame after the correction of the clock would be out of order.
        if not frame.from_another_clock:
            self._last_capture_ns = frame.t_capture_ns
        self._last_frame_ns = frame.t_receive_ns
        self._good.append(frame)
        self.frames += 1

    def complain(self, now_ns: int, problem: str) -> None:
        """Report a rejected sample for the next COMPLAINT_S."""
        self._complaint = (now_ns, problem)

    def sample_problem(self) -> str | None:
        """Return the problem with the received samples, or None if there is none."""
        now_ns = self.clock()
        if self._complaint is not None and now_ns - self._complaint[0] < COMPLAINT_S * 1e9:
            counts = f"{self.malformed} malformed, {self.misplaced} misplaced so far"
            return self.describe("read", f"{self._complaint[1]} ({counts})", self._remedy)
        if self._last_frame_ns is None:
            return self.describe("read", "no frame yet", self._start)
        silent_s = (now_ns - self._last_frame_ns) / 1e9
        if silent_s > SILENCE_S:
            return self.describe("read", f"no frame for {silent_s:.1f} s", "check the cameras and the bridge")
        return None

    def describe(self, command: str, problem: str, remedy: str) -> str:
        """Return a problem in the form of DeviceError."""
        return str(DeviceError(self._place, command, problem, remedy))
