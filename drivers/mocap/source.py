"""What a source of motion capture is. Publish one under the entry-point group `softarm.mocap_sources`, name it as
`drivers.mocap.driver`, and the daemon flies by its frames.

class Mine:
    interface = 1
    description = "one line"
    def __init__(self, **options): ...        # opens nothing
    def run(self, frames):
        with open_it() as camera:
            while frames.are_wanted:
                ... frames.put(sequence, t_capture_ns, {"cart": (y, z, angle), "link5": (y, z, angle)})
"""

from collections.abc import Mapping, Sequence
from typing import Protocol, runtime_checkable

GROUP = "softarm.mocap_sources"
INTERFACE = 1

Bodies = Mapping[str, Sequence[float] | None]


class Frames(Protocol):
    """Where a source puts its frames."""

    @property
    def are_wanted(self) -> bool:
        """False once the daemon ends: return from `run` then, within 0.5 s."""

    def now_ns(self) -> int:
        """Nanoseconds of CLOCK_MONOTONIC, the clock of every stamp."""

    def wait(self, seconds: float) -> None:
        """Wait for so long, or until no more frames are wanted."""

    def put(self, sequence: int, t_capture_ns: int, bodies: Bodies) -> None:
        """Hand over a frame; never blocks and never raises. One that is refused is counted and told in the status.

        sequence: the cameras' own count, one more for each frame they took. t_capture_ns: when it was taken, by
        `now_ns`'s clock. bodies: `softarm.schemas.messages.BODY_NAMES` -> y (m), z (m) and absolute angle (rad), None
        where the cameras have lost it; what is left out counts as lost. What is meant: docs/wires.md.
        """

    def refuse(self, problem: str) -> None:
        """Say what is wrong with something that came in and is no frame; counted and told likewise."""


@runtime_checkable
class Source(Protocol):
    """Whatever sees the arm. It has a thread of its own."""

    description: str  # one line for people

    def run(self, frames: Frames) -> None:
        """Put frames until none are wanted. What it raises is told in the status; it is run again a second later."""
