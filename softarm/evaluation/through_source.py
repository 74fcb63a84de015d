"""Flight with motion capture from a plug-in source, for the tests of such a source."""

import time
from collections.abc import Callable

from softarm.daemon.runtime.offline import Lockstep
from softarm.drivers.base import MocapSource, WithoutWire
from softarm.drivers.mocap.plugged import PluggedMocapSource
from softarm.drivers.mocap.source import Source
from softarm.policies import registry
from softarm.schemas.config import Config
from softarm.schemas.flights import Flight
from softarm.schemas.goals import Goal
from softarm.schemas.messages import MocapFrame

FRAME_TIMEOUT_S = 5.0  # generous, for a busy machine
_LOOK_S = 0.0002
_AGAIN_S = 0.2  # repeat for a source that is not listening yet or a lost datagram; duplicates are rejected


class SourceError(Exception):
    """The source did not deliver a frame."""


def fly(
    source: Source,
    show: Callable[[MocapFrame], None],
    goal: Goal = Goal("reach", -0.2, 0.62),  # noqa: B008
    cart_start_m: float = 0.1,
    policy: str = "reach",
) -> Flight:
    """Fly a goal by the real control loop with motion capture from the source; needs the extra `sim`.

    `show` plays the cameras: it sends a frame to the source, and is called again if the frame does not arrive. Time is
    simulated; `Frames.now_ns` returns it.

    Raises:
        SourceError: A frame does not arrive, with the message of the source.
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
    """Motion capture that sends the body's frames through a source."""

    def __init__(self, cameras: MocapSource, source: PluggedMocapSource, show: Callable[[MocapFrame], None]) -> None:
        self._cameras, self._source, self._show = cameras, source, show

    def read(self, now_ns: int) -> tuple[MocapFrame, ...]:
        """Show every new frame to the source and return its frames."""
        for frame in self._cameras.read(now_ns):
            before, began_s, shown = self._source.frames, time.monotonic(), 0
            while self._source.frames == before:
                passed_s = time.monotonic() - began_s
                if passed_s >= shown * _AGAIN_S:
                    self._show(frame)
                    shown += 1
                if passed_s > FRAME_TIMEOUT_S:
                    reason = self._source.problem() or "it reports no problem"
                    raise SourceError(f"frame {frame.sequence} did not arrive from the source: {reason}")
                time.sleep(_LOOK_S)
        return self._source.read(now_ns)
