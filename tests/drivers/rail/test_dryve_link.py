"""One connection to the drive: answers to other requests are skipped within bounds."""

import asyncio
import time
from collections.abc import Callable
from typing import Any

import pytest

from softarm.drivers.rail import dryve
from softarm.drivers.rail.dryve_link import SKIPPED_MAX, DryveLink, is_ready

PATIENCE_S = 5.0
OTHER = bytes.fromhex("77770000000d002b0d01000060ff0000000000")


@pytest.fixture
def linked() -> Callable[..., None]:
    """Run `script(link)` against a drive whose answer to the n-th telegram, from 0, is `answers(n, telegram)`."""

    async def play(script: Any, answers: Callable[[int, bytes], bytes], timeout_s: float) -> None:
        async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            telegrams, number = dryve.Telegrams(), 0
            while data := await reader.read(4096):
                telegrams.feed(data)
                while (telegram := telegrams.next()) is not None:
                    writer.write(answers(number, telegram))
                    number += 1
            writer.close()

        def talk(port: int) -> None:
            link = DryveLink.open(("127.0.0.1", port), is_ready, 1.0, timeout_s)
            script(link)
            link.close()

        async with await asyncio.start_server(serve, "127.0.0.1", 0) as server:
            await asyncio.to_thread(talk, server.sockets[0].getsockname()[1])

    return lambda script, answers, timeout_s=PATIENCE_S: asyncio.run(play(script, answers, timeout_s))


def acknowledge(telegram: bytes) -> bytes:
    return dryve.encode_acknowledgement(dryve.decode_request(telegram))


def test_many_answers_to_other_requests_end_an_exchange_before_its_timeout(linked: Any) -> None:
    def script(link: DryveLink) -> None:
        with pytest.raises(dryve.DryveMismatch, match=r"60FFh:0 .*: more than 8 answers to other requests in a row"):
            link.write(dryve.TARGET_VELOCITY, 1)
        assert link.skipped == SKIPPED_MAX + 1

    linked(script, lambda number, telegram: OTHER * 2000 if number == 1 else acknowledge(telegram))


def test_a_few_answers_to_other_requests_are_skipped(linked: Any) -> None:
    def script(link: DryveLink) -> None:
        link.write(dryve.TARGET_VELOCITY, 1)
        link.write(dryve.TARGET_VELOCITY, 2)
        assert link.skipped == 3 * SKIPPED_MAX

    linked(script, lambda _, telegram: OTHER * SKIPPED_MAX + acknowledge(telegram))


def test_a_line_that_repeats_one_answer_fails_before_the_timeout(linked: Any) -> None:
    began_s = time.monotonic()

    def script(link: DryveLink) -> None:
        link.write(dryve.TARGET_VELOCITY, 1)
        with pytest.raises(TimeoutError, match=r"write 60FFh:0 .*: no answer within 0.02\d* s \(1 answers to other"):
            link.write(dryve.TARGET_VELOCITY, 2)
        assert time.monotonic() - began_s < 0.5 * PATIENCE_S

    first = []

    def repeat(_: int, telegram: bytes) -> bytes:
        first.append(acknowledge(telegram))
        return first[min(len(first) - 1, 1)]

    linked(script, repeat)


def test_a_late_answer_does_not_shorten_the_next_exchange(linked: Any) -> None:
    late = []

    def delay(number: int, telegram: bytes) -> bytes:
        late.append(acknowledge(telegram))
        return b"" if number == 0 else late[number - 1] + (late[number] if number == 2 else b"")

    def script(link: DryveLink) -> None:
        with pytest.raises(TimeoutError, match=r"no answer within 0.1 s \(1 answers to other"):
            link.write(dryve.TARGET_VELOCITY, 1)
        link.write(dryve.TARGET_VELOCITY, 2)

    linked(script, delay, timeout_s=0.1)
