"""What is said with a NatNet server, without the wire: connect and again, keep alive, names, echoes; frames stamped.

Whoever has the wire sends what `due` gives and hands `hear` what comes, each with the time of this host's clock.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from softarm.drivers.bridge import natnet
from softarm.drivers.bridge.clock import EchoClock
from softarm.drivers.bridge.frame import names_of
from softarm.drivers.bridge.natnet import Frame, Server
from softarm.schemas.bridge import Marks

AGAIN_NS = 1_000_000_000  # between two tries to connect, to keep alive, to hear names
SILENT_NS = 2_000_000_000  # without a frame for so long: connect again
NAMES_NS = 5_000_000_000  # asked again so often while one is missing
ECHO_FIRST_NS, ECHO_NS, FIRST_ECHOES = 20_000_000, 500_000_000, 10
ECHOES_OUT = 32  # questions that an answer may belong to
GAP_MAX = 1000  # frames; more is another count, not a loss
NEWEST = natnet.SUPPORTED[1]
LAYOUT = (4, 1)  # what a server newer than NEWEST is asked for

EXPOSED, RECEIVED, SENT = "the middle of the exposure", "its data in the server", "its leaving the server"


@dataclass
class Counts:
    """What came, and what did not become a frame of the daemon's."""

    frames: int = 0  # handed on
    gaps: int = 0  # that the server counted and that never came
    malformed: int = 0
    overtaken: int = 0  # no newer than the one before
    ahead: int = 0  # stamped later than they came, and handed on with the time they came
    early: int = 0  # before the clocks were known
    replayed: int = 0  # of a recording: Motive is in Edit mode
    unstamped: int = 0


class Taken(NamedTuple):
    """A frame, when it was taken by this host's clock, and its number in a count that always rises."""

    frame: Frame
    t_capture_ns: int
    t_arrival_ns: int
    sequence: int


