"""One TCP connection to a dryve D1: a request, its answer, then the next request."""

import contextlib
import errno
import os
import select
import socket
import time
from collections.abc import Callable
from typing import Self

from softarm.drivers.rail import dryve
from softarm.drivers.rail.dryve import Entry

# Answers to other requests that one exchange skips.
SKIPPED_MAX = 8
# 6061h lags 6060h by up to a quarter of a second.
MODE_MAX_S, MODE_PAUSE_S = 0.5, 0.02
# After a repeated answer the right one follows at once, or the line repeats itself for ever.
ECHO_S = 0.02
CONNECT_S = 1.0
# Waited for the other side to close, so that the last bytes are not cut off.
LINGER_S = 0.02

# A failed exchange on a connection that may still be good: refused, garbled or late.
EXCHANGE_ERRORS = (dryve.DryveRefusal, dryve.DryveMismatch, ValueError, TimeoutError)

# All errors of a connection. OverflowError: units_per_m makes a number beyond 32 bits.
LINK_ERRORS = (OSError, EOFError, ValueError, OverflowError, dryve.DryveMismatch, dryve.DryveRefusal)
_REMEDY = {
    errno.ECONNREFUSED: "switch on 'Modbus TCP Gateway' on the drive's web page (a restart may lose it)",
    errno.EHOSTUNREACH: "check the drive's supply, the cable, and drivers.rail.host",
    errno.ENETUNREACH: "give this host an address in the drive's network, or correct drivers.rail.host",
}

# Returns whether the socket is ready for the events (of `select.poll`) within a number of seconds. The implementation
# may do other work while it waits.
Wait = Callable[[socket.socket, int, float], bool]


