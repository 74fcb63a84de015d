"""Protocol with a NatNet server and stamps of its frames, on manual clocks."""

import struct

import pytest

from softarm.drivers.bridge import natnet
from softarm.drivers.bridge.conversation import Conversation
from softarm.drivers.twin import motive
from softarm.drivers.twin.motive import CLOCK_HZ, IDS

MS = 1_000_000
# Offset of the server's clock.
AHEAD_S = 1234.5
VERSION = (4, 1)


class Server:
    """Server that answers as Motive does, 0.1 ms each way, and streams."""

    def __init__(self, version=VERSION, group=None):
        self.version, self.group, self.lines, self.kinds = version, group, [], []
        self.conversation = Conversation(self.lines.append)
        self.now = 50 * MS
        self.number = 0
        self.ahead_s, self.echoes, self.ids = AHEAD_S, True, dict(IDS)

    def ticks(self, now):
        return round((now / 1e9 + self.ahead_s) * CLOCK_HZ)

    def run(self, seconds, answers=True):
        """Let both sides communicate for a number of seconds."""
        end = self.now + round(seconds * 1e9)
        while self.now < end:
            sent = self.conversation.due(self.now)
            for datagram in sent:
                self.kinds.append(struct.unpack_from("<H", datagram)[0])
                if answers:
                    self.answer(datagram)
            self.now += 10 * MS

    def answer(self, datagram):
        kind = self.kinds[-1]
        if kind == natnet.CONNECT:
            self.conversation.receive(motive.server_info(self.version, CLOCK_HZ, 1511, self.group), self.now)
        elif kind == natnet.REQUEST_MODELS:
            self.conversation.receive(motive.models(self.version, self.ids), self.now)
        elif kind == natnet.ECHO_REQUEST and self.echoes:
            ticks = struct.pack("<Q", self.ticks(self.now + MS // 10))
            self.conversation.receive(natnet.message(natnet.ECHO_RESPONSE, datagram[4:] + ticks), self.now + MS // 5)

    def frame(self, age_ms=8.0, exposed=True, received=True, sent=True, parameters=0, number=None):
        """Return the stamped frame of a capture some time ago."""
        self.number = self.number + 1 if number is None else number
        taken = self.ticks(self.now - round(age_ms * 1e6))
        later = taken + CLOCK_HZ // 200
        sent = motive.frame(
            self.version, self.number, (), (taken * exposed, later * received, (later + 9) * sent), parameters
        )
        return self.conversation.receive(sent, self.now)


@pytest.fixture
def server():
    made = Server()
    made.run(1.0)
    return made


def test_the_client_connects_and_requests_names_and_echoes(server):
    assert server.kinds[:4] == [natnet.CONNECT, natnet.KEEP_ALIVE, natnet.REQUEST_MODELS, natnet.ECHO_REQUEST]
    assert server.conversation.ids == IDS
    assert server.kinds.count(natnet.ECHO_REQUEST) == 12
    assert server.lines == [
        "Motive 3.1.0.0 uses NatNet 4.1, unicast, clock of 10000000 Hz",
        "clock offset -1234.500 s +- 0.10 ms",
    ]


def test_a_silent_server_is_contacted_every_second():
    server = Server()
    server.run(3.0, answers=False)
    assert server.kinds == [natnet.CONNECT] * 3
    server.run(1.0)
    assert server.conversation.server is not None


def test_a_unicast_server_receives_keep_alives_and_a_multicast_one_does_not(server):
    for _ in range(300):
        server.frame()
        server.run(0.01)
    assert server.kinds.count(natnet.KEEP_ALIVE) == 4
    assert server.kinds.count(natnet.CONNECT) == 1
    assert server.kinds.count(natnet.ECHO_REQUEST) == 12 + 6
    other = Server(group="239.255.42.99")
    other.run(3.0)
    assert natnet.KEEP_ALIVE not in other.kinds


def test_after_silence_the_client_connects_again(server):
    server.frame()
    server.run(1.9)
    assert server.kinds.count(natnet.CONNECT) == 1
    server.run(1.2)
    assert server.kinds.count(natnet.CONNECT) in (2, 3)
    assert len(server.lines) == 3


@pytest.mark.parametrize(
    ("has", "by"),
    [
        ({}, "the middle of the exposure"),
        ({"exposed": False}, "the reception in the server"),
        ({"exposed": False, "received": False}, "the server's transmission"),
    ],
)
def test_a_frame_has_the_best_available_stamp(server, has, by):
    taken = server.frame(age_ms=8.0, **has)
    assert taken.t_capture_ns == pytest.approx(server.now - 8 * MS, abs=2000)
    assert taken.t_arrival_ns == server.now
    assert server.conversation.stamped_by == by
    assert server.lines[-1].startswith(f"frames are stamped by {by}")
    server.run(0.01)
    server.frame(**has)
    assert sum("are stamped by" in line for line in server.lines) == 1


def test_a_frame_without_stamps_is_rejected(server):
    assert server.frame(exposed=False, received=False, sent=False) is None
    assert server.conversation.counts.unstamped == 1
    assert "frames have no stamps" in server.conversation.complaint[1]


def test_a_stamp_in_the_future_becomes_the_arrival(server):
    taken = server.frame(age_ms=-3.0)
    assert taken.t_capture_ns == taken.t_arrival_ns == server.now
    assert server.conversation.counts.ahead == 1


def test_frames_before_the_clock_comparison_are_counted_and_dropped():
    server = Server()
    server.echoes = False
    server.run(1.0)
    assert server.frame() is None
    assert server.conversation.counts.early == 1
    server.echoes = True
    server.run(0.5)
    server.run(3.0)
    assert server.frame() is not None


def test_the_sequence_rises_with_gaps_and_across_a_restart(server):
    sequences = []
    for number in (7, 8, 11, 12, 3, 4, 900_000, 900_001):
        server.run(0.01)
        sequences.append(server.frame(number=number).sequence)
    assert sequences == [1, 2, 5, 6, 7, 8, 9, 10]
    assert server.conversation.counts.gaps == 2


def test_a_frame_that_is_not_newer_is_dropped(server):
    first = server.frame(age_ms=8.0)
    assert server.frame(age_ms=8.0, number=1) is None
    assert server.frame(age_ms=16.0, number=0) is None
    server.run(0.01)
    assert server.frame(number=2).sequence == first.sequence + 1
    assert server.conversation.counts.overtaken == 2


def test_frames_of_a_recording_are_rejected(server):
    assert server.frame(parameters=natnet.EDIT_MODE) is None
    assert server.conversation.counts.replayed == 1
    assert "press Live" in server.conversation.complaint[1]
    server.run(0.01)
    assert server.frame(parameters=1) is not None


def test_names_are_requested_again_after_a_change(server):
    server.ids = {"cart": 77}
    server.frame(parameters=natnet.MODELS_CHANGED)
    server.run(6.0)
    assert server.conversation.ids == {"cart": 77}
    assert server.kinds.count(natnet.REQUEST_MODELS) == 2


def test_a_restarted_server_with_another_clock_is_followed(server):
    server.frame()
    server.ahead_s = 3.0
    server.run(4.0)
    assert "the server restarted, or its clock was set: the clocks are compared again" in server.lines
    taken = server.frame(age_ms=5.0)
    assert taken.t_capture_ns == pytest.approx(server.now - 5 * MS, abs=150_000)


def test_an_unrequested_echo_is_ignored(server):
    before = server.conversation.clock.here_ns(0)
    for stamp in (1, 2, 3, 4):
        sent = natnet.message(natnet.ECHO_RESPONSE, struct.pack("<QQ", stamp, 5))
        server.conversation.receive(sent, server.now)
    assert server.conversation.clock.here_ns(0) == before


def test_a_malformed_datagram_is_counted_and_reported(server):
    assert server.conversation.receive(b"\7\0\1\0", server.now) is None
    assert server.conversation.counts.malformed == 1
    assert server.conversation.complaint == (
        server.now,
        "a datagram is malformed: message 7 declares 1 bytes and has 0",
    )
    assert server.frame() is not None


def test_a_newer_server_is_reported_and_asked_for_a_known_layout():
    server = Server(version=(4, 9))
    server.run(1.0)
    assert server.lines[1] == "NatNet 4.9 is newer than the newest tested version 4.4; requesting the layout of 4.1"
    assert server.kinds.count(natnet.REQUEST) == 1
    assert server.frame() is not None
