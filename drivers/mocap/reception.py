"""What is the same for every source of frames: they are judged where they arrive, and the control loop takes what is
good.
"""

from collections import deque
from collections.abc import Callable

from softarm.drivers.base import DeviceError
from softarm.schemas.messages import MocapFrame

RING = 64  # frames kept between two ticks: half a second at 120 Hz
SILENCE_S = 0.1
COMPLAINT_S = 1.0  # how long a bad sample is remembered
CLOCK_TOLERANCE_NS = 5_000_000  # a capture stamp further ahead than this is not of this host's clock


class Reception:
    """Frames on their way from another thread to the loop. Counts: `frames`, `oversized` (never parsed), `malformed`
    (not a frame), `misplaced` (a frame out of order or from another clock); none of the last three reaches the loop.
    """

    def __init__(self, place: str, remedy: str, start: str, clock: Callable[[], int]) -> None:
        """place: what a complaint names; remedy: for bad samples; start: for none at all."""
        self.frames = self.oversized = self.malformed = self.misplaced = 0
        self.clock = clock
        self._place, self._remedy, self._start = place, remedy, start
        self._good: deque[MocapFrame] = deque(maxlen=RING)  # the other thread appends, the loop takes
        self._last_frame_ns: int | None = None
        self._last_capture_ns = -1
        self._complaint: tuple[int, str] | None = None

    def read(self, now_ns: int) -> tuple[MocapFrame, ...]:
        """See `softarm.drivers.base.MocapSource.read`."""
        good = self._good
        return tuple(good.popleft() for _ in range(len(good)))  # what comes meanwhile is the next tick's

    def reset_fault(self) -> None:
        """A camera system has no fault of this kind."""

    def accept(self, frame: MocapFrame) -> None:
        """Hand a frame on, or say why not; for one thread at a time."""
        misplaced = self._misplaced(frame)
        if misplaced is not None:
            self.misplaced += 1
            self.complain(frame.t_receive_ns, misplaced)
            return
        self._last_frame_ns, self._last_capture_ns = frame.t_receive_ns, frame.t_capture_ns
        self._good.append(frame)
        self.frames += 1

    def complain(self, now_ns: int, problem: str) -> None:
        """Remember a bad sample for a while."""
        self._complaint = (now_ns, problem)

    def heard(self) -> str | None:
        """What is wrong with what is heard; None: all is well."""
        now_ns = self.clock()
        if self._complaint is not None and now_ns - self._complaint[0] < COMPLAINT_S * 1e9:
            counts = f"{self.oversized} oversized, {self.malformed} malformed, {self.misplaced} misplaced so far"
            return self.say("read", f"{self._complaint[1]} ({counts})", self._remedy)
        if self._last_frame_ns is None:
            return self.say("read", "no frame yet", self._start)
        silent_s = (now_ns - self._last_frame_ns) / 1e9
        if silent_s > SILENCE_S:
            return self.say("read", f"no frame for {silent_s:.1f} s", "see to the cameras and the bridge")
        return None

    def say(self, command: str, problem: str, remedy: str) -> str:
        """A problem in the words of `DeviceError`."""
        return str(DeviceError(self._place, command, problem, remedy))

    def _misplaced(self, frame: MocapFrame) -> str | None:
        ahead_ns = frame.t_capture_ns - frame.t_receive_ns
        if ahead_ns > CLOCK_TOLERANCE_NS:
            return f"a capture stamp {ahead_ns / 1e9:.3f} s ahead of CLOCK_MONOTONIC here"
        if frame.t_capture_ns <= self._last_capture_ns:
            return "a frame no newer than the last: repeated, or two bridges publish"
        return None
