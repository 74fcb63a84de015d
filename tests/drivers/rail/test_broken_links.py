"""A rail connection with bad answers: it begins and ends with a stop, and tolerates one bad answer in motion."""

from collections.abc import Callable
from typing import Any

import pytest

from softarm.drivers.rail import dryve
from softarm.drivers.rail.dryve import ModbusRequest

pytestmark = pytest.mark.anyio
STOP = ("60ff", bytes(4))
BAD_ANSWERS = {
    "refused": lambda t: dryve.encode_abort(t, 0x08000022),
    "busy": lambda t: dryve.encode_exception(t, 6),
    "garbled": lambda t: bytes.fromhex("ffffffffffffffffff"),
    "another's": lambda t: (t ^ 0x5500).to_bytes(2, "big") + bytes.fromhex("00000003002b0d"),
    "cut short": lambda t: t.to_bytes(2, "big") + bytes.fromhex("00000003002b0d"),
    "none": lambda t: b"",
}


def ends(link: list[ModbusRequest]) -> tuple[Any, Any]:
    return tuple((f"{request.index:04x}", request.data) for request in (link[0], link[-1]))  # type: ignore[return-value]


@pytest.mark.parametrize("kind", BAD_ANSWERS)
async def test_a_connection_begins_and_ends_with_a_stop_despite_bad_answers(opened: Any, kind: str) -> None:
    async with opened(timeout_s=0.2) as bench:
        bench.faults.start("rail_keeps_going")
        await bench.enable()
        bench.drive.script = lambda telegram, _: BAD_ANSWERS[kind](int.from_bytes(telegram[:2], "big"))
        await bench.write_until(lambda: len(bench.drive.links) > 3, True, 0.3)
        assert [ends(link) for link in bench.drive.links[:3]] == [(STOP, STOP)] * 3
        bench.drive.script = None


async def test_a_healthy_connection_begins_and_ends_with_a_stop(bench: Any, until: Any) -> None:
    await bench.enable()
    await bench.stop()
    await until(lambda: ends(bench.drive.links[0]) == (STOP, STOP))


@pytest.mark.parametrize(
    ("kind", "index"),
    [*((kind, 0x6041) for kind in BAD_ANSWERS), ("refused", 0x60FF), ("none", 0x60FF), ("busy", 0x6064)],
)
async def test_one_bad_answer_does_not_end_a_connection_in_motion(opened: Any, kind: str, index: int) -> None:
    async with opened(timeout_s=1.0) as bench:
        await bench.enable(0.3)
        spoilt: list[int] = []

        def spoil(telegram: bytes, answer: Callable[[], bytes]) -> bytes:
            if int.from_bytes(telegram[12:14], "big") == index and not spoilt:
                spoilt.append(index)
                return BAD_ANSWERS[kind](int.from_bytes(telegram[:2], "big"))
            return answer()

        bench.drive.script = spoil
        await bench.write_until(lambda: spoilt, True, 0.4)
        await bench.write_until(lambda: bench.axis.read().velocity_m_s == 0.4, True, 0.4)
        assert len(bench.drive.links) == 1
        assert bench.axis.read().enabled
        assert bench.axis.problem() is None


async def test_a_refused_set_point_is_sent_again_at_once(bench: Any) -> None:
    await bench.enable(0.3)
    refused: list[int] = []

    def refuse(telegram: bytes, answer: Callable[[], bytes]) -> bytes:
        if telegram[12:14].hex() == "60ff" and telegram[9] and not refused:
            refused.append(1)
            return dryve.encode_abort(int.from_bytes(telegram[:2], "big"), 0x08000022)
        return answer()

    bench.drive.script = refuse
    bench.axis.write(True, 0.0)
    await bench.wait_until(lambda: refused and bench.drive.velocity_m_s == 0.0)


@pytest.mark.slow
# Numbers of telegrams; the connection ends within the longer ones.
@pytest.mark.parametrize("storm", [3, 40, 150])
async def test_a_cart_in_motion_is_stopped_as_soon_as_refusals_end(
    bench: Any, storm: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("softarm.drivers.rail.master.RETRY_S", (0.005, 60.0))

    bench.faults.start("rail_keeps_going")
    await bench.enable(0.3)
    began = len(bench.drive.requests)

    def refuse(telegram: bytes, answer: Callable[[], bytes]) -> bytes:
        if len(bench.drive.requests) <= began + storm:
            return dryve.encode_abort(int.from_bytes(telegram[:2], "big"), 0x08000022)
        return answer()

    bench.drive.script = refuse
    await bench.write_until(lambda: len(bench.drive.requests) > began + storm, True, 0.3)
    await bench.write_until(lambda: bench.drive.velocity_m_s == 0.0, True, 0.3)
    after = [request for request, _ in bench.drive.requests[began + storm :]]
    stops = [request.index == 0x60FF and request.data == bytes(4) for request in after]
    assert stops.index(True) <= 1
