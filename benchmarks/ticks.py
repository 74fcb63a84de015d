"""Recorder that keeps the ticks of a flight in memory."""

from softarm.daemon.control.records import Inputs, Outputs, TickTiming

Tick = tuple[Inputs, Outputs, TickTiming]


class Ticks(list[Tick]):
    """List of the ticks of a flight."""

    def tick(self, inputs: Inputs, outputs: Outputs, timing: TickTiming) -> None:
        """Store one tick in memory."""
        self.append((inputs, outputs, timing))