class Conversation:
    """One server. `tell` hears what changes, a line each."""

    def __init__(self, tell: Callable[[str], None], received_after_s: float = 0.005) -> None:
        self.server: Server | None = None
        self.ids: dict[str, int] = {}
        self.counts = Counts()
        self.clock: EchoClock | None = None
        self.stamped_by: str | None = None
        self.complaint: tuple[int, str] | None = None  # when, and what
        self.wants_names = True  # asked again now and then while it is so
        self.frame_ns: int | None = None
        self._tell, self._received_after_ns = tell, round(received_after_s * 1e9)
        self._due = {"connect": 0, "keep": 0, "names": 0, "echo": 0}
        self._asked: deque[int] = deque(maxlen=ECHOES_OUT)
        self._echoes = self._restarts = self._sequence = 0
        self._asks_layout = False
        self._last_capture_ns = -1
        self._last_number: int | None = None

    @property
    def version(self) -> natnet.Version | None:
        """Of the layout of frames."""
        return None if self.server is None else min(self.server.version, NEWEST)

    def is_silent(self, now_ns: int) -> bool:
        """Whether no frame has come for long."""
        return self.frame_ns is None or now_ns - self.frame_ns > SILENT_NS

    def names_of(self, marks: Marks) -> tuple[dict[int, str], tuple[str, ...]]:
        """As `frame.names_of`, by the server's names; they are asked for as long as a body has none: it may be made."""
        names, missing = names_of(marks, self.ids)
        self.wants_names |= bool(missing)
        return names, missing

    def due(self, now_ns: int) -> list[bytes]:
        """What is to be said now; to be asked every 10 ms or so."""
        said = []
        if (self.server is None or self.is_silent(now_ns)) and self._is_due("connect", now_ns, AGAIN_NS):
            said.append(natnet.connect())
        if self.server is None:
            return said
        if self.server.group is None and self._is_due("keep", now_ns, AGAIN_NS):
            said.append(natnet.keep_alive())
        if self._asks_layout:
            self._asks_layout = False
            said.append(natnet.request_layout(LAYOUT))
        if self.wants_names and self._is_due("names", now_ns, AGAIN_NS if not self.ids else NAMES_NS):
            said.append(natnet.request_models())
        if self._is_due("echo", now_ns, ECHO_FIRST_NS if self._echoes < FIRST_ECHOES else ECHO_NS):
            self._asked.append(now_ns)
            said.append(natnet.echo(now_ns))
        return said

    def hear(self, datagram: bytes, now_ns: int) -> Taken | None:
        """Take what came; a frame that is good goes on. What is wrong is counted and complained of, never raised."""
        try:
            message = natnet.decode(datagram, self.version)
        except ValueError as error:
            self.counts.malformed += 1
            self.complaint = (now_ns, f"a malformed datagram: {error}")
            return None
        match message:
            case Server():
                self._meet(message, now_ns)
            case natnet.Models(ids):
                self.ids, self.wants_names = dict(ids), False
            case natnet.Echo(stamp, ticks):
                self._hear_echo(stamp, ticks, now_ns)
            case Frame():
                return self._take(message, now_ns)
        return None

    def _is_due(self, what: str, now_ns: int, period_ns: int) -> bool:
        if now_ns < self._due[what]:
            return False
        self._due[what] = now_ns + period_ns
        return True

    def _meet(self, server: Server, now_ns: int) -> None:
        if server == self.server:
            return
        app, version = ".".join(map(str, server.application)), ".".join(map(str, server.natnet[:2]))
        way = f"multicast to {server.group}:{server.data_port}" if server.group else "unicast"
        self._tell(f"{server.name} {app} speaks NatNet {version}, {way}, clock of {server.clock_hz} Hz")
        if server.version > NEWEST:
            self._asks_layout = server.group is None
            asked = f", it is asked for {LAYOUT[0]}.{LAYOUT[1]}" if self._asks_layout else ""
            self._tell(f"NatNet {version} is newer than what was tried ({NEWEST[0]}.{NEWEST[1]}){asked}")
        if self.server is None or server.clock_hz != self.server.clock_hz:
            self.clock, self._echoes, self._restarts = EchoClock(server.clock_hz), 0, 0
        self.server, self.wants_names = server, True
        self._due |= {"names": 0, "echo": 0, "keep": 0}

    def _hear_echo(self, stamp: int, ticks: int, now_ns: int) -> None:
        if self.clock is None or stamp not in self._asked:
            return
        self._asked.remove(stamp)
        self._echoes += 1
        was_ready = self.clock.is_ready
        self.clock.hear(stamp, now_ns, ticks)
        if self.clock.restarts > self._restarts:
            self._restarts, self._echoes = self.clock.restarts, 0
            self._tell("the server's clock was set, or it was started again: its stamps are told anew")
        elif self.clock.is_ready and not was_ready:
            self._tell(f"the clocks are {self.clock.offset_s:+.3f} s apart, to {1e3 * self.clock.uncertainty_s:.2f} ms")

    def _take(self, frame: Frame, now_ns: int) -> Taken | None:
        self.frame_ns = now_ns
        if frame.parameters & natnet.MODELS_CHANGED and not self.wants_names:
            self.wants_names = True
        if frame.parameters & natnet.EDIT_MODE:
            self.counts.replayed += 1
            self.complaint = (now_ns, "Motive plays a recording (Edit mode); press Live")
            return None
        if self.clock is None or not self.clock.is_ready:
            self.counts.early += 1
            return None
        captured_ns = self._captured(frame, self.clock)
        if captured_ns is None:
            self.counts.unstamped += 1
            self.complaint = (now_ns, "frames without any stamp; a NatNet server of 3.0 or newer stamps them")
            return None
        if captured_ns > now_ns:  # nothing is seen before it happens: the clocks are known no better
            self.counts.ahead += 1
            captured_ns = now_ns
        if captured_ns <= self._last_capture_ns:
            self.counts.overtaken += 1
            return None
        self._last_capture_ns = captured_ns
        return Taken(frame, captured_ns, now_ns, self._count(frame.number))

    def _captured(self, frame: Frame, clock: EchoClock) -> int | None:
        """When it was taken: the best of what the server says of it."""
        for ticks, what, before_ns in (
            (frame.exposed, EXPOSED, 0),
            (frame.received, RECEIVED, self._received_after_ns),
            (frame.sent, SENT, self._received_after_ns),
        ):
            if ticks:
                if what != self.stamped_by:
                    self.stamped_by = what
                    less = f", less {before_ns / 1e6:g} ms (received_after_s)" if before_ns else ""
                    self._tell(f"a frame is stamped by {what}{less}")
                return clock.here_ns(ticks) - before_ns
        return None

    def _count(self, number: int) -> int:
        step = 1 if self._last_number is None else number - self._last_number
        if not 0 < step <= GAP_MAX:  # the server counts anew
            step = 1
        self.counts.gaps += step - 1
        self.counts.frames += 1
        self._last_number = number
        self._sequence += step
        return self._sequence
