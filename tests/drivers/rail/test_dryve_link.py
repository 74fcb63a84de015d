"""One connection: what is not ours is bounded, and the loop goes on meanwhile."""

import asyncio
import select
import socket
from collections.abc import Callable
from typing import Any

import pytest

from softarm.drivers.rail import dryve
from softarm.drivers.rail.dryve_link import EXCHANGE_ERRORS, STRAYS_MAX, DryveLink

STRAY = bytes.fromhex("77770000000d002b0d01000060ff0000000000")


@pytest.fixture
def linked(run: Any) -> Callable[..., None]:
    """Run `script(link)` against a drive whose answer to the n-th telegram, from 0, is `answers(n, telegram)`."""

    async def play(script: Any, answers: Callable[[int, bytes], bytes]) -> None:
        async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            telegrams, number = dryve.Telegrams(), 0
            while data := await reader.read(4096):
                telegrams.feed(data)
                while (telegram := telegrams.next()) is not None:
                    writer.write(answers(number, telegram))
                    number += 1
            writer.close()

        def talk(port: int) -> None:
            link = DryveLink.open(("127.0.0.1", port), wait, 1.0, 5.0)
            script(link)
            link.close()

        async with await asyncio.start_server(serve, "127.0.0.1", 0) as server:
            await asyncio.to_thread(talk, server.sockets[0].getsockname()[1])

    return lambda script, answers: run(play(script, answers))


def wait(line: socket.socket, events: int, seconds: float) -> bool:
    poll = select.poll()
    poll.register(line, events)
    return bool(poll.poll(seconds * 1e3))


def acknowledge(telegram: bytes) -> bytes:
    return dryve.encode_acknowledgement(dryve.decode_request(telegram))


def test_a_flood_of_answers_to_other_requests_ends_an_exchange_long_before_its_time(linked: Any) -> None:
    def script(link: DryveLink) -> None:
        with pytest.raises(dryve.DryveMismatch, match=r"60FFh:0 .*: more than 8 answers to other requests in a row"):
            link.write(dryve.TARGET_VELOCITY, 1)
        assert link.strays == STRAYS_MAX + 1

    linked(script, lambda number, telegram: STRAY * 2000 if number == 1 else acknowledge(telegram))


def test_a_few_strays_are_skipped(linked: Any) -> None:
    def script(link: DryveLink) -> None:
        link.write(dryve.TARGET_VELOCITY, 1)
        link.write(dryve.TARGET_VELOCITY, 2)
        assert link.strays == 3 * STRAYS_MAX  # the stop at the start had some too

    linked(script, lambda _, telegram: STRAY * STRAYS_MAX + acknowledge(telegram))


def test_an_exchange_after_a_garbled_one_is_whole(linked: Any) -> None:
    def script(link: DryveLink) -> None:
        with pytest.raises(EXCHANGE_ERRORS):
            link.write(dryve.TARGET_VELOCITY, 1)
        link.write(dryve.TARGET_VELOCITY, 2)

    linked(script, lambda number, telegram: b"\xff" * 23 if number == 1 else acknowledge(telegram))
