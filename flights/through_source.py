"""A flight whose cameras are seen through a source of motion capture: what a source's own test flies."""

import time
from collections.abc import Callable

from softarm.daemon.shell.offline import Lockstep
from softarm.drivers.base import MocapSource, WithoutWire
from softarm.drivers.mocap.plugged import PluggedMocapSource
from softarm.drivers.mocap.source import Source
from softarm.policies import registry
from softarm.schemas.config import Config
from softarm.schemas.flights import Flight
from softarm.schemas.goals import Goal
from softarm.schemas.messages import MocapFrame

PATIENCE_S = 5.0  # for a frame on its way; a machine that is busy needs some
_LOOK_S = 0.0002
_AGAIN_S = 0.2  # a source that is not listening yet, or a datagram that was lost; one that comes twice is refused


class SourceError(Exception):
    """A source that did not hand over what was shown to it."""


def fly(
    source: Source,
    show: Callable[[MocapFrame], None],
    goal: Goal = Goal("reach", -0.2, 0.62),  # noqa: B008
    cart_start_m: float = 0.1,
    policy: str = "reach",
) -> Flight:
    """Fly a goal with the daemon's own tick, whose motion capture is the source; needs the extra `sim`.

    show: be the cameras: bring this frame to where the source looks for it; asked again if it does not come out. Time
    is made up: `Frames.now_ns` tells it. Raises SourceError for a frame that never comes out, with the source's words.
    """
    config = Config()
    flown = Lockstep(config, registry.load(policy))
    robot = flown.robot
    seen = PluggedMocapSource("tried", source, lambda: robot.now_ns)
    robot.mocap = _Through(robot.mocap, seen, show)
    seen.start()
    try:
        return flown.fly(goal, cart_start_m)
    finally:
        seen.end()


class _Through(WithoutWire):
    """The body's own frames, by way of a source."""

    def __init__(self, cameras: MocapSource, source: PluggedMocapSource, show: Callable[[MocapFrame], None]) -> None:
        self._cameras, self._source, self._show = cameras, source, show

    def read(self, now_ns: int) -> tuple[MocapFrame, ...]:
        """Show every new frame, and take what the source makes of it."""
        for frame in self._cameras.read(now_ns):
            before, began_s, shown = self._source.frames, time.monotonic(), 0
            while self._source.frames == before:
                passed_s = time.monotonic() - began_s
                if passed_s >= shown * _AGAIN_S:
                    self._show(frame)
                    shown += 1
                if passed_s > PATIENCE_S:
                    said = self._source.problem() or "it says nothing"
                    raise SourceError(f"frame {frame.sequence} did not come out of the source: {said}")
                time.sleep(_LOOK_S)
        return self._source.read(now_ns)
