"""Recorder that keeps the ticks of a flight in memory."""

from softarm.daemon.control.records import Inputs, Outputs, TickTiming
from softarm.policies.base import PolicySpec

Tick = tuple[Inputs, Outputs, TickTiming]


class Ticks(list[Tick]):
    """List of ticks that is a `softarm.daemon.runtime.loop.TickRecorder`."""

    dropped = 0
    problem: str | None = None

    def tick(self, inputs: Inputs, outputs: Outputs, timing: TickTiming) -> None:
        """Store one tick in memory."""
        self.append((inputs, outputs, timing))

    def policy(self, spec: PolicySpec) -> None:
        """Do nothing, since the ticks do not name their policy."""
