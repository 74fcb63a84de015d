"""A rail connection with bad answers: it begins and ends with a stop, and tolerates one bad answer in motion."""

from typing import Any

import pytest

from softarm.drivers.rail import dryve
from softarm.drivers.rail.dryve import ModbusRequest
from tests.drivers.rail.conftest import Answer, refused

pytestmark = pytest.mark.anyio
STOP = ("60ff", bytes(4))
BAD_ANSWERS: dict[str, Answer] = {
    "refused": refused,
    "busy": lambda request: dryve.encode_exception(request.transaction, 6),
    "garbled": lambda request: bytes.fromhex("ffffffffffffffffff"),
    "another's": lambda request: (request.transaction ^ 0x5500).to_bytes(2, "big") + bytes.fromhex("00000003002b0d"),
    "cut short": lambda request: request.transaction.to_bytes(2, "big") + bytes.fromhex("00000003002b0d"),
    "none": lambda request: b"",
}


def ends(link: list[ModbusRequest]) -> tuple[Any, Any]:
    return tuple((f"{request.index:04x}", request.data) for request in (link[0], link[-1]))  # type: ignore[return-value]


@pytest.mark.parametrize("kind", BAD_ANSWERS)
async def test_a_connection_begins_and_ends_with_a_stop_despite_bad_answers(opened: Any, kind: str) -> None:
    async with opened(timeout_s=0.2) as bench:
        bench.faults.start("rail_keeps_going")
        await bench.enable()
        bench.drive.spoil(BAD_ANSWERS[kind])
        await bench.write_until(lambda: len(bench.drive.links) > 3, True, 0.3)
        assert [ends(link) for link in bench.drive.links[:3]] == [(STOP, STOP)] * 3
        bench.drive.script = None


async def test_a_healthy_connection_begins_and_ends_with_a_stop(bench: Any, until: Any) -> None:
    await bench.enable()
    await bench.stop()
    await until(lambda: ends(bench.drive.links[0]) == (STOP, STOP))


@pytest.mark.parametrize(
    ("kind", "entry"),
    [
        *((kind, dryve.STATUSWORD) for kind in BAD_ANSWERS),
        *((kind, dryve.TARGET_VELOCITY) for kind in ("refused", "none")),
        ("busy", dryve.POSITION),
    ],
)
async def test_one_bad_answer_does_not_end_a_connection_in_motion(bench: Any, kind: str, entry: dryve.Entry) -> None:
    await bench.enable(0.3)
    spoilt = bench.drive.spoil(BAD_ANSWERS[kind], entry, times=1)
    await bench.write_until(lambda: spoilt, True, 0.4)
    await bench.write_until(lambda: bench.axis.read().velocity_m_s == 0.4, True, 0.4)
    assert len(bench.drive.links) == 1
    assert bench.axis.read().enabled
    assert bench.axis.problem() is None


async def test_a_refused_set_point_is_sent_again_at_once(bench: Any) -> None:
    await bench.enable(0.3)
    spoilt = bench.drive.spoil(refused, dryve.TARGET_VELOCITY, times=1)
    bench.axis.write(True, 0.0)
    await bench.wait_until(lambda: spoilt and bench.drive.velocity_m_s == 0.0)


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
    bench.drive.spoil(refused, times=storm)
    await bench.write_until(lambda: len(bench.drive.requests) > began + storm, True, 0.3)
    await bench.write_until(lambda: bench.drive.velocity_m_s == 0.0, True, 0.3)
    after = [request for request, _ in bench.drive.requests[began + storm :]]
    stops = [request.index == 0x60FF and request.data == bytes(4) for request in after]
    assert stops.index(True) <= 1
