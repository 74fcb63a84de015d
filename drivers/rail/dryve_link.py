"""One TCP connection to a dryve D1: a request, its answer, then the next request."""

import asyncio
from typing import Self

from softarm.drivers.rail import dryve
from softarm.drivers.rail.dryve import Entry


class DryveLink:
    """Good for one connection; after any error but a DryveRefusal it is to be closed.

    `strays` counts answers with another request's transaction id: they are skipped, never believed. Nothing
    is ever sent twice.
    """

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, request_timeout_s: float) -> None:
        self.strays = 0
        self._reader, self._writer, self._timeout_s = reader, writer, request_timeout_s
        self._transaction = 0

    @classmethod
    async def open(cls, host: str, port: int, connect_timeout_s: float, request_timeout_s: float) -> Self:
        """Raises OSError, and TimeoutError (which is one) after `connect_timeout_s`."""
        async with asyncio.timeout(connect_timeout_s):
            reader, writer = await asyncio.open_connection(host, port)
        return cls(reader, writer, request_timeout_s)

    async def read(self, entry: Entry) -> int:
        """The entry's value. Raises as `_request` does."""
        return await self._request(entry, None)

    async def write(self, entry: Entry, value: int) -> None:
        """Set the entry. Raises as `_request` does."""
        await self._request(entry, value)

    def close(self) -> None:
        """Drop the connection at once, without waiting for what was not sent yet."""
        self._writer.transport.abort()

    async def _request(self, entry: Entry, value: int | None) -> int:
        """One exchange.

        Raises DryveRefusal (the drive said no), DryveMismatch or ValueError (nonsense), EOFError (the other
        side closed), TimeoutError or another OSError (no answer).
        """
        self._transaction = self._transaction % 255 + 1  # 1 to 255: what is known to work on real drives
        try:
            async with asyncio.timeout(self._timeout_s):
                self._writer.write(dryve.encode_request(self._transaction, entry, value))
                while True:
                    telegram = await dryve.read_telegram(self._reader)
                    if int.from_bytes(telegram[:2], "big") == self._transaction:
                        break
                    self.strays += 1
        except TimeoutError:
            verb = "read" if value is None else "write"
            strays = f" ({self.strays} answers to other requests)" if self.strays else ""
            raise TimeoutError(f"{verb} {entry}: no answer within {self._timeout_s} s{strays}") from None
        return dryve.decode_answer(telegram, self._transaction, entry, write=value is not None)
