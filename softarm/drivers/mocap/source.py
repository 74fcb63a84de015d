"""Interface of motion capture plug-ins.

Publish a source under the entry-point group `softarm.mocap_sources` and set `drivers.mocap.driver` to its name:

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
    """Receiver of a source's frames."""

    @property
    def are_wanted(self) -> bool:
        """False when the daemon ends; `run` must then return within 0.5 s."""

    def now_ns(self) -> int:
        """Return the time of CLOCK_MONOTONIC, the clock of every stamp, ns."""

    def wait(self, seconds: float) -> None:
        """Wait for a number of seconds, or until no more frames are wanted."""

    def put(self, sequence: int, t_capture_ns: int, bodies: Bodies) -> None:
        """Deliver a frame; never blocks and never raises. Rejected frames are counted and reported in the status.

        Args:
            sequence: Count of the camera system, one more for each exposure.
            t_capture_ns: Time of the exposure, on the clock of `now_ns`.
            bodies: For each name of `softarm.schemas.messages.BODY_NAMES` y (m), z (m) and absolute angle (rad), or
                None without tracking; a missing name counts as None. The axes: docs/reference/wires.md.
        """

    def refuse(self, problem: str) -> None:
        """Report input that is not a frame; it is counted and reported in the status."""


@runtime_checkable
class Source(Protocol):
    """Source of frames, run in a thread of its own; `description` is one line for people."""

    description: str

    def run(self, frames: Frames) -> None:
        """Put frames until none are wanted.

        An exception is reported in the status, and `run` is called again a second later.
        """
