"""The web server over a real socket, in a thread of its own, and the stream of snapshots."""

import asyncio
import json
import signal
import socket
import time
from contextlib import ExitStack
from dataclasses import replace

import httpx
import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect as connect_sync

from softarm.daemon.api.server import ApiError, ApiServer
from softarm.schemas.config import Api

LOCAL = "http://127.0.0.1"


def test_the_server_answers_and_gives_its_port_back(loop, app, serving):
    with serving(app(loop)) as port:
        assert httpx.get(f"{LOCAL}:{port}/api/status").json()["mode"] == "armed"
    with pytest.raises(httpx.ConnectError):
        httpx.get(f"{LOCAL}:{port}/api/status")


def test_a_port_that_is_taken_is_refused_with_the_next_step(loop, app, serving):
    made = app(loop)
    with serving(made) as port, pytest.raises(ApiError) as refusal:
        ApiServer(Api(port=port), made).start()
    assert f"api.host 127.0.0.1, api.port {port}: cannot listen there" in str(refusal.value)
    assert "choose another api.port" in str(refusal.value)
    with pytest.raises(ApiError, match=r"api\.host 192\.0\.2\.1"):
        ApiServer(Api(host="192.0.2.1", port=0), made).start()


def test_the_server_takes_no_signals(loop, app, serving):
    before = {s: signal.getsignal(s) for s in (signal.SIGINT, signal.SIGTERM)}
    with serving(app(loop)):
        assert {s: signal.getsignal(s) for s in before} == before


def test_the_stream_sends_new_snapshots_at_the_rate_asked_for(loop, app, serving):
    async def watch(port: int, query: str) -> tuple[list[int], float]:
        async with connect(f"ws://127.0.0.1:{port}/api/stream{query}") as socket:
            await socket.recv()
            started = time.monotonic()
            ticks = [json.loads(await socket.recv())["tick"] for _ in range(8)]
            return ticks, time.monotonic() - started

    async def both(port: int):
        return await asyncio.gather(watch(port, ""), watch(port, "?hz=10"))

    with serving(app(loop)) as port:  # the loop ticks at about 100 Hz
        (fast, fast_s), (slow, slow_s) = asyncio.run(both(port))
    assert fast == sorted(set(fast))
    assert slow == sorted(set(slow))
    assert fast_s >= 8 * 0.8 / 30
    assert slow_s >= 8 * 0.08
    assert slow[-1] - slow[0] > fast[-1] - fast[0]


@pytest.mark.parametrize("hz", ["0", "-1", "31", "nan", "fast"])
def test_the_stream_refuses_a_rate_it_does_not_have(loop, hz, app, serving):
    with (
        serving(app(loop)) as port,
        pytest.raises((InvalidStatus, ConnectionClosed)),
        connect_sync(f"ws://127.0.0.1:{port}/api/stream?hz={hz}") as socket,
    ):
        socket.recv(timeout=5)


def test_a_client_that_does_not_read_holds_up_nobody_and_piles_nothing_up(loop, app, serving):
    loop.outputs = replace(loop.outputs, clamps=("x" * 1_000_000,))
    with serving(app(loop)) as port, ExitStack() as stack:
        address = f"ws://127.0.0.1:{port}/api/stream"
        pipe = small_pipe(port)
        deaf = stack.enter_context(connect_sync(address, sock=pipe, max_size=None, max_queue=1, close_timeout=0.2))
        good = stack.enter_context(connect_sync(address, max_size=None))
        seen = [json.loads(good.recv(timeout=5))["tick"] for _ in range(40)]
        in_the_pipe = 0
        while json.loads(deaf.recv(timeout=5))["tick"] <= seen[-1]:
            in_the_pipe += 1
    assert in_the_pipe < 20  # of 40: what the sender's system had buffered (4 MB), and then the present


def small_pipe(port: int) -> socket.socket:
    """A connection whose receiving side holds little: left to itself, a system may buffer 32 MB of it."""
    pipe = socket.socket()
    pipe.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 65536)
    pipe.connect(("127.0.0.1", port))
    return pipe


@pytest.mark.parametrize("reading", [True, False])
def test_stopping_closes_open_streams_at_once(loop, reading, app, serving):
    with ExitStack() as stack:
        with serving(app(loop)) as port:  # which checks how long that takes
            address = f"ws://127.0.0.1:{port}/api/stream"
            good = stack.enter_context(connect_sync(address, max_size=None))
            other = stack.enter_context(connect_sync(address, max_size=None, max_queue=1, close_timeout=0.2))
            other.recv(timeout=5)
            if not reading:
                loop.outputs = replace(loop.outputs, clamps=("x" * 1_000_000,))
            for _ in range(3 if reading else 30):
                good.recv(timeout=5)
        with pytest.raises(ConnectionClosed):
            drain(good)


def drain(socket) -> None:
    while True:
        socket.recv(timeout=5)
