"""Motion capture over Zenoh: valid frames are read oldest first, others are counted and reported."""

import asyncio
import threading
from collections.abc import AsyncIterator, Callable
from typing import Any

import pytest
import zenoh

from softarm.drivers.mocap import payload as mocap_payload
from softarm.drivers.mocap.driver import ZenohMocapSource
from softarm.drivers.mocap.reception import RING
from softarm.drivers.mocap.zenoh_session import client, listener
from softarm.schemas.config import Mocap
from softarm.schemas.messages import BODY_NAMES, Pose

pytestmark = pytest.mark.anyio
POSES = tuple(Pose(0.1 * i, 0.9 - 0.1 * i, 0.01 * i) for i in range(len(BODY_NAMES)))


class Bridge:
    """Publisher of test samples in the driver's process."""

    def __init__(self, endpoint: str) -> None:
        self.session = zenoh.open(client(endpoint))

    def send(self, payload: bytes) -> None:
        # Zenoh may drop samples that arrive too fast; here the last one must arrive.
        self.session.put("softarm/mocap", payload, congestion_control=zenoh.CongestionControl.BLOCK)

    def frame(self, sequence: int, t_capture_ns: int) -> None:
        self.send(mocap_payload.encode(sequence, t_capture_ns, POSES))


@pytest.fixture
def config(free_port: int) -> Mocap:
    return Mocap(endpoint=f"tcp/127.0.0.1:{free_port}")


@pytest.fixture
async def source(config: Mocap, clock: Any, until: Any, running: Any) -> AsyncIterator[ZenohMocapSource]:
    source = ZenohMocapSource(config, clock)
    async with running(source):
        await until(lambda: "no frame yet" in (source.problem() or ""))
        yield source


@pytest.fixture
async def bridge(config: Mocap, source: ZenohMocapSource) -> AsyncIterator[Bridge]:
    bridge = await asyncio.to_thread(Bridge, config.endpoint)
    yield bridge
    bridge.session.close()


@pytest.fixture
def gather(source: ZenohMocapSource, clock: Any, until: Any) -> Callable[[int], Any]:
    """Read until a number of frames have arrived."""
    frames: list[Any] = []

    async def gather(count: int) -> list[Any]:
        await until(lambda: len(frames) >= count, lambda: frames.extend(source.read(clock())))
        return frames

    return gather


async def test_frames_arrive_in_order_with_the_stamps_of_capture_and_arrival(
    source: Any, bridge: Bridge, gather: Any, clock: Any
) -> None:
    bridge.frame(0, 10)
    await gather(1)
    for sequence in (1, 2, 4):
        bridge.frame(sequence, 10 + sequence)
    frames = await gather(4)
    assert [frame.sequence for frame in frames] == [0, 1, 2, 4]
    assert [frame.t_capture_ns for frame in frames] == [10, 11, 12, 14]
    assert {frame.t_receive_ns for frame in frames} == {clock()}
    assert frames[0].bodies == POSES
    assert source.problem() is None


async def test_a_frame_is_stamped_on_arrival_and_not_when_it_is_read(
    source: Any, bridge: Bridge, clock: Any, until: Any
) -> None:
    arrivals = []
    for sequence in (1, 2):
        bridge.frame(sequence, 10 + sequence)
        await until(lambda sequence=sequence: source.frames == sequence)
        arrivals.append(clock())
        clock.advance(0.033)
    frames = source.read(clock())
    assert [frame.t_receive_ns for frame in frames] == arrivals
    assert arrivals[0] < arrivals[1] < clock()


async def test_a_sample_that_is_too_long_is_counted_reported_and_never_parsed(
    source: Any, bridge: Bridge, gather: Any, until: Any, monkeypatch: Any
) -> None:
    whole = mocap_payload.encode(1, 10, POSES)
    bridge.send(whole + b" " * (mocap_payload.MAX_BYTES - len(whole)))
    await until(lambda: source.frames == 1)
    longer = mocap_payload.encode(2, 11, POSES)
    bridge.send(longer + b" " * (mocap_payload.MAX_BYTES + 1 - len(longer)))
    await until(lambda: source.malformed == 1)
    assert "a sample is malformed: 4097 bytes, at most 4096 are allowed (1 malformed" in source.problem()
    monkeypatch.setattr(mocap_payload, "decode", None)
    bridge.send(b"[" * 2_000_000)
    await until(lambda: source.malformed == 2)
    monkeypatch.undo()
    bridge.frame(3, 12)
    assert [frame.sequence for frame in await gather(2)] == [1, 3]


async def test_samples_are_parsed_off_the_control_loops_thread(bridge: Bridge, gather: Any, monkeypatch: Any) -> None:
    threads: list[int] = []

    def spy(*arguments: Any) -> Any:
        threads.append(threading.get_ident())
        return decode(*arguments)

    decode = mocap_payload.decode
    monkeypatch.setattr(mocap_payload, "decode", spy)

    bridge.frame(1, 10)
    await gather(1)
    assert threads
    assert threading.get_ident() not in threads


async def test_bad_samples_are_counted_and_reported_and_the_next_good_one_passes(
    source: Any, bridge: Bridge, gather: Any, clock: Any
) -> None:
    bridge.send(b"{}")
    bridge.frame(1, 10)
    await gather(1)
    assert source.malformed == 1
    assert "a sample is malformed: a frame must have exactly the fields" in source.problem()
    assert "docs/reference/wires.md" in source.problem()
    clock.advance(1.1)
    bridge.frame(2, 11)
    await gather(2)
    assert source.problem() is None


async def test_a_flood_keeps_the_newest_frames(bridge: Bridge, gather: Any) -> None:
    for sequence in range(10 * RING):
        bridge.frame(sequence, 100 + sequence)
    frames = await gather(1)
    while frames[-1].sequence != 10 * RING - 1:
        await gather(len(frames) + 1)
    sequences = [frame.sequence for frame in frames]
    assert sequences == sorted(set(sequences))


async def test_an_endpoint_in_use_is_reported_and_opened_when_it_is_free(
    config: Mocap, until: Any, running: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("softarm.drivers.mocap.driver.RETRY_S", 0.01)

    other = zenoh.open(listener(config.endpoint))
    source = ZenohMocapSource(config)
    async with running(source):
        await until(lambda: "Address already in use" in (source.problem() or ""))
        assert source.problem().startswith(f"{config.endpoint} softarm/mocap: listen: ")
        assert "stop the other daemon" in source.problem()
        assert source.read(1) == ()
        other.close()
        await until(lambda: "no frame yet" in (source.problem() or ""))


async def test_a_stopped_source_returns_no_frames_and_frees_the_endpoint(config: Mocap, until: Any) -> None:
    source = ZenohMocapSource(config)
    source.start()
    await until(lambda: "no frame yet" in (source.problem() or ""))
    await source.stop()
    assert source.read(1) == ()
    zenoh.open(listener(config.endpoint)).close()
