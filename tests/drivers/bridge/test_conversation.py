"""What is said with a server and what becomes of its frames, by clocks of the test's own."""

import struct

import pytest

from softarm.drivers.bridge import natnet
from softarm.drivers.bridge.conversation import Conversation
from softarm.drivers.twin import motive
from softarm.drivers.twin.motive import CLOCK_HZ, IDS

MS = 1_000_000
AHEAD_S = 1234.5  # of the server's clock
VERSION = (4, 1)


class Server:
    """Answers as Motive does, 0.1 ms each way, and streams."""

    def __init__(self, version=VERSION, group=None):
        self.version, self.group, self.lines, self.kinds = version, group, [], []
        self.talk = Conversation(self.lines.append)
        self.now = 50 * MS
        self.number = 0
        self.ahead_s, self.echoes, self.ids = AHEAD_S, True, dict(IDS)

    def ticks(self, now):
        return round((now / 1e9 + self.ahead_s) * CLOCK_HZ)

    def run(self, seconds, answers=True):
        """Have both talk for so long."""
        end = self.now + round(seconds * 1e9)
        while self.now < end:
            said = self.talk.due(self.now)
            for datagram in said:
                self.kinds.append(struct.unpack_from("<H", datagram)[0])
                if answers:
                    self.answer(datagram)
            self.now += 10 * MS

    def answer(self, datagram):
        kind = self.kinds[-1]
        if kind == natnet.CONNECT:
            self.talk.hear(motive.server_info(self.version, CLOCK_HZ, 1511, self.group), self.now)
        elif kind == natnet.REQUEST_MODELS:
            self.talk.hear(motive.models(self.version, self.ids), self.now)
        elif kind == natnet.ECHO_REQUEST and self.echoes:
            ticks = struct.pack("<Q", self.ticks(self.now + MS // 10))
            self.talk.hear(motive.message(natnet.ECHO_RESPONSE, datagram[4:] + ticks), self.now + MS // 5)

    def frame(self, age_ms=8.0, exposed=True, received=True, sent=True, parameters=0, number=None):
        """A frame that was taken so long ago."""
        self.number = self.number + 1 if number is None else number
        taken = self.ticks(self.now - round(age_ms * 1e6))
        later = taken + CLOCK_HZ // 200
        said = motive.frame(
            self.version, self.number, (), (taken * exposed, later * received, (later + 9) * sent), parameters
        )
        return self.talk.hear(said, self.now)


@pytest.fixture
def server():
    made = Server()
    made.run(1.0)
    return made


def test_it_connects_asks_for_names_and_for_the_clock(server):
    assert server.kinds[:4] == [natnet.CONNECT, natnet.KEEP_ALIVE, natnet.REQUEST_MODELS, natnet.ECHO_REQUEST]
    assert server.talk.ids == IDS
    assert server.kinds.count(natnet.ECHO_REQUEST) == 12  # ten of them at once
    assert server.lines == [
        "Motive 3.1.0.0 speaks NatNet 4.1, unicast, clock of 10000000 Hz",
        "the clocks are -1234.500 s apart, to 0.10 ms",
    ]


def test_a_server_that_does_not_answer_is_asked_every_second():
    server = Server()
    server.run(3.0, answers=False)
    assert server.kinds == [natnet.CONNECT] * 3
    server.run(1.0)
    assert server.talk.server is not None


def test_a_unicast_server_hears_every_second_that_somebody_listens_a_multicast_one_does_not(server):
    for _ in range(300):
        server.frame()
        server.run(0.01)
    assert server.kinds.count(natnet.KEEP_ALIVE) == 4
    assert server.kinds.count(natnet.CONNECT) == 1
    assert server.kinds.count(natnet.ECHO_REQUEST) == 12 + 6
    other = Server(group="239.255.42.99")
    other.run(3.0)
    assert natnet.KEEP_ALIVE not in other.kinds


def test_silence_is_answered_by_connecting_again(server):
    server.frame()
    server.run(1.9)
    assert server.kinds.count(natnet.CONNECT) == 1
    server.run(1.2)
    assert server.kinds.count(natnet.CONNECT) in (2, 3)
    assert len(server.lines) == 3  # the same server: nothing new to be told


@pytest.mark.parametrize(
    ("has", "by"),
    [
        ({}, "the middle of the exposure"),
        ({"exposed": False}, "its data in the server"),  # which came 5 ms after it was taken, as is counted
        ({"exposed": False, "received": False}, "its leaving the server"),
    ],
)
def test_a_frame_has_the_best_stamp_that_there_is(server, has, by):
    taken = server.frame(age_ms=8.0, **has)
    assert taken.t_capture_ns == pytest.approx(server.now - 8 * MS, abs=2000)
    assert taken.t_arrival_ns == server.now
    assert server.talk.stamped_by == by
    assert server.lines[-1].startswith(f"a frame is stamped by {by}")
    server.run(0.01)
    server.frame(**has)
    assert sum("is stamped by" in line for line in server.lines) == 1


def test_what_has_no_stamp_is_no_frame(server):
    assert server.frame(exposed=False, received=False, sent=False) is None
    assert server.talk.counts.unstamped == 1
    assert "without any stamp" in server.talk.complaint[1]


def test_no_frame_is_of_the_future(server):
    taken = server.frame(age_ms=-3.0)
    assert taken.t_capture_ns == taken.t_arrival_ns == server.now
    assert server.talk.counts.ahead == 1


def test_frames_before_the_clock_is_known_are_counted_and_left_out():
    server = Server()
    server.echoes = False
    server.run(1.0)
    assert server.frame() is None
    assert server.talk.counts.early == 1
    server.echoes = True
    server.run(0.5)  # questions that went unanswered are not waited for
    server.run(3.0)
    assert server.frame() is not None


def test_the_count_rises_with_gaps_and_over_a_server_that_counts_anew(server):
    sequences = []
    for number in (7, 8, 11, 12, 3, 4, 900_000, 900_001):
        server.run(0.01)
        sequences.append(server.frame(number=number).sequence)
    assert sequences == [1, 2, 5, 6, 7, 8, 9, 10]
    assert server.talk.counts.gaps == 2


def test_a_frame_that_is_no_newer_is_left_out(server):
    first = server.frame(age_ms=8.0)
    assert server.frame(age_ms=8.0, number=1) is None
    assert server.frame(age_ms=16.0, number=0) is None
    server.run(0.01)
    assert server.frame(number=2).sequence == first.sequence + 1
    assert server.talk.counts.overtaken == 2


def test_a_recording_that_is_played_is_no_arm(server):
    assert server.frame(parameters=natnet.EDIT_MODE) is None
    assert server.talk.counts.replayed == 1
    assert "press Live" in server.talk.complaint[1]
    server.run(0.01)
    assert server.frame(parameters=natnet.RECORDING) is not None


def test_names_are_asked_for_again_when_the_server_says_that_they_changed(server):
    server.ids = {"cart": 77}
    server.frame(parameters=natnet.MODELS_CHANGED)
    server.run(6.0)
    assert server.talk.ids == {"cart": 77}
    assert server.kinds.count(natnet.REQUEST_MODELS) == 2


def test_a_server_that_was_started_again_on_another_clock_is_followed(server):
    server.frame()
    server.ahead_s = 3.0
    server.run(4.0)
    assert "the server's clock was set, or it was started again: its stamps are told anew" in server.lines
    taken = server.frame(age_ms=5.0)
    assert taken.t_capture_ns == pytest.approx(server.now - 5 * MS, abs=150_000)


def test_an_echo_that_nobody_asked_for_tells_no_time(server):
    before = server.talk.clock.here_ns(0)
    for stamp in (1, 2, 3, 4):
        said = motive.message(natnet.ECHO_RESPONSE, struct.pack("<QQ", stamp, 5))
        server.talk.hear(said, server.now)
    assert server.talk.clock.here_ns(0) == before


def test_what_is_malformed_is_counted_and_complained_of(server):
    assert server.talk.hear(b"\7\0\1\0", server.now) is None
    assert server.talk.counts.malformed == 1
    assert server.talk.complaint == (server.now, "a malformed datagram: message 7 says 1 bytes and brings 0")
    assert server.frame() is not None


def test_a_newer_server_is_told_and_asked_for_frames_that_are_known():
    server = Server(version=(4, 9))
    server.run(1.0)
    assert server.lines[1] == "NatNet 4.9 is newer than what was tried (4.4), it is asked for 4.1"
    assert server.kinds.count(natnet.REQUEST) == 1
    assert server.frame() is not None
