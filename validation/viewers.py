"""Measure whether viewers delay the control loop.

A daemon with a simulated robot flies goals, in turns without clients and with viewers in another process. Each viewer
reads the stream at 30 Hz and requests the last minute (GET /api/recent) every 5 s. The lateness comes from the daemon's
own log, tick by tick; a bare loop next to them shows the machine's share. All turns belong to one run, so their ratios
are the cost of the viewers.

    python -m validation.viewers --json FILE
    python -m validation.viewers --diagnose LOG    with a diagnosis as a job of the daemon, next to the viewers
"""

import asyncio
import contextlib
import json
import multiprocessing
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import click
import httpx
import numpy as np
import websockets

from benchmarks import results
from benchmarks.loop import Window, bare_loop, beside, figures, run_async, swing
from softarm.cli.shared.errors import failing
from softarm.common.processes import bar
from softarm.daemon.logbook import logs
from softarm.evaluation.software_in_the_loop import SoftwareInTheLoop, SoftwareInTheLoopError
from validation.daemon_process import SimulatedDaemon
from validation.soak import growth

READY_S = 60.0
RECENT_EVERY_S = 5.0
DIAGNOSED = "diagnosed.mcap"


def run(
    seconds: float, turns: int, viewers: int, report: Callable[[float], None], diagnosed: Path | None = None
) -> dict[str, Any]:
    """Measure `turns` turns of `seconds` each way and return the figures; the daemon diagnoses a log next to viewers.

    Raises SoftwareInTheLoopError if the daemon did not start or refused a goal, or a viewer failed.
    """
    windows: dict[str, list[Window]] = {"alone": [], "viewed": []}
    cpu_s = dict.fromkeys(windows, 0.0)
    seen: list[dict[str, Any]] = []
    with (
        tempfile.TemporaryDirectory() as folder,
        beside(bare_loop, bare := Path(folder) / "bare"),
        SimulatedDaemon(Path(folder) / "logs") as daemon,
    ):
        assert daemon.daemon is not None
        pids = [daemon.daemon.pid]
        log = daemon.status()["recorder"]["log"]
        if diagnosed is not None:
            shutil.copy(diagnosed, Path(log).with_name(DIAGNOSED))
        daemon.arm()
        for number in range(2 * turns):
            part = "viewed" if number % 2 else "alone"
            with (
                _watched(daemon, viewers, seconds) if number % 2 else contextlib.nullcontext() as came,
                _job(daemon.url) if number % 2 and diagnosed is not None else contextlib.nullcontext(),
            ):
                before_s = growth.usage_of(pids).cpu_s
                windows[part].append(swing(daemon, seconds, lambda _: None))
                cpu_s[part] += growth.usage_of(pids).cpu_s - before_s
                if came is not None:
                    seen.append(came.recv())
            report((number + 1) / (2 * turns))
        ticks = list(logs.read(log))
        found = {part: figures(ticks, those, bare) for part, those in windows.items()}
    if failed := [each for one in seen for each in one["failed"]]:
        raise SoftwareInTheLoopError(f"a viewer failed: {failed[0]}")
    for part, each in found.items():
        each["daemon_cpu"] = cpu_s[part] / (turns * seconds)
    found["viewed"] |= {
        "viewers_cpu": sum(one["cpu_s"] for one in seen) / (turns * seconds),
        "stream_hz": float(np.mean([one["hz"] for one in seen])),
        "recent_ms": results.spread([1e3 * took for one in seen for took in one["recent_s"]] or [0.0]),
        "recent_bytes": max((size for one in seen for size in one["bytes"]), default=0),
    }
    return {"viewers": viewers, **found, "ratio": _ratios(found)}


@contextlib.contextmanager
def _watched(daemon: SoftwareInTheLoop, viewers: int, seconds: float) -> Iterator[Connection]:
    """Connect the viewers in another process; the connection returns their figures after `seconds`."""
    ours, theirs = multiprocessing.Pipe()
    with beside(run_async, _watching, daemon.url, viewers, seconds, theirs):
        theirs.close()
        if not ours.poll(READY_S):
            raise SoftwareInTheLoopError(f"the viewers received no data within {READY_S:g} s")
        try:
            ours.recv()
            yield ours
        except EOFError:
            raise SoftwareInTheLoopError("the process of the viewers ended early") from None


