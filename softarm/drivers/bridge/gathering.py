"""Recording of a calibration: an arm that comes to rest, then a cart that is pushed, without any key press."""

import enum
import math
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence

from softarm.drivers.base import DeviceError
from softarm.drivers.bridge.calibration import PUSH_MIN_M, STILL_M, Sample
from softarm.drivers.bridge.client import Client
from softarm.drivers.bridge.natnet import Body, Vector
from softarm.schemas.bridge import Bridge

# Time of the arm at rest, and of the cart at its last end.
REST_NS, STAND_NS = 3_000_000_000, 2_000_000_000
# A longer pause of the frames, as a share of these times, says nothing about rest: the time begins again.
PAUSE_SHARE = 0.25
# A shorter movement is not a push from stop to stop.
WHOLE_M = 0.5
AT_END_M = 0.02
# Frames that follow sooner are dropped: 120 a second are enough.
STEP_NS = 4_000_000


class Phase(enum.Enum):
    """Phases of a calibration."""

    RESTING = "hang still"
    PUSHING = "push"
    DONE = "done"


class Gathering:
    """Recorder of the samples `rest` and `push` for `softarm.drivers.bridge.calibration.calibrate`."""

    def __init__(self, wanted: Sequence[str], middle_here: bool) -> None:
        self.phase = Phase.RESTING
        self.rest: list[Sample] = []
        self.push: list[Sample] = []
        self._wanted = tuple(wanted)
        self._enough_m = PUSH_MIN_M if middle_here else WHOLE_M
        self._recent: deque[Sample] = deque()
        # The two positions of the cart that are farthest apart so far.
        self._ends: tuple[Vector, Vector] | None = None

    def add(self, t_ns: int, bodies: Mapping[str, Body]) -> None:
        """Add the tracked bodies of a frame."""
        if self.phase is Phase.DONE or (self._recent and t_ns - self._recent[-1].t_ns < STEP_NS):
            return
        sample = Sample(t_ns, dict(bodies))
        window = REST_NS if self.phase is Phase.RESTING else STAND_NS
        if self._recent and t_ns - self._recent[-1].t_ns > PAUSE_SHARE * window:
            self._recent.clear()
        self._recent.append(sample)
        whole = t_ns - self._recent[0].t_ns >= window
        while t_ns - self._recent[0].t_ns > window:
            self._recent.popleft()
        if self.phase is Phase.RESTING:
            if whole and self.missing() == () and self.motion_m() < STILL_M:
                self.rest, self.phase = list(self._recent), Phase.PUSHING
        else:
            self._watch(sample, whole)

    def missing(self) -> tuple[str, ...]:
        """Return the bodies without tracking in the last seconds."""
        there = {name for sample in self._recent for name in sample.bodies}
        return tuple(name for name in self._wanted if name not in there)

    def motion_m(self) -> float:
        """Return the largest motion of a body in the last seconds, without one frame in twenty."""
        return max((_spread(self._recent, name) for name in self._wanted), default=math.inf)

    def push_m(self) -> float:
        """Return the length of the push."""
        return 0.0 if self._ends is None else math.dist(*self._ends)

    def progress(self) -> str:
        """Return the progress as text."""
        if self.phase is Phase.PUSHING:
            return f"pushed over {self.push_m():.2f} m"
        if missing := self.missing():
            return f"not tracked yet: {', '.join(missing)}"
        return f"waiting for rest: moving by {1e3 * self.motion_m():.0f} mm"

    def finish(self) -> None:
        """End the recording with the samples so far."""
        self.rest = self.rest or list(self._recent)
        self.phase = Phase.DONE

    def _watch(self, sample: Sample, whole: bool) -> None:
        self.push.append(sample)
        if (cart := sample.bodies.get("cart")) is None:
            return
        at = cart.position_m
        if self._ends is None:
            self._ends = (at, at)
        # Of three points on a line the two that are farthest apart are its ends.
        self._ends = max((self._ends, (self._ends[0], at), (self._ends[1], at)), key=lambda pair: math.dist(*pair))
        at_end = min(math.dist(at, end) for end in self._ends) < AT_END_M
        at_rest = whole and _spread(self._recent, "cart") < STILL_M
        if at_rest and at_end and self.push_m() >= self._enough_m:
            self.phase = Phase.DONE


def gather(
    config: Bridge,
    client: Client,
    gathering: Gathering,
    patience_s: float,
    on_phase: Callable[[Phase], None],
    show: Callable[[str], None],
) -> None:
    """Record a server's frames until the calibration has its samples.

    After `patience_s` in one phase the samples so far suffice. `on_phase` receives each new phase, `show` the progress.

    Raises:
        DeviceError: No frames arrived.
    """
    phase, over_s = gathering.phase, time.monotonic() + patience_s
    while gathering.phase is not Phase.DONE:
        for taken in client.poll():
            names, _ = client.conversation.names_of(config.bodies)
            seen = {names[body.id]: body for body in taken.frame.bodies if body.tracked and body.id in names}
            gathering.add(taken.t_capture_ns, seen)
        if gathering.phase is not phase:
            phase, over_s = gathering.phase, time.monotonic() + patience_s
            on_phase(phase)
        elif time.monotonic() > over_s:
            gathering.finish()
            if not gathering.rest:
                raise DeviceError(
                    client.place, "read", "no frames arrived", client.problem() or "see docs/hardware/bridge.md"
                )
        show(client.problem() or gathering.progress())


def _spread(samples: "deque[Sample]", name: str) -> float:
    """Return the largest extent of a body's positions, without one frame in twenty."""
    places = [sample.bodies[name].position_m for sample in samples if name in sample.bodies]
    cut = len(places) // 40
    widths = (sorted(axis) for axis in zip(*places, strict=True))
    return max((axis[-1 - cut] - axis[cut] for axis in widths), default=0.0)
