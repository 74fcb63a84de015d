"""One TCP connection to a dryve D1: a request, its answer, then the next request."""

import asyncio
import contextlib
from typing import Self

from softarm.drivers.rail import dryve
from softarm.drivers.rail.dryve import Entry

STRAYS_MAX = 8  # answers to other requests that one exchange skips; more are a flood
LINGER_S = 0.02  # waited for the other side to close, so that our last bytes are not cut off

# An exchange that failed on a connection that may still be good: refused, garbled or late.
EXCHANGE_ERRORS = (dryve.DryveRefusal, dryve.DryveMismatch, ValueError, TimeoutError)


class DryveLink:
    """Good for one connection. Its first and its last bytes are a stop (60FFh = 0) that depends on no answer.

    After one of EXCHANGE_ERRORS the next request may be tried; after any other error it is to be closed. `strays`
    counts answers with another request's transaction id: they are skipped, never believed. Nothing is sent twice.
    """

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, request_timeout_s: float) -> None:
        self.strays = 0
        self._reader, self._writer, self._timeout_s = reader, writer, request_timeout_s
        self._telegrams = dryve.Telegrams(reader)
        self._transaction = 0

    @classmethod
    async def open(cls, host: str, port: int, connect_timeout_s: float, request_timeout_s: float) -> Self:
        """Connect and say stop; whatever the drive answers, or nothing, is as well.

        Raises OSError, TimeoutError (which is one) after `connect_timeout_s`, and EOFError.
        """
        async with asyncio.timeout(connect_timeout_s):
            reader, writer = await asyncio.open_connection(host, port)
        link = cls(reader, writer, request_timeout_s)
        try:
            with contextlib.suppress(*EXCHANGE_ERRORS):
                await link.write(dryve.TARGET_VELOCITY, 0)
        except BaseException:
            writer.transport.abort()
            raise
        return link

    async def read(self, entry: Entry) -> int:
        """The entry's value. Raises as `_request` does."""
        return await self._request(entry, None)

    async def write(self, entry: Entry, value: int) -> None:
        """Set the entry. Raises as `_request` does."""
        await self._request(entry, value)

    async def close(self) -> None:
        """Say stop and hang up, in any state of the connection. Takes `LINGER_S` at most."""
        try:
            self._send(dryve.TARGET_VELOCITY, 0)
            self._writer.write_eof()
            # Unread answers would turn the end of the connection into a reset, which may overtake the stop.
            async with asyncio.timeout(LINGER_S):
                while await self._reader.read(4096):
                    pass
        except OSError:
            pass  # the connection is broken, or the other side keeps it open
        finally:
            self._writer.transport.abort()

    def _send(self, entry: Entry, value: int | None) -> int:
        self._transaction = self._transaction % 255 + 1  # 1 to 255: what is known to work on real drives
        self._writer.write(dryve.encode_request(self._transaction, entry, value))
        return self._transaction

    async def _request(self, entry: Entry, value: int | None) -> int:
        """One exchange.

        Raises DryveRefusal (the drive said no), DryveMismatch or ValueError (nonsense), EOFError (the other
        side closed), TimeoutError or another OSError (no answer).
        """
        transaction = self._send(entry, value)
        try:
            async with asyncio.timeout(self._timeout_s):
                telegram = await self._answer_to(transaction, entry)
        except TimeoutError:
            verb = "read" if value is None else "write"
            strays = f" ({self.strays} answers to other requests)" if self.strays else ""
            raise TimeoutError(f"{verb} {entry}: no answer within {self._timeout_s} s{strays}") from None
        return dryve.decode_answer(telegram, transaction, entry, write=value is not None)

    async def _answer_to(self, transaction: int, entry: Entry) -> bytes:
        for _ in range(STRAYS_MAX + 1):
            telegram = await self._telegrams.next()
            if int.from_bytes(telegram[:2], "big") == transaction:
                return telegram
            self.strays += 1
        raise dryve.DryveMismatch(f"{entry}: more than {STRAYS_MAX} answers to other requests in a row")
