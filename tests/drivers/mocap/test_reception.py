"""Frames on their way from a motion capture source to the failsafe."""

import pytest

from softarm.daemon.control.observer import Observer
from softarm.daemon.control.records import Inputs
from softarm.drivers.mocap.reception import Reception
from softarm.schemas.config import Config
from softarm.schemas.messages import MocapFrame, Pose

NOW_NS = 50_000_000_000
FRAME_NS = 8_000_000
POSES = tuple(Pose(0.0, 0.965 - 0.08 * link, 0.0) for link in range(6))


class Source:
    """A reception and the observer that takes its frames, a frame every 8 ms."""

    def __init__(self):
        self.now_ns = NOW_NS
        self.sequence = 0
        self.reception = Reception("tcp/127.0.0.1:7447", "correct the bridge", "start the bridge", lambda: self.now_ns)
        self.observer = Observer(Config())

    def send(self, count, ahead_ns=0):
        """Send frames whose capture stamps lie ahead of this computer's clock."""
        for _ in range(count):
            self.now_ns += FRAME_NS
            self.sequence += 1
            self.reception.accept(MocapFrame(self.sequence, self.now_ns + ahead_ns, self.now_ns, POSES))

    def events(self):
        self.observer.update(Inputs(self.now_ns, mocap=self.reception.read(self.now_ns)))
        return {event.name: event.text for event in self.observer.plausibility.events()}


@pytest.fixture
def source():
    return Source()


def test_frames_stamped_in_the_future_raise_mocap_clock(source):
    source.send(4, ahead_ns=9_999_000_000)
    text = source.events()["mocap_clock"]
    assert "9.999 s ahead of CLOCK_MONOTONIC, allowed 0.005 s" in text
    assert source.observer.good is None


def test_frames_pass_again_once_the_clock_is_corrected(source):
    source.send(1)
    source.send(4, ahead_ns=10_000_000_000)
    source.send(40)
    assert source.events() == {}
    assert source.observer.good.sequence == 45
    assert source.reception.misplaced == 0
