"""A flight whose motion capture is another package's source, over a wire of its own."""

import queue

import pytest

from softarm.drivers.mocap.source import Frames
from softarm.evaluation import through_source
from softarm.schemas.messages import BODY_NAMES, MocapFrame


class Queued:
    """Takes frames from a queue, as it were a socket."""

    description = "a queue"

    def __init__(self) -> None:
        self.wire: queue.Queue[MocapFrame] = queue.Queue()

    def run(self, frames: Frames) -> None:
        while frames.are_wanted:
            try:
                frame = self.wire.get(timeout=0.1)
            except queue.Empty:
                continue
            poses = {name: pose[:3] for name, pose in zip(BODY_NAMES, frame.bodies, strict=True)}
            frames.put(frame.sequence, frame.t_capture_ns, poses)


@pytest.mark.slow
def test_the_arm_reaches_its_target_with_frames_of_a_source():
    source = Queued()
    flight = through_source.fly(source, source.wire.put)
    assert flight.reached
    assert flight.stop is None
    again = Queued()
    assert through_source.fly(again, again.wire.put) == flight


def test_a_source_that_loses_a_frame_is_reported(monkeypatch):
    monkeypatch.setattr(through_source, "FRAME_TIMEOUT_S", 0.2)
    with pytest.raises(through_source.SourceError, match=r"frame 1 did not arrive from the source: .* no frame yet"):
        through_source.fly(Queued(), lambda frame: None)
