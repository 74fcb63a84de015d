"""What a calibration looks at: an arm that comes to rest, then a cart that is pushed. Nobody has to press a key."""

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

REST_NS, STAND_NS = 3_000_000_000, 2_000_000_000  # to hang still; for the cart to stand at its last end
WHOLE_M = 0.5  # less is no push from stop to stop
AT_END_M = 0.02
STEP_NS = 4_000_000  # frames that come closer to each other are left out: 120 a second are enough


class Phase(enum.Enum):
    """How far it is."""

    RESTING = "hang still"
    PUSHING = "push"
    DONE = "done"


class Gathering:
    """Fed with frames; `rest` and `push` are for `softarm.drivers.bridge.calibration.calibrate`."""

    def __init__(self, wanted: Sequence[str], middle_here: bool) -> None:
        self.phase = Phase.RESTING
        self.rest: list[Sample] = []
        self.push: list[Sample] = []
        self._wanted = tuple(wanted)
        self._enough_m = PUSH_MIN_M if middle_here else WHOLE_M
        self._recent: deque[Sample] = deque()
        self._begun_ns: int | None = None
        self._seen: set[str] = set()
        self._ends: tuple[Vector, Vector] | None = None  # of the cart, farthest apart so far

    def see(self, t_ns: int, bodies: Mapping[str, Body]) -> None:
        """Take a frame."""
        if self.phase is Phase.DONE or (self._recent and t_ns - self._recent[-1].t_ns < STEP_NS):
            return
        sample = Sample(t_ns, dict(bodies))
        self._seen |= bodies.keys()
        self._recent.append(sample)
        window = REST_NS if self.phase is Phase.RESTING else STAND_NS
        whole = t_ns - self._recent[0].t_ns >= window
        while t_ns - self._recent[0].t_ns > window:
            self._recent.popleft()
        if self.phase is Phase.RESTING:
            if whole and self.missing() == () and self.moves_m() < STILL_M:
                self.rest, self.phase = list(self._recent), Phase.PUSHING
        else:
            self._watch(sample, whole)

    def missing(self) -> tuple[str, ...]:
        """Bodies that no frame of the last seconds shows."""
        there = {name for sample in self._recent for name in sample.bodies}
        return tuple(name for name in self._wanted if name not in there)

    def moves_m(self) -> float:
        """How far the liveliest body has gone within the last seconds, but for a frame in twenty."""
        return max((_spread(self._recent, name) for name in self._wanted), default=math.inf)

    def gone_m(self) -> float:
        """How long the push is."""
        return 0.0 if self._ends is None else math.dist(*self._ends)

    def progress(self) -> str:
        """How it goes, for people."""
        if self.phase is Phase.PUSHING:
            return f"pushed over {self.gone_m():.2f} m"
        if missing := self.missing():
            return f"not seen yet: {', '.join(missing)}"
        return f"waiting for rest: within {1e3 * self.moves_m():.0f} mm"

    def break_off(self) -> None:
        """Time is over: what there is has to do."""
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
        stands = whole and _spread(self._recent, "cart") < STILL_M
        if stands and at_end and self.gone_m() >= self._enough_m:
            self.phase = Phase.DONE


def gather(
    config: Bridge,
    client: Client,
    gathering: Gathering,
    patience_s: float,
    on_phase: Callable[[Phase], None],
    show: Callable[[str], None],
) -> None:
    """Feed it with what a server streams until it is done, or broken off after `patience_s` in one phase.

    show: hears often how it goes. Raises DeviceError where no frames come.
    """
    was, over_s = gathering.phase, time.monotonic() + patience_s
    while gathering.phase is not Phase.DONE:
        for taken in client.poll():
            names, _ = client.conversation.names_of(config.bodies)
            seen = {names[body.id]: body for body in taken.frame.bodies if body.tracked and body.id in names}
            gathering.see(taken.t_capture_ns, seen)
        if gathering.phase is not was:
            was, over_s = gathering.phase, time.monotonic() + patience_s
            on_phase(was)
        elif time.monotonic() > over_s:
            gathering.break_off()
            if not gathering.rest:
                raise DeviceError(client.place, "read", "no frames came", client.problem() or "see docs/bridge.md")
        show(client.problem() or gathering.progress())


def _spread(samples: "deque[Sample]", name: str) -> float:
    """Of a body's places: the widest axis, a frame in twenty left out."""
    places = [sample.bodies[name].position_m for sample in samples if name in sample.bodies]
    cut = len(places) // 40
    widths = (sorted(axis) for axis in zip(*places, strict=True))
    return max((axis[-1 - cut] - axis[cut] for axis in widths), default=0.0)
