"""Measure how punctual the control loop is on the twin, alone and with its API hammered.

The figures come from the daemon's log: every tick carries its lateness and the times of its parts. Twin, daemon and the
clients are separate processes on the same cores. A bare loop, which only sleeps to its deadlines with the same
priority, runs next to them; its lateness is the machine's share.

    python -m benchmarks.loop --seconds 60 --json FILE
"""

import asyncio
import contextlib
import gc
import multiprocessing
import random
import select
import struct
import tempfile
import time
from collections.abc import Callable, Coroutine, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np

from benchmarks import results
from softarm.cli.shared.errors import failing
from softarm.common import realtime
from softarm.common.processes import bar
from softarm.daemon.control.records import Tick
from softarm.daemon.logbook import logs
from softarm.evaluation.software_in_the_loop import SoftwareInTheLoop, SoftwareInTheLoopError
from softarm.schemas.config import Config
from softarm.schemas.flights import TEST_TARGETS

REQUESTS_PER_S = 200
WEBSOCKETS = 2
GOAL_EVERY_S = 4.0
Window = tuple[int, int]  # monotonic nanoseconds


def run(seconds: float, report: Callable[[float], None]) -> dict[str, Any]:
    """Measure both cases for `seconds` each with a swinging arm; `report` receives the finished share.

    Raises SoftwareInTheLoopError if twin or daemon do not start.
    """
    with tempfile.TemporaryDirectory() as folder:
        bare = Path(folder) / "bare"
        with beside(bare_loop, bare), SoftwareInTheLoop(Path(folder)) as sil:
            log = Path(sil.status()["recorder"]["log"])
            sil.arm()
            idle = swing(sil, seconds, lambda share: report(share / 2))
            with beside(run_async, _hammer, sil.url):
                time.sleep(2.0)  # the interpreter of the clients starts before the measurement
                hammered = swing(sil, seconds, lambda share: report(0.5 + share / 2))
        ticks = list(logs.read(log))
        return {"idle": figures(ticks, [idle], bare), "hammered": figures(ticks, [hammered], bare)}


@contextlib.contextmanager
def beside(work: Callable[..., object], *arguments: object) -> Iterator[None]:
    """Run a function of a module in another process while the context lasts."""
    process = multiprocessing.get_context("spawn").Process(target=work, args=arguments, daemon=True)
    process.start()
    try:
        yield
    finally:
        process.kill()
        process.join()


def swing(sil: SoftwareInTheLoop, seconds: float, report: Callable[[float], None]) -> Window:
    """Send goals for a while and return when. Raises SoftwareInTheLoopError if the daemon refuses one."""
    targets = random.Random(0)
    start = time.monotonic()
    while (passed := time.monotonic() - start) < seconds:
        sil.reach(targets.choice(TEST_TARGETS))
        report(passed / seconds)
        time.sleep(min(GOAL_EVERY_S, max(0.0, seconds - passed)))
    return round(start * 1e9), time.monotonic_ns()


def bare_loop(notes: Path) -> None:
    """Wake 30 times a second and write the time and lateness of each wake-up, ns."""
    realtime.outrank_own_threads(Config().control.realtime_priority)
    gc.disable()
    period_ns = round(1e9 / Config().control.rate_hz)
    deadline = time.monotonic_ns()
    with open(notes, "wb", buffering=0) as file:
        while True:
            deadline += period_ns
            while (left := deadline - time.monotonic_ns()) > 0:
                select.select([], [], [], left * 1e-9)
            now = time.monotonic_ns()
            file.write(struct.pack("<qq", now, now - deadline))


def figures(log: Iterable[Tick], windows: Sequence[Window], bare: Path) -> dict[str, Any]:
    """Return the punctuality of the loop within some windows of its log, and of the bare loop with these notes."""
    ticks = [tick for tick in log if any(begin <= tick[0].t_ns < end for begin, end in windows)]
    timings = [timing for _, _, timing in ticks]
    woken = np.fromfile(bare, dtype=np.int64).reshape(-1, 2).tolist()
    bare_late = [late for begin, end in windows for t_ns, late in woken if begin <= t_ns < end]
    ages = [t.sensor_to_command_ns for t in timings if t.sensor_to_command_ns is not None]
    return {
        "compute_ms": _spread_ms([t.read_ns + t.compute_ns + t.write_ns for t in timings]),
        "lateness_ms": _spread_ms([inputs.late_ns for inputs, _, _ in ticks]),
        "sensor_to_command_ms": _spread_ms(ages),
        "bare_loop_lateness_ms": _spread_ms(bare_late),
        "ticks": len(ticks),
        "missed_ticks": sum(inputs.missed for inputs, _, _ in ticks),
        "policy_ticks": sum(outputs.action is not None for _, outputs, _ in ticks),
    }


def _spread_ms(values_ns: Sequence[float]) -> dict[str, float]:
    return results.spread([value * 1e-6 for value in values_ns])


def run_async(work: Callable[..., Coroutine[Any, Any, None]], *arguments: object) -> None:
    """Run a coroutine function of a module, for `beside`."""
    asyncio.run(work(*arguments))


async def _hammer(url: str) -> None:
    """Send 200 requests a second over a few connections, with two WebSocket clients that read everything."""
    import httpx
    import websockets

    async def listen() -> None:
        async with websockets.connect(url.replace("http", "ws", 1) + "/api/stream") as stream:
            async for _ in stream:
                pass

    async def ask(client: httpx.AsyncClient, period: float) -> None:
        due = time.monotonic()
        while True:
            due += period
            await client.get("/api/status")
            await asyncio.sleep(max(0.0, due - time.monotonic()))

    workers = 4
    async with httpx.AsyncClient(base_url=url) as client:
        tasks = [ask(client, workers / REQUESTS_PER_S) for _ in range(workers)]
        tasks += [listen() for _ in range(WEBSOCKETS)]
        await asyncio.gather(*tasks)


@click.command()
@click.option("--seconds", default=60.0, show_default=True, type=click.FloatRange(5, 3600), help="For each part.")
@results.json_option
def main(seconds: float, json_file: Path | None) -> None:
    """Measure the punctuality of the loop on the twin, alone and with the API hammered.

    \b
    Example:
      python -m benchmarks.loop --seconds 60 --json loop.json
    """
    with failing(SoftwareInTheLoopError), bar("ticking") as shown:
        result = run(seconds, shown.show)
    results.report("loop", result, json_file)


if __name__ == "__main__":
    main()
