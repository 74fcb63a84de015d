"""Ten thousand page reloads leave nothing behind, and a whole daemon shows the arm."""

import asyncio
import gc
import json
import os
import threading
import time
from dataclasses import replace

import httpx
import pytest
from websockets.sync.client import connect

from softarm.daemon.assembly import Daemon
from softarm.daemon.logbook.recent import Recent
from softarm.daemon.runtime.devices import simulated_devices
from softarm.schemas.config import Config
from softarm.schemas.messages import BODY_NAMES
from tests.processes import WAIT_S

LOADED = ("/", "/api/robot", "/api/recent", "/api/status")


@pytest.fixture
def recent(silent):
    """Return an application whose history holds a minute."""
    made = Recent(time.monotonic_ns, time.time_ns)
    for tick in range(1800):
        made.take(replace(silent[1].outputs, tick=tick, t_ns=tick * 33_333_333))
    return made


@pytest.mark.prove
def test_ten_thousand_reloads_leave_nothing_behind(silent, app, recent):
    made = app(silent[1], recent=recent)

    async def grown(client: httpx.AsyncClient, times: int) -> tuple[int, int, int]:
        """Request the more expensive endpoints often enough that one leak each would show."""
        for number in range(times):
            for path in LOADED if number % 8 == 0 else LOADED[:1]:
                assert (await client.get(path)).status_code == 200
        gc.collect()
        return len(gc.get_objects()), len(os.listdir("/proc/self/fd")), threading.active_count()

    async def both():
        transport = httpx.ASGITransport(made)
        async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1") as client:
            return await grown(client, 500), await grown(client, 9500)

    (objects, descriptors, threads), (objects_later, descriptors_later, threads_later) = asyncio.run(both())
    assert objects_later - objects < 1000  # one of what is asked for least would be 1187
    assert (descriptors_later, threads_later) == (descriptors, threads)


@pytest.mark.slow
def test_a_whole_daemon_shows_the_arm_and_keeps_its_last_minutes(tmp_path, monkeypatch):
    asked: list[int] = []
    monkeypatch.setattr("softarm.common.realtime._set", asked.append)
    config = Config(api={"port": 0}, recorder={"directory": tmp_path}, control={"policy": "hold"})
    daemon = Daemon(config, simulated_devices())
    assert asked == []  # threads keep the priority of the thread that starts them
    with daemon, httpx.Client(base_url=daemon.url, trust_env=False, timeout=WAIT_S) as client:
        robot = client.get("/api/robot").json()
        assert (robot["simulated"], robot["stop_port"]) == (True, daemon.stop_port)
        assert robot["run"] == client.get("/api/events").json()["run"]
        assert f"http://127.0.0.1:{daemon.stop_port}" in client.get("/").headers["content-security-policy"]
        with connect(daemon.url.replace("http", "ws", 1) + "/api/stream") as stream:
            shown = [json.loads(stream.recv(timeout=WAIT_S)) for _ in range(30)]
        columns = client.get("/api/recent").json()
    bodies = shown[-1]["bodies"]
    assert len(bodies) == len(BODY_NAMES)
    heights = [z_m for _, z_m in bodies]
    assert heights == sorted(heights, reverse=True)  # it hangs
    assert robot["hinge_z_m"] - heights[-1] == pytest.approx(sum(robot["link_length_m"]), abs=0.03)
    assert shown[-1]["time"] == pytest.approx(time.time(), abs=60)
    times = dict(zip(columns["tick"], columns["time"], strict=True))
    both = [one for one in shown if one["tick"] in times]
    assert len(both) > 20
    assert [times[one["tick"]] for one in both] == pytest.approx([one["time"] for one in both], abs=0.005)
