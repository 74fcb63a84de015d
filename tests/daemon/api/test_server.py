"""Web server over a real socket in its own thread, and the stream of snapshots."""

import json
import signal
import socket
import time
from contextlib import ExitStack, suppress
from dataclasses import replace

import httpx
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect as connect_sync

from softarm.daemon.access.sockets import ApiError
from softarm.daemon.api.endpoints.observation import Pace
from softarm.daemon.api.server import ApiServer
from softarm.schemas.config import Api

LOCAL = "http://127.0.0.1"
WAIT_S = 60  # only a server that hangs takes so long, even on a busy machine


def test_the_server_answers_and_releases_its_port(plain, serving):
    with serving(plain) as port:
        assert httpx.get(f"{LOCAL}:{port}/api/status").json()["mode"] == "armed"
    with pytest.raises(httpx.ConnectError):
        httpx.get(f"{LOCAL}:{port}/api/status")


def test_a_port_that_is_taken_is_refused_with_the_next_step(loop, app, serving):
    made = app(loop)
    with serving(made) as port, pytest.raises(ApiError) as refusal:
        ApiServer(Api(port=port), made).start()
    assert f"api.host 127.0.0.1, api.port {port}: cannot listen there" in str(refusal.value)
    assert "choose another api.port" in str(refusal.value)


def test_the_server_takes_no_signals(plain, serving):
    before = {s: signal.getsignal(s) for s in (signal.SIGINT, signal.SIGTERM)}
    with serving(plain):
        assert {s: signal.getsignal(s) for s in before} == before


@pytest.mark.slow
def test_the_stream_sends_new_snapshots_at_the_rate_asked_for(plain, serving):
    with serving(plain) as port:
        for query, hz in (("", 30), ("?hz=10", 10)):
            with connect_sync(f"ws://127.0.0.1:{port}/api/stream{query}") as socket:
                socket.recv(timeout=WAIT_S)
                started = time.monotonic()
                ticks = [json.loads(socket.recv(timeout=WAIT_S))["tick"] for _ in range(8)]
                lasted_s = time.monotonic() - started
            assert ticks == sorted(set(ticks))
            assert lasted_s >= 8 * 0.8 / hz  # the loop ticks at about 100 Hz


def sent_in(pace: Pace, ticks_hz: float, seconds: float) -> list[int]:
    """Return the numbers of sent ticks; the sender polls every 5 ms, ticks come up to 2 ms late."""
    sent, now_s, late_s = [], 0.0, (0.0, 0.002, 0.0005, 0.001)
    while now_s < seconds:
        tick = int(now_s * ticks_hz)
        is_there = tick / ticks_hz + late_s[tick % 4] <= now_s
        if pace.wait_s(now_s) <= 0 and is_there and tick not in sent[-1:]:
            sent.append(tick)
            pace.sent(now_s)
        now_s += 0.005
    return sent


@pytest.mark.parametrize(("hz", "ticks_hz"), [(30, 30), (10, 30), (20, 30), (7, 30), (30, 100), (0.5, 30)])
def test_the_stream_has_the_requested_rate(hz, ticks_hz):
    sent = sent_in(Pace(hz), ticks_hz, 60)
    assert len(sent) == pytest.approx(60 * hz, abs=1.01)
    if hz == ticks_hz:
        assert sent == list(range(len(sent)))  # every tick


def test_the_stream_refuses_an_unsupported_rate(plain, serving):
    with serving(plain) as port:
        for hz in ("0", "-1", "1e-310", "0.009", "31", "nan", "fast"):
            with pytest.raises(InvalidStatus) as refusal:
                connect_sync(f"ws://127.0.0.1:{port}/api/stream?hz={hz}")
            assert refusal.value.response.status_code == 422
            assert f"hz: is '{hz}'; allowed 0.01 to 30".encode() in refusal.value.response.body


def test_streams_are_limited_and_an_ended_one_makes_room(plain, serving, monkeypatch):
    monkeypatch.setattr("softarm.daemon.api.endpoints.observation.STREAMS_MAX", 2)
    with serving(plain) as port, ExitStack() as stack:
        address = f"ws://127.0.0.1:{port}/api/stream"
        first, second = (stack.enter_context(connect_sync(address)) for _ in range(2))
        first.recv(timeout=WAIT_S), second.recv(timeout=WAIT_S)
        with pytest.raises(InvalidStatus) as refusal:
            connect_sync(address)
        assert refusal.value.response.status_code == 503
        assert b"2 clients already have a stream" in refusal.value.response.body
        first.close()
        while True:
            with suppress(InvalidStatus):  # the server may still be hearing of it
                stack.enter_context(connect_sync(address)).recv(timeout=WAIT_S)
                break


@pytest.mark.slow
def test_a_client_that_does_not_read_delays_no_other_and_gets_no_backlog(loop, plain, serving):
    loop.outputs = replace(loop.outputs, clamps=("x" * 1_000_000,))
    with serving(plain) as port, ExitStack() as stack:
        address = f"ws://127.0.0.1:{port}/api/stream"
        pipe = small_pipe(port)
        deaf = stack.enter_context(connect_sync(address, sock=pipe, max_size=None, max_queue=1, close_timeout=0.2))
        good = stack.enter_context(connect_sync(address, max_size=None))
        seen = [json.loads(good.recv(timeout=WAIT_S))["tick"] for _ in range(40)]
        in_the_pipe = 0
        while json.loads(deaf.recv(timeout=WAIT_S))["tick"] <= seen[-1]:
            in_the_pipe += 1
    assert in_the_pipe < 20  # of 40: what the sender's system had buffered (4 MB), and then the present


def small_pipe(port: int) -> socket.socket:
    """Return a connection with a small receive buffer; by default it may hold 32 MB."""
    pipe = socket.socket()
    pipe.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 65536)
    pipe.connect(("127.0.0.1", port))
    return pipe


@pytest.mark.slow
@pytest.mark.parametrize("reading", [True, False])
def test_stopping_closes_open_streams_at_once(loop, reading, plain, serving):
    with ExitStack() as stack:
        with serving(plain) as port:  # which checks how long that takes
            address = f"ws://127.0.0.1:{port}/api/stream"
            good = stack.enter_context(connect_sync(address, max_size=None))
            other = stack.enter_context(connect_sync(address, max_size=None, max_queue=1, close_timeout=0.2))
            other.recv(timeout=WAIT_S)
            if not reading:
                loop.outputs = replace(loop.outputs, clamps=("x" * 1_000_000,))
            for _ in range(3 if reading else 30):
                good.recv(timeout=WAIT_S)
        with pytest.raises(ConnectionClosed):
            drain(good)


def drain(socket) -> None:
    while True:
        socket.recv(timeout=WAIT_S)
