"""Protocol with a NatNet server, without I/O: connecting, keep-alive, names, echoes and stamps of frames.

The caller sends the datagrams of `due` and passes received ones to `receive`, each with the time of this host's clock.
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

# Period of attempts to connect, of keep-alives, and of the first requests for names.
RETRY_NS = 1_000_000_000
# Without a frame for so long the client connects again.
SILENT_NS = 2_000_000_000
# Period of requests for names while one is missing.
NAMES_NS = 5_000_000_000
ECHO_FIRST_NS, ECHO_NS, FIRST_ECHOES = 20_000_000, 500_000_000, 10
# Requests that an echo may belong to.
ECHOES_OUT = 32
# A larger step of the frame number is a new count, not a loss.
GAP_MAX = 1000
NEWEST = natnet.SUPPORTED[1]
# Layout that is requested from a server newer than NEWEST.
LAYOUT = (4, 1)

EXPOSED, RECEIVED, SENT = "the middle of the exposure", "the reception in the server", "the server's transmission"


@dataclass
class Counts:
    """Counts of frames and of rejected datagrams.

    frames: passed on. gaps: missing from the server's count. overtaken: not newer than the frame before. ahead:
    stamped after their arrival, passed on with the time of arrival. early: before the clocks were compared. replayed:
    from a recording (Motive in Edit mode).
    """

    frames: int = 0
    gaps: int = 0
    malformed: int = 0
    overtaken: int = 0
    ahead: int = 0
    early: int = 0
    replayed: int = 0
    unstamped: int = 0


class StampedFrame(NamedTuple):
    """Frame with its times on this host's clock, and its number in a count that always rises."""

    frame: Frame
    t_capture_ns: int
    t_arrival_ns: int
    sequence: int


