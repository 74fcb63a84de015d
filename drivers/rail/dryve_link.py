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
from softarm.drivers.rail.cia402 import ControlWord
from softarm.drivers.rail.dryve import Entry

STRAYS_MAX = 8  # answers to other requests that one exchange skips; more are a flood
MODE_MAX_S, MODE_AGAIN_S = 0.5, 0.02  # 6061h lags 6060h by up to a quarter of a second
ECHO_S = 0.02  # an answer that has come before: the right one is behind it, or the wire says the same again and again
CONNECT_S = 1.0
LINGER_S = 0.02  # waited for the other side to close, so that our last bytes are not cut off

# An exchange that failed on a connection that may still be good: refused, garbled or late.
EXCHANGE_ERRORS = (dryve.DryveRefusal, dryve.DryveMismatch, ValueError, TimeoutError)

# After one of these, these included, a connection is to be closed.
LINK_ERRORS = (
    OSError,
    EOFError,
    ValueError,
    OverflowError,  # units_per_m makes a number beyond 32 bits
    dryve.DryveMismatch,
    dryve.DryveRefusal,
)
_REMEDY = {
    errno.ECONNREFUSED: "switch on 'Modbus TCP Gateway' on the drive's web page (a restart may lose it)",
    errno.EHOSTUNREACH: "check the drive's supply, the cable, and drivers.rail.host",
    errno.ENETUNREACH: "give this host an address in the drive's network, or correct drivers.rail.host",
}

# Is the socket ready for one of these events (of `select.poll`) within so many seconds? Whoever waits for the drive may
# see to other things meanwhile.
Wait = Callable[[socket.socket, int, float], bool]


class DryveLink:
    """Good for one connection. Its first and its last bytes are a stop (60FFh = 0) that depends on no answer.

    After one of EXCHANGE_ERRORS the next request may be tried; after any other error it is to be closed. `strays`
    counts answers with another request's transaction id: they are skipped, never believed. After one to a request that
    was answered before, the right one is waited for no longer than `ECHO_S`. Nothing is sent twice.
    """

    def __init__(self, line: socket.socket, wait: Wait, request_timeout_s: float) -> None:
        """`line`: connected, or about to be, and not blocking."""
        self.strays = 0
        self._line, self._wait, self._timeout_s = line, wait, request_timeout_s
        self._telegrams = dryve.Telegrams()
        self._transaction = 0
        self._unanswered: set[int] = set()

    @classmethod
    def open(cls, address: tuple[str, int], wait: Wait, connect_timeout_s: float, request_timeout_s: float) -> Self:
        """Connect and say stop; whatever the drive answers, or nothing, is as well.

        Raises OSError, TimeoutError (which is one) after `connect_timeout_s`, and EOFError.
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
        """The entry's value. Raises as `_request` does."""
        return self._request(entry, None)

    def write(self, entry: Entry, value: int) -> None:
        """Set the entry. Raises as `_request` does."""
        self._request(entry, value)

    def configure(self, entry: Entry, value: int) -> str | None:
        """Set the entry and read it back; what is wrong, where the drive did not take it. Raises as `_request` does."""
        self.write(entry, value)
        actual = self.read(entry)
        return None if actual == value else f"{entry} reads {actual} after {value} was written"

    def configure_mode(self, mode: int, pause: Callable[[float], object]) -> str | None:
        """The same of the mode of operation, which the drive shows later. pause: lets so many seconds pass."""
        self.write(dryve.MODE, mode)
        until_s = time.monotonic() + MODE_MAX_S
        while (shown := self.read(dryve.MODE_DISPLAY)) != mode:
            if time.monotonic() > until_s:
                return f"{dryve.MODE_DISPLAY} stays at {shown} after {mode} was written"
            pause(MODE_AGAIN_S)
        return None

    def stop(self) -> None:
        """Say stop, whatever is outstanding, and wait for nothing. Raises OSError."""
        self._send(dryve.TARGET_VELOCITY, 0)

    def halt(self) -> None:
        """The same for a drive that was last seen in operation, in any mode. Raises OSError."""
        self._send(dryve.CONTROLWORD, ControlWord.ENABLE_AND_HALT)

    def close(self) -> None:
        """Say stop and hang up, in any state of the connection. Takes `LINGER_S` at most."""
        try:
            self.stop()
            self._line.shutdown(socket.SHUT_WR)
            # Unread answers would turn the end of the connection into a reset, which may overtake the stop.
            until_s = time.monotonic() + LINGER_S
            while (left_s := until_s - time.monotonic()) > 0 and _readable(self._line, left_s):
                if not self._line.recv(4096):
                    break
        except OSError:
            pass  # the connection is broken
        finally:
            self._line.close()

    def _send(self, entry: Entry, value: int | None) -> int:
        self._transaction = self._transaction % 255 + 1  # 1 to 255: what is known to work on real drives
        self._line.sendall(dryve.encode_request(self._transaction, entry, value))
        self._unanswered.add(self._transaction)
        return self._transaction

    def _request(self, entry: Entry, value: int | None) -> int:
        """One exchange.

        Raises DryveRefusal (the drive said no), DryveMismatch or ValueError (nonsense), EOFError (the other
        side closed), TimeoutError or another OSError (no answer).
        """
        transaction = self._send(entry, value)
        whole_s = until_s = time.monotonic() + self._timeout_s
        for _ in range(STRAYS_MAX + 1):
            telegram = self._next_telegram(until_s)
            if telegram is None:
                verb = "read" if value is None else "write"
                strays = f" ({self.strays} answers to other requests)" if self.strays else ""
                waited_s = self._timeout_s - max(0.0, whole_s - until_s)
                raise TimeoutError(f"{verb} {entry}: no answer within {waited_s:.2g} s{strays}")
            answered = int.from_bytes(telegram[:2], "big")
            if answered not in self._unanswered:
                until_s = min(until_s, time.monotonic() + ECHO_S)
            self._unanswered.discard(answered)
            if answered == transaction:
                return dryve.decode_answer(telegram, transaction, entry, write=value is not None)
            self.strays += 1
        raise dryve.DryveMismatch(f"{entry}: more than {STRAYS_MAX} answers to other requests in a row")

    def _next_telegram(self, until_s: float) -> bytes | None:
        while (telegram := self._telegrams.next()) is None:
            if not self._wait(self._line, select.POLLIN, until_s - time.monotonic()):
                return None
            data = self._line.recv(4096)
            if not data:
                raise EOFError("the other side closed the connection")
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


def _readable(line: socket.socket, seconds: float) -> bool:
    poll = select.poll()
    poll.register(line, select.POLLIN)
    return bool(poll.poll(seconds * 1e3))


def explained(error: Exception, connected: bool, then: str = "") -> tuple[str, str, str]:
    """One of LINK_ERRORS for people: what was being done, what went wrong, the next step; `then`: and what we do."""
    command = "converse" if connected else "connect"
    if isinstance(error, dryve.DryveRefusal):
        return "request", str(error), f"see the drive's manual{then}"
    if isinstance(error, EOFError):
        return command, "the drive closed the connection", "see that no other master is connected"
    number = error.errno if isinstance(error, OSError) else None
    if isinstance(error, TimeoutError) and not connected:
        number = errno.EHOSTUNREACH
    return command, str(error), _REMEDY.get(number or 0, f"check the cable{then}")
