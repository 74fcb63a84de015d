"""An arm that is tracked through NatNet alone, with other coordinates and another clock, reaches its target."""

import queue
import struct

import pytest

from softarm.drivers.bridge import natnet
from softarm.drivers.bridge.conversation import Conversation
from softarm.drivers.bridge.frame import Plane, View, names_of
from softarm.drivers.mocap.source import Frames
from softarm.drivers.twin import motive
from softarm.drivers.twin.motive import CLOCK_HZ, IDS, bodies_of
from softarm.evaluation import through_source
from softarm.schemas.bridge import Marks, Room
from softarm.schemas.messages import BODY_NAMES, MocapFrame

AHEAD_S, PPM = 86_400.0, 50.0


def ticks(now_ns: int) -> int:
    """The server's clock."""
    return round((now_ns * (1 + PPM * 1e-6) / 1e9 + AHEAD_S) * CLOCK_HZ)


class ThroughNatNet:
    """Source with all of the bridge except its sockets; datagrams arrive by `shown`."""

    interface = 1
    description = "NatNet"

    def __init__(self, room: Room) -> None:
        self.shown: queue.Queue[bytes] = queue.Queue()
        self.view = View(room, Marks())

    def run(self, frames: Frames) -> None:
        """Run as `softarm.drivers.mocap.source.Source` requires."""
        conversation = Conversation(lambda text: None)
        conversation.receive(motive.server_info((4, 1), CLOCK_HZ, 1511, None), frames.now_ns())
        conversation.receive(motive.models((4, 1), IDS), frames.now_ns())
        names, _ = names_of(Marks(), conversation.ids)
        for _ in range(5):
            self.echo(conversation, frames.now_ns())
        while frames.are_wanted:
            try:
                datagram = self.shown.get(timeout=0.05)
            except queue.Empty:
                continue
            self.echo(conversation, frames.now_ns())
            taken = conversation.receive(datagram, frames.now_ns())
            if taken is not None:
                seen = self.view.of(taken.frame.bodies, names)
                poses = {name: pose[:3] for name, pose in zip(BODY_NAMES, seen, strict=True) if pose.tracked}
                frames.put(taken.sequence, taken.t_capture_ns, poses)

    def echo(self, conversation: Conversation, now_ns: int) -> None:
        """Request the server's clock, which answers at once."""
        conversation._asked.append(now_ns)
        conversation.receive(natnet.message(natnet.ECHO_RESPONSE, struct.pack("<QQ", now_ns, ticks(now_ns))), now_ns)


@pytest.mark.slow
def test_the_arm_reaches_its_target() -> None:
    room = Room(up="y", yaw_rad=0.4, origin_m=(1.2, 0.1, -0.7))
    source, plane = ThroughNatNet(room), Plane(room)

    def show(frame: MocapFrame) -> None:
        bodies = bodies_of(plane, dict(zip(BODY_NAMES, frame.bodies, strict=True)))
        taken = ticks(frame.t_capture_ns)
        source.shown.put(motive.frame((4, 1), frame.sequence, bodies, (taken, taken, taken)))

    flight = through_source.fly(source, show)
    assert flight.reached
    assert flight.stop is None