class DryveLink:
    """One TCP connection to the drive. Its first and last bytes are a stop (60FFh = 0) that needs no answer.

    After one of EXCHANGE_ERRORS the next request may be tried; after any other error the connection must be closed.
    `skipped` counts the skipped answers to other requests. After a repeated answer the right one must follow within
    `ECHO_S`. Nothing is sent twice.
    """

    def __init__(self, line: socket.socket, wait: Wait, request_timeout_s: float) -> None:
        """Use a non-blocking socket that is connected or connecting."""
        self.skipped = 0
        self._line, self._wait, self._timeout_s = line, wait, request_timeout_s
        self._telegrams = dryve.Telegrams()
        self._transaction = 0
        self._unanswered: set[int] = set()

    @classmethod
    def open(cls, address: tuple[str, int], wait: Wait, connect_timeout_s: float, request_timeout_s: float) -> Self:
        """Connect and send a stop, whose answer is ignored.

        Raises:
            OSError: No connection; TimeoutError after `connect_timeout_s`.
            EOFError: The drive closed the connection.
        """
        family, kind, protocol, _, where = socket.getaddrinfo(*address, type=socket.SOCK_STREAM)[0]
        line = socket.socket(family, kind | socket.SOCK_NONBLOCK, protocol)
        try:
            line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            _connect(line, where, wait, connect_timeout_s)
        except BaseException:
            line.close()
            raise
        link = cls(line, wait, request_timeout_s)
        try:
            with contextlib.suppress(*EXCHANGE_ERRORS):
                link.write(dryve.TARGET_VELOCITY, 0)
        except BaseException:
            link.close()
            raise
        return link

    def read(self, entry: Entry) -> int:
        """Return the entry's value. Raises one of LINK_ERRORS."""
        return self._request(entry, None)

    def write(self, entry: Entry, value: int) -> None:
        """Set the entry. Raises one of LINK_ERRORS."""
        self._request(entry, value)

    def configure(self, entry: Entry, value: int) -> str | None:
        """Set the entry, read it back and return the difference as text, or None. Raises one of LINK_ERRORS."""
        self.write(entry, value)
        actual = self.read(entry)
        return None if actual == value else f"{entry} reads {actual} after {value} was written"

    def configure_mode(self, mode: int, pause: Callable[[float], object]) -> str | None:
        """Set the mode of operation, wait until the drive shows it, and return the difference as text, or None."""
        self.write(dryve.MODE, mode)
        until_s = time.monotonic() + MODE_MAX_S
        while (shown := self.read(dryve.MODE_DISPLAY)) != mode:
            if time.monotonic() > until_s:
                return f"{dryve.MODE_DISPLAY} stays at {shown} after {mode} was written"
            pause(MODE_PAUSE_S)
        return None

    def close(self) -> None:
        """Send a stop and close the connection, in any state of it, within `LINGER_S`."""
        try:
            self.send(dryve.TARGET_VELOCITY, 0)
            self._line.shutdown(socket.SHUT_WR)
            # Unread answers would turn the close into a reset, which may overtake the stop.
            until_s = time.monotonic() + LINGER_S
            while (left_s := until_s - time.monotonic()) > 0 and is_ready(self._line, select.POLLIN, left_s):
                if not self._line.recv(4096):
                    break
        except OSError:
            pass
        finally:
            self._line.close()

    def send(self, entry: Entry, value: int | None) -> int:
        """Send a request without waiting for its answer, and return its transaction. Raises OSError."""
        # 1 to 255 are known to work on real drives.
        self._transaction = self._transaction % 255 + 1
        self._line.sendall(dryve.encode_request(self._transaction, entry, value))
        self._unanswered.add(self._transaction)
        return self._transaction

    def _request(self, entry: Entry, value: int | None) -> int:
        """Send one request and return its answer.

        Raises DryveRefusal (refused), DryveMismatch or ValueError (garbled), EOFError (closed by the drive),
        TimeoutError or another OSError (no answer).
        """
        transaction = self.send(entry, value)
        deadline_s = until_s = time.monotonic() + self._timeout_s
        for _ in range(SKIPPED_MAX + 1):
            telegram = self._next_telegram(until_s)
            if telegram is None:
                verb = "read" if value is None else "write"
                skipped = f" ({self.skipped} answers to other requests)" if self.skipped else ""
                waited_s = self._timeout_s - max(0.0, deadline_s - until_s)
                raise TimeoutError(f"{verb} {entry}: no answer within {waited_s:.2g} s{skipped}")
            answered = int.from_bytes(telegram[:2], "big")
            if answered not in self._unanswered:
                until_s = min(until_s, time.monotonic() + ECHO_S)
            self._unanswered.discard(answered)
            if answered == transaction:
                return dryve.decode_answer(telegram, transaction, entry, write=value is not None)
            self.skipped += 1
        raise dryve.DryveMismatch(f"{entry}: more than {SKIPPED_MAX} answers to other requests in a row")

    def _next_telegram(self, until_s: float) -> bytes | None:
        while (telegram := self._telegrams.next()) is None:
            if not self._wait(self._line, select.POLLIN, until_s - time.monotonic()):
                return None
            data = self._line.recv(4096)
            if not data:
                raise EOFError("the drive closed the connection")
            self._telegrams.feed(data)
        return telegram


def _connect(line: socket.socket, where: object, wait: Wait, timeout_s: float) -> None:
    try:
        line.connect(where)  # type: ignore[arg-type]
    except BlockingIOError:
        if not wait(line, select.POLLOUT, timeout_s):
            raise TimeoutError(f"no answer within {timeout_s} s") from None
        number = line.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if number:
            raise OSError(number, os.strerror(number)) from None


def is_ready(line: socket.socket, events: int, seconds: float) -> bool:
    """Return whether a socket is ready within a time: a `Wait` that does no other work."""
    poll = select.poll()
    poll.register(line, events)
    return bool(poll.poll(1e3 * max(0.0, seconds)))


def describe_error(error: Exception, connected: bool, then: str = "") -> tuple[str, str, str]:
    """Return the failed operation, the cause and the next step of one of LINK_ERRORS.

    `connected` is whether the connection existed when it failed, `then` the reaction of this program.
    """
    command = "communicate" if connected else "connect"
    if isinstance(error, dryve.DryveRefusal):
        return "request", str(error), f"see the drive's manual{then}"
    if isinstance(error, EOFError):
        return command, "the drive closed the connection", "disconnect any other master of the drive"
    number = error.errno if isinstance(error, OSError) else None
    if isinstance(error, TimeoutError) and not connected:
        number = errno.EHOSTUNREACH
    return command, str(error), _REMEDY.get(number or 0, f"check the cable{then}")