@contextlib.contextmanager
def _job(url: str) -> Iterator[None]:
    """Diagnose the log as a job of the daemon while the context lasts."""
    with httpx.Client(base_url=url, timeout=30.0) as client:
        started = client.post("/api/jobs", json={"kind": "diagnose", "logs": [DIAGNOSED]}).raise_for_status()
        number = started.json()["number"]
        yield
        client.delete(f"/api/jobs/{number}").raise_for_status()
        while client.get("/api/jobs").json()["jobs"][0]["state"] == "running":
            time.sleep(0.05)


async def _watching(url: str, viewers: int, seconds: float, way: Connection) -> None:
    frames, took, sizes, there = [0] * viewers, [], [], [asyncio.Event() for _ in range(viewers)]

    async def follow(number: int) -> None:
        async with websockets.connect(url.replace("http", "ws", 1) + "/api/stream", max_size=None) as stream:
            async for text in stream:
                json.loads(text)
                frames[number] += 1
                there[number].set()

    async def look_back(number: int) -> None:
        await asyncio.sleep(RECENT_EVERY_S * number / viewers)
        # The daemon closes a connection that is idle for this long.
        limits = httpx.Limits(max_keepalive_connections=0)
        async with httpx.AsyncClient(base_url=url, timeout=30.0, limits=limits) as client:
            while True:
                begun = time.monotonic()
                answer = await client.get("/api/recent?seconds=60")
                answer.raise_for_status()
                took.append(time.monotonic() - begun)
                sizes.append(len(answer.content))
                await asyncio.sleep(max(0.0, RECENT_EVERY_S - took[-1]))

    tasks = [asyncio.ensure_future(work(number)) for number in range(viewers) for work in (follow, look_back)]
    await asyncio.gather(*(one.wait() for one in there))
    way.send("ready")
    before, cpu_s = sum(frames), time.process_time()
    took.clear()
    await asyncio.sleep(seconds)
    rate = (sum(frames) - before) / seconds / viewers
    failed = [str(task.exception()) for task in tasks if task.done()]
    way.send({"hz": rate, "recent_s": took, "bytes": sizes, "cpu_s": time.process_time() - cpu_s, "failed": failed})
    for task in tasks:
        task.cancel()


def _ratios(found: dict[str, Any]) -> dict[str, float]:
    """Return figures with viewers divided by those without."""
    alone, viewed = found["alone"], found["viewed"]
    late = {f"lateness_{of}": viewed["lateness_ms"][of] / alone["lateness_ms"][of] for of in ("p50", "p99", "max")}
    return late | {"daemon_cpu": viewed["daemon_cpu"] / alone["daemon_cpu"]}


@click.command()
@click.option(
    "--seconds", default=20.0, show_default=True, type=click.FloatRange(5, 3600), help="Duration of each turn."
)
@click.option("--turns", default=3, show_default=True, type=click.IntRange(1, 1000), help="Number of turns each way.")
@click.option("--viewers", default=10, show_default=True, type=click.IntRange(1, 32), help="Number of viewers.")
@click.option("--diagnose", "diagnosed", type=results.FILE, help="Log that the daemon diagnoses next to the viewers.")
@results.json_option
def main(seconds: float, turns: int, viewers: int, diagnosed: Path | None, json_file: Path | None) -> None:
    """Measure the punctuality of the control loop with and without viewers.

    \b
    Example:
      python -m validation.viewers --seconds 20 --turns 3 --json viewers.json
    """
    with failing(SoftwareInTheLoopError), bar("flying") as shown:
        result = run(seconds, turns, viewers, shown.show, diagnosed)
    results.report("viewers", result, json_file)


if __name__ == "__main__":
    main()
