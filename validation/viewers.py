"""Measure whether viewers delay the control loop.

A daemon with a simulated robot flies goals, in turns without clients and with viewers in another process. Each viewer
reads the stream at 30 Hz and requests the last minute (GET /api/recent) every 5 s. The lateness comes from the daemon's
own log, tick by tick; a bare loop next to them shows the machine's share. All turns belong to one run, so their ratios
are the cost of the viewers.

    python -m validation.viewers --json FILE
"""

import asyncio
import contextlib
import json
import multiprocessing
import tempfile
import time
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import click
import httpx
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


def run(seconds: float, turns: int, viewers: int, report: Callable[[float], None]) -> dict[str, Any]:
    """Measure `turns` turns of `seconds` each way and return the figures.

    Raises SoftwareInTheLoopError if the daemon did not start or refused a goal, or a viewer failed.
    """
    windows: dict[str, list[Window]] = {"alone": [], "viewed": []}
    cpu_s = dict.fromkeys(windows, 0.0)
    failed: list[str] = []
    with (
        tempfile.TemporaryDirectory() as folder,
        beside(bare_loop, bare := Path(folder) / "bare"),
        SimulatedDaemon(Path(folder) / "logs") as daemon,
    ):
        assert daemon.daemon is not None
        pids = [daemon.daemon.pid]
        log = daemon.status()["recorder"]["log"]
        daemon.arm()
        for number in range(2 * turns):
            part = "viewed" if number % 2 else "alone"
            with _watched(daemon, viewers, seconds) if number % 2 else contextlib.nullcontext() as came:
                before_s = growth.usage_of(pids).cpu_s
                windows[part].append(swing(daemon, seconds, lambda _: None))
                cpu_s[part] += growth.usage_of(pids).cpu_s - before_s
                if came is not None:
                    failed += came.recv()
            report((number + 1) / (2 * turns))
        ticks = list(logs.read(log))
        found = {part: figures(ticks, those, bare) for part, those in windows.items()}
    if failed:
        raise SoftwareInTheLoopError(f"a viewer failed: {failed[0]}")
    for part, each in found.items():
        each["daemon_cpu"] = cpu_s[part] / (turns * seconds)
    return {"viewers": viewers, **found}


@contextlib.contextmanager
def _watched(daemon: SoftwareInTheLoop, viewers: int, seconds: float) -> Iterator[Connection]:
    """Connect the viewers in another process; the connection returns their failures after `seconds`."""
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


async def _watching(url: str, viewers: int, seconds: float, way: Connection) -> None:
    there = [asyncio.Event() for _ in range(viewers)]

    async def follow(number: int) -> None:
        async with websockets.connect(url.replace("http", "ws", 1) + "/api/stream", max_size=None) as stream:
            async for text in stream:
                json.loads(text)
                there[number].set()

    async def look_back(number: int) -> None:
        await asyncio.sleep(RECENT_EVERY_S * number / viewers)
        # The daemon closes a connection that is idle for this long.
        limits = httpx.Limits(max_keepalive_connections=0)
        async with httpx.AsyncClient(base_url=url, timeout=30.0, limits=limits) as client:
            while True:
                begun = time.monotonic()
                (await client.get("/api/recent?seconds=60")).raise_for_status()
                await asyncio.sleep(max(0.0, RECENT_EVERY_S - (time.monotonic() - begun)))

    tasks = [asyncio.ensure_future(work(number)) for number in range(viewers) for work in (follow, look_back)]
    await asyncio.gather(*(one.wait() for one in there))
    way.send("ready")
    await asyncio.sleep(seconds)
    way.send([str(task.exception()) for task in tasks if task.done()])
    for task in tasks:
        task.cancel()


@click.command()
@click.option(
    "--seconds", default=20.0, show_default=True, type=click.FloatRange(5, 3600), help="Duration of each turn."
)
@click.option("--turns", default=3, show_default=True, type=click.IntRange(1, 1000), help="Number of turns each way.")
@click.option("--viewers", default=10, show_default=True, type=click.IntRange(1, 32), help="Number of viewers.")
@results.json_option
def main(seconds: float, turns: int, viewers: int, json_file: Path | None) -> None:
    """Measure the punctuality of the control loop with and without viewers.

    \b
    Example:
      python -m validation.viewers --seconds 20 --turns 3 --json viewers.json
    """
    with failing(SoftwareInTheLoopError), bar("flying") as shown:
        result = run(seconds, turns, viewers, shown.show)
    results.report("viewers", result, json_file)


if __name__ == "__main__":
    main()
