"""Measure whether ten viewers delay the control loop.

A daemon with a simulated robot flies goals, in turns without clients and with viewers in another process. Each viewer
reads the stream at 30 Hz and requests the last minute (GET /api/recent) every 5 s. The lateness comes from the
daemon's own log, tick by tick; a bare loop next to them shows the machine's share. All turns belong to one run, so
their ratios are the cost of the viewers.

    python -m validation.viewers --json FILE
"""

import asyncio
import json
import multiprocessing
import random
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import click
import httpx
import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks import results
from benchmarks.loop import GOAL_EVERY_S, BareLoop, Tick, spread
from softarm.common.processes import bar
from softarm.daemon.logbook import logs
from softarm.evaluation.soak import usage
from softarm.schemas.flights import TEST_TARGETS
from validation.stop import DaemonError, Ports, daemon

ARM_S = 20.0
READY_S = 60.0
RECENT_EVERY_S = 5.0
PARTS = ("alone", "viewed")


class Turn(NamedTuple):
    """Period with or without viewers."""

    begin_ns: int  # monotonic time
    end_ns: int
    cpu_s: float  # used by the daemon
    seen: dict[str, Any]  # received by the viewers


def run(seconds: float, turns: int, viewers: int, report: Callable[[float], None]) -> dict[str, Any]:
    """Measure `turns` turns of `seconds` each way and return the figures.

    Raises:
        DaemonError: The daemon did not start, or refused a goal.
    """
    taken: dict[str, list[Turn]] = {part: [] for part in PARTS}
    targets = random.Random(0)
    with tempfile.TemporaryDirectory() as folder, BareLoop(Path(folder)) as bare, daemon() as ports:
        url = f"http://127.0.0.1:{ports.api}"
        with httpx.Client(base_url=url, timeout=10.0) as client:
            _arm(client)
            for number in range(turns):
                taken["alone"].append(_turn(client, ports, seconds, targets, None))
                with _Crowd(url, viewers) as crowd:
                    taken["viewed"].append(_turn(client, ports, seconds, targets, crowd))
                report((number + 1) / turns)
            log = client.get("/api/status").json()["recorder"]["log"]
            client.post("/api/disarm")
        ticks = list(logs.read(log))
        figures = {part: _figures(ticks, turns_taken, bare) for part, turns_taken in taken.items()}
    return {"viewers": viewers, **figures, "ratio": _ratios(figures)}


def _arm(client: httpx.Client) -> None:
    """Arm after the stop with which the daemon was tested.

    Raises:
        DaemonError: Arming was refused.
    """
    client.post("/api/acknowledge")
    deadline = time.monotonic() + ARM_S
    while (status := client.get("/api/status").json())["mode"] != "armed":
        if time.monotonic() > deadline:
            raise DaemonError(f"cannot be armed: {'; '.join(status['arming_refusals']) or status['mode']}")
        if status["mode"] == "disarmed":
            client.post("/api/arm")
        time.sleep(0.1)


def _turn(client: httpx.Client, ports: Ports, seconds: float, targets: random.Random, crowd: "_Crowd | None") -> Turn:
    """Send goals for a while.

    Raises:
        DaemonError: A goal was refused.
    """
    if crowd is not None:
        crowd.begin()
    cpu_s, begin = usage.of([ports.pid]).cpu_s, time.monotonic()
    while (passed := time.monotonic() - begin) < seconds:
        goal = targets.choice(TEST_TARGETS)
        answer = client.post("/api/goal", json={"kind": "reach", "y_m": goal.y_m, "z_m": goal.z_m})
        if answer.status_code != 200:
            raise DaemonError(f"no goal is flown: {answer.json()['detail']}")
        time.sleep(min(GOAL_EVERY_S, max(0.0, seconds - passed)))
    end_ns = time.monotonic_ns()
    return Turn(round(begin * 1e9), end_ns, usage.of([ports.pid]).cpu_s - cpu_s, {} if crowd is None else crowd.end())


class _Crowd:
    """Viewers in another process, connected before the measurement."""

    def __init__(self, url: str, viewers: int) -> None:
        context = multiprocessing.get_context("spawn")
        self._ours, theirs = context.Pipe()
        self._process = context.Process(target=_watch, args=(url, viewers, theirs), daemon=True)

    def __enter__(self) -> "_Crowd":
        """Connect all viewers or raise DaemonError."""
        self._process.start()
        if not self._ours.poll(READY_S):
            raise DaemonError(f"the viewers received no data within {READY_S:g} s")
        self._ours.recv()
        return self

    def begin(self) -> None:
        """Start counting what the viewers receive."""
        self._ours.send("begin")

    def end(self) -> dict[str, Any]:
        """Return the figures of the viewers."""
        self._ours.send("end")
        seen: dict[str, Any] = self._ours.recv()
        return seen

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.join()