class Conversation:
    """Connection to one server. `report` receives a line for each change; `complaint` is the last one with its time."""

    def __init__(self, report: Callable[[str], None], received_after_s: float = 0.005) -> None:
        self.server: Server | None = None
        self.ids: dict[str, int] = {}
        self.counts = Counts()
        self.clock: EchoClock | None = None
        self.stamped_by: str | None = None
        self.complaint: tuple[int, str] | None = None
        self.wants_names = True
        self.frame_ns: int | None = None
        self._report, self._received_after_ns = report, round(received_after_s * 1e9)
        self._due = {"connect": 0, "keep": 0, "names": 0, "echo": 0}
        self._asked: deque[int] = deque(maxlen=ECHOES_OUT)
        self._echoes = self._restarts = self._sequence = 0
        self._asks_layout = False
        self._last_capture_ns = -1
        self._last_number: int | None = None

    @property
    def version(self) -> natnet.Version | None:
        """Version of the layout of frames, None until the server has answered."""
        return None if self.server is None else min(self.server.version, NEWEST)

    def is_silent(self, now_ns: int) -> bool:
        """Return whether no frame has arrived for `SILENT_NS`."""
        return self.frame_ns is None or now_ns - self.frame_ns > SILENT_NS

    def names_of(self, marks: Marks) -> tuple[dict[int, str], tuple[str, ...]]:
        """Return `frame.names_of` by the server's names, which are requested again while a body is missing."""
        names, missing = names_of(marks, self.ids)
        self.wants_names |= bool(missing)
        return names, missing

    def due(self, now_ns: int) -> list[bytes]:
        """Return the datagrams to send now; call it about every 10 ms."""
        datagrams = []
        if (self.server is None or self.is_silent(now_ns)) and self._is_due("connect", now_ns, RETRY_NS):
            datagrams.append(natnet.connect())
        if self.server is None:
            return datagrams
        if self.server.group is None and self._is_due("keep", now_ns, RETRY_NS):
            datagrams.append(natnet.message(natnet.KEEP_ALIVE))
        if self._asks_layout:
            self._asks_layout = False
            datagrams.append(natnet.request_layout(LAYOUT))
        if self.wants_names and self._is_due("names", now_ns, RETRY_NS if not self.ids else NAMES_NS):
            datagrams.append(natnet.message(natnet.REQUEST_MODELS))
        if self._is_due("echo", now_ns, ECHO_FIRST_NS if self._echoes < FIRST_ECHOES else ECHO_NS):
            self._asked.append(now_ns)
            datagrams.append(natnet.echo(now_ns))
        return datagrams

    def receive(self, datagram: bytes, now_ns: int) -> StampedFrame | None:
        """Process a datagram and return its frame, if it is valid. Errors are counted and reported, never raised."""
        try:
            message = natnet.decode(datagram, self.version)
        except ValueError as error:
            self.counts.malformed += 1
            self.complaint = (now_ns, f"a datagram is malformed: {error}")
            return None
        match message:
            case Server():
                self._accept_server(message)
            case natnet.Models(ids):
                self.ids, self.wants_names = dict(ids), False
            case natnet.Echo(stamp, ticks):
                self._accept_echo(stamp, ticks, now_ns)
            case Frame():
                return self._stamp(message, now_ns)
        return None

    def _is_due(self, name: str, now_ns: int, period_ns: int) -> bool:
        if now_ns < self._due[name]:
            return False
        self._due[name] = now_ns + period_ns
        return True

    def _accept_server(self, server: Server) -> None:
        if server == self.server:
            return
        app, version = ".".join(map(str, server.application)), ".".join(map(str, server.natnet[:2]))
        way = f"multicast to {server.group}:{server.data_port}" if server.group else "unicast"
        self._report(f"{server.name} {app} uses NatNet {version}, {way}, clock of {server.clock_hz} Hz")
        if server.version > NEWEST:
            self._asks_layout = server.group is None
            request = f"; requesting the layout of {LAYOUT[0]}.{LAYOUT[1]}" if self._asks_layout else ""
            self._report(f"NatNet {version} is newer than the newest tested version {NEWEST[0]}.{NEWEST[1]}{request}")
        if self.server is None or server.clock_hz != self.server.clock_hz:
            self.clock, self._echoes, self._restarts = EchoClock(server.clock_hz), 0, 0
        self.server, self.wants_names = server, True
        self._due |= {"names": 0, "echo": 0, "keep": 0}

    def _accept_echo(self, stamp: int, ticks: int, now_ns: int) -> None:
        if self.clock is None or stamp not in self._asked:
            return
        self._asked.remove(stamp)
        self._echoes += 1
        was_ready = self.clock.is_ready
        self.clock.add(stamp, now_ns, ticks)
        if self.clock.restarts > self._restarts:
            self._restarts, self._echoes = self.clock.restarts, 0
            self._report("the server restarted, or its clock was set: the clocks are compared again")
        elif self.clock.is_ready and not was_ready:
            self._report(f"clock offset {self.clock.offset_s:+.3f} s +- {1e3 * self.clock.uncertainty_s:.2f} ms")

    def _stamp(self, frame: Frame, now_ns: int) -> StampedFrame | None:
        self.frame_ns = now_ns
        if frame.parameters & natnet.MODELS_CHANGED and not self.wants_names:
            self.wants_names = True
        if frame.parameters & natnet.EDIT_MODE:
            self.counts.replayed += 1
            self.complaint = (now_ns, "Motive plays a recording (Edit mode); press Live in Motive")
            return None
        if self.clock is None or not self.clock.is_ready:
            self.counts.early += 1
            return None
        captured_ns = self._captured(frame, self.clock)
        if captured_ns is None:
            self.counts.unstamped += 1
            self.complaint = (now_ns, "frames have no stamps; use a server with NatNet 3.0 or newer")
            return None
        # A stamp after the arrival is an error of the clock comparison.
        if captured_ns > now_ns:
            self.counts.ahead += 1
            captured_ns = now_ns
        if captured_ns <= self._last_capture_ns:
            self.counts.overtaken += 1
            return None
        self._last_capture_ns = captured_ns
        return StampedFrame(frame, captured_ns, now_ns, self._count(frame.number))

    def _captured(self, frame: Frame, clock: EchoClock) -> int | None:
        """Return the time of capture by the server's best stamp, or None without any."""
        for ticks, what, before_ns in (
            (frame.exposed, EXPOSED, 0),
            (frame.received, RECEIVED, self._received_after_ns),
            (frame.sent, SENT, self._received_after_ns),
        ):
            if ticks:
                if what != self.stamped_by:
                    self.stamped_by = what
                    less = f", less {before_ns / 1e6:g} ms (received_after_s)" if before_ns else ""
                    self._report(f"frames are stamped by {what}{less}")
                return clock.here_ns(ticks) - before_ns
        return None

    def _count(self, number: int) -> int:
        step = 1 if self._last_number is None else number - self._last_number
        # The server has restarted its count.
        if not 0 < step <= GAP_MAX:
            step = 1
        self.counts.gaps += step - 1
        self.counts.frames += 1
        self._last_number = number
        self._sequence += step
        return self._sequence
