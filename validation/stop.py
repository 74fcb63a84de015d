"""Measure how soon a stop is answered while the API is under attack.

One process runs a daemon with a simulated robot, another the attackers. This process requests stops through the
dedicated stop port and over REST, with the control loop's priority where the system grants it, so that the daemon is
measured and not other work. An answer follows the tick that stopped the robot and wrote its commands, so the time until
that tick is included: half a period of the loop on average.

    python -m validation.stop --json FILE
"""

import asyncio
import contextlib
import http.client
import json
import random
import tempfile
import time
from collections.abc import Awaitable, Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import click

from benchmarks import results
from benchmarks.loop import beside
from softarm.cli.shared.errors import failing
from softarm.common import realtime
from softarm.common.processes import bar
from softarm.daemon.runtime.service import allow_descriptors
from softarm.evaluation.software_in_the_loop import SoftwareInTheLoopError
from softarm.schemas.config import Config
from validation.daemon_process import SimulatedDaemon

WARM_UP_S = 2.0  # of an attack, before the measurement
PAUSE_S = (0.05, 0.15)  # random, so that the phase of the loop does not matter
TIMEOUT_S = 5.0
CLIENTS = 1100
SLOW_CLIENTS = 200
BODY = 5_000_000  # bytes
KEYS = 100_000


class Ports(NamedTuple):
    """Ports of the daemon under attack."""

    api: int
    stop: int


Attack = Callable[[Ports], Coroutine[Any, Any, None]]


def run(stops: int, attacks: list[str], report: Callable[[float], None]) -> dict[str, Any]:
    """Request `stops` stops each way under each attack and return the figures. Raises SoftwareInTheLoopError."""
    figures = {}
    with (
        tempfile.TemporaryDirectory() as folder,
        SimulatedDaemon(Path(folder)) as daemon,
        ThreadPoolExecutor(1, initializer=_outrank) as asking,
    ):
        ports = Ports(daemon.settings["api"]["port"], daemon.stop_port)
        for number, name in enumerate(attacks):
            with beside(_attack, name, ports):
                time.sleep(WARM_UP_S)
                figures[name] = asking.submit(_measure, ports, stops).result()
            report((number + 1) / len(attacks))
    return figures


def _outrank() -> None:
    """Raise the priority of this thread only, since child processes would inherit it."""
    realtime.outrank_own_threads(Config().control.realtime_priority)


def _measure(ports: Ports, stops: int) -> dict[str, Any]:
    pauses = random.Random(0)
    took: dict[str, list[float | None]] = {"stop": [], "api": []}
    for _ in range(stops):
        for way, times in took.items():
            time.sleep(pauses.uniform(*PAUSE_S))
            times.append(_stop(ports, way))
    return {way: summarize(times) for way, times in took.items()}


def _stop(ports: Ports, way: str) -> float | None:
    """Return the seconds until a stop was confirmed, or None."""
    started = time.monotonic()
    connection = http.client.HTTPConnection("127.0.0.1", getattr(ports, way), timeout=TIMEOUT_S)
    try:
        connection.request("POST", "/api/stop")
        answer = connection.getresponse()
        answer.read()
        return time.monotonic() - started if answer.status == 200 else None
    except (OSError, http.client.HTTPException):
        return None
    finally:
        connection.close()


def summarize(times_s: list[float | None]) -> dict[str, Any]:
    """Return the spread of the times to an answer, ms, or None for each of its figures if there was no answer."""
    done = [seconds * 1e3 for seconds in times_s if seconds is not None]
    spread = results.spread(done) if done else dict.fromkeys(("p50", "p99", "p999", "max"))
    return {**spread, "asked": len(times_s), "unanswered": len(times_s) - len(done)}


def _attack(name: str, ports: Ports) -> None:
    allow_descriptors()
    asyncio.run(ATTACKS[name](ports))


async def _keys(ports: Ports) -> None:
    body = json.dumps({"kind": "hold"} | {f"key{i}": i for i in range(KEYS)}).encode()
    parts = [body[at : at + 60_000] for at in range(0, len(body), 60_000)]
    chunked = b"".join(b"%x\r\n%b\r\n" % (len(part), part) for part in parts) + b"0\r\n\r\n"
    with_length = _head(b"Content-Length: %d" % len(body)) + body
    without = _head(b"Transfer-Encoding: chunked") + chunked

    async def send(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        for request in (with_length, without):
            writer.write(request)
            await writer.drain()
            await reader.read(4096)

    await _crowd(8, ports.api, send)


async def _policies(ports: Ports) -> None:
    import httpx

    async with httpx.AsyncClient(base_url=f"http://127.0.0.1:{ports.api}", timeout=60.0) as client:
        while True:
            for name in ("reach-wide", "reach"):
                with contextlib.suppress(httpx.HTTPError):
                    await client.put("/api/policy", json={"name": name})


async def _stay_connected(reader: asyncio.StreamReader, _: asyncio.StreamWriter) -> None:
    await reader.read()


async def _send_slowly(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    writer.write(_head(b"Transfer-Encoding: chunked" if random.random() < 0.5 else b"Content-Length: %d" % BODY))
    while True:
        writer.write(b"1\r\nx\r\n")
        await writer.drain()
        await asyncio.sleep(0.1)


def _head(line: bytes) -> bytes:
    return b"POST /api/goal HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n" + line + b"\r\n\r\n"


Client = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


async def _crowd(clients: int, port: int, act: Client) -> None:
    """Keep `clients` clients connected; each reconnects when it is refused."""

    async def client() -> None:
        while True:
            with contextlib.suppress(OSError, asyncio.IncompleteReadError):
                reader, writer = await asyncio.open_connection("127.0.0.1", port)
                try:
                    await act(reader, writer)
                finally:
                    writer.close()
            await asyncio.sleep(random.uniform(0.05, 0.15))

    await asyncio.gather(*(client() for _ in range(clients)))


ATTACKS: dict[str, Attack] = {
    "nothing": lambda ports: asyncio.sleep(3600),
    f"{CLIENTS} idle clients": lambda ports: _crowd(CLIENTS, ports.api, _stay_connected),
    "bodies of megabytes, slowly": lambda ports: _crowd(SLOW_CLIENTS, ports.api, _send_slowly),
    f"goals of {KEYS} keys": _keys,
    "policies being swapped": _policies,
    f"{CLIENTS} idle clients at the stop port": lambda ports: _crowd(CLIENTS, ports.stop, _stay_connected),
}


@click.command()
@click.option(
    "--stops", default=100, show_default=True, type=click.IntRange(1), help="Stops each way under each attack."
)
@results.json_option
def main(stops: int, json_file: Path | None) -> None:
    """Measure how soon a stop is answered while the API is under attack.

    \b
    Example:
      python -m validation.stop --json stop.json
    """
    with failing(SoftwareInTheLoopError), bar("stopping") as shown:
        figures = run(stops, list(ATTACKS), shown.show)
    results.report("stop", {"answer_ms": figures}, json_file)


if __name__ == "__main__":
    main()