def _watch(url: str, viewers: int, way: Connection) -> None:
    asyncio.run(_watching(url, viewers, way))


async def _watching(url: str, viewers: int, way: Connection) -> None:
    import websockets

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

    tasks = [asyncio.create_task(work(number)) for number in range(viewers) for work in (follow, look_back)]
    await asyncio.gather(*(one.wait() for one in there))
    way.send("ready")
    await asyncio.to_thread(way.recv)
    before, begun, cpu_s = sum(frames), time.monotonic(), time.process_time()
    took.clear()
    await asyncio.to_thread(way.recv)
    rate = (sum(frames) - before) / (time.monotonic() - begun) / viewers
    failed = [str(task.exception()) for task in tasks if task.done()]
    way.send({"hz": rate, "recent_s": took, "bytes": sizes, "cpu_s": time.process_time() - cpu_s, "failed": failed})
    for task in tasks:
        task.cancel()


def _figures(log: Iterable[Tick], turns: Sequence[Turn], bare: BareLoop) -> dict[str, Any]:
    windows = [(turn.begin_ns, turn.end_ns) for turn in turns]
    ticks = [tick for tick in log if any(begin <= tick[0].t_ns < end for begin, end in windows)]
    wall_s = sum(end - begin for begin, end in windows) * 1e-9
    failed = [each for turn in turns for each in turn.seen.get("failed", ())]
    if failed:
        raise DaemonError(f"a viewer failed: {failed[0]}")
    seen = [turn.seen for turn in turns if turn.seen]
    return {
        "lateness_ms": spread([inputs.late_ns for inputs, _, _ in ticks]),
        "compute_ms": spread([each.read_ns + each.compute_ns + each.write_ns for _, _, each in ticks]),
        "bare_loop_lateness_ms": spread([late for window in windows for late in bare.lateness_ns(window)]),
        "ticks": len(ticks),
        "missed_ticks": sum(inputs.missed for inputs, _, _ in ticks),
        "policy_ticks": sum(outputs.action is not None for _, outputs, _ in ticks),
        "daemon_cpu": sum(turn.cpu_s for turn in turns) / wall_s,
        "viewers_cpu": sum(one["cpu_s"] for one in seen) / wall_s,
        "stream_hz": float(np.mean([one["hz"] for one in seen])) if seen else None,
        "recent_ms": spread([1e9 * took for one in seen for took in one["recent_s"]]) if seen else None,
        "recent_bytes": max((size for one in seen for size in one["bytes"]), default=None),
    }


def _ratios(figures: dict[str, Any]) -> dict[str, float]:
    """Return figures with viewers divided by those without."""
    alone, viewed = (figures[part] for part in PARTS)
    late = {f"lateness_{of}": viewed["lateness_ms"][of] / alone["lateness_ms"][of] for of in ("p50", "p99", "max")}
    return late | {"daemon_cpu": viewed["daemon_cpu"] / alone["daemon_cpu"]}


def _show(result: dict[str, Any]) -> Table:
    table = Table("p50 / p99 / max", "alone", f"{result['viewers']} viewers", "ratio")
    parts, ratio = [result[part] for part in PARTS], result["ratio"]
    for name, label in (
        ("lateness_ms", "lateness of ticks (ms)"),
        ("compute_ms", "compute (ms)"),
        ("bare_loop_lateness_ms", "lateness of a bare loop (ms)"),
        ("recent_ms", "GET /api/recent (ms)"),
    ):
        cells = ("{p50:.2f} / {p99:.2f} / {max:.2f}".format(**part[name]) if part[name] else "" for part in parts)
        of = " / ".join(f"{ratio[f'lateness_{of}']:.2f}" for of in ("p50", "p99", "max"))
        table.add_row(label, *cells, of if name == "lateness_ms" else "")
    for name, label in (("ticks", "ticks"), ("missed_ticks", "missed ticks"), ("policy_ticks", "with a policy")):
        table.add_row(label, *(str(part[name]) for part in parts))
    shown = [f"{part['daemon_cpu']:.1%}" for part in parts]
    table.add_row("daemon, of a core", *shown, f"{ratio['daemon_cpu']:.2f}")
    table.add_row("viewers, of a core", "", f"{parts[1]['viewers_cpu']:.1%}")
    table.add_row("stream of each (Hz)", "", f"{parts[1]['stream_hz']:.1f}")
    return table


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
    try:
        with bar("flying") as shown:
            result = run(seconds, turns, viewers, shown.show)
    except DaemonError as error:
        raise click.ClickException(str(error)) from None
    if json_file is not None:
        results.write(json_file, result)
    Console().print(_show(result))


if __name__ == "__main__":
    main()
