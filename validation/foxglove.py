"""Measure whether live data for Foxglove delays the control loop, with and without a client in turns.

Each turn is a separate daemon with a swinging simulated robot, as `softarm run --simulated` starts it. Every second
turn runs with `--foxglove` and a client in another process that subscribes to everything. The figures come from the
daemons' logs. A bare loop that only sleeps runs next to them and shows the machine's share of the lateness.

    python -m validation.foxglove --seconds 60 --json FILE
"""

import json
import multiprocessing
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import click
import httpx
from rich.console import Console
from rich.table import Table

from benchmarks import results
from benchmarks.loop import GOAL_EVERY_S, BareLoop, spread
from softarm.daemon.logbook import logs
from softarm.schemas.flights import TEST_TARGETS

SETTLE_S = 3.0  # a daemon's start-up work ends within this time


def run(seconds: float, rounds: int) -> dict[str, Any]:
    """Measure `seconds` with and without a client, in `rounds` alternating turns."""
    found: dict[str, dict[str, list[int]]] = {}
    for number in range(2 * rounds):
        name = "with" if number % 2 else "without"
        part = found.setdefault(name, {"late": [], "missed": [], "compute": [], "bare": [], "messages": []})
        for key, values in _turn(seconds / rounds, number % 2 == 1).items():
            part[key] += values
    return {name: _figures(part) for name, part in found.items()}


def _turn(seconds: float, is_served: bool) -> dict[str, list[int]]:
    with tempfile.TemporaryDirectory() as folder, BareLoop(Path(folder)) as bare:
        config = Path(folder) / "softarm.yaml"
        config.write_text(f"api: {{port: 0, stop_port: 0}}\nrecorder: {{directory: {folder}/logs}}\n")
        command = [sys.executable, "-m", "softarm.cli.main", "run", "--simulated", "--config", str(config)]
        command += ["--foxglove", "0"] if is_served else []
        messages: Any = multiprocessing.get_context("spawn").Value("q", 0)
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            output = ""
            while "next:" not in output:
                line = process.stdout.readline()
                if not line:
                    raise click.ClickException(f"the daemon did not come up: {output or 'no output'}")
                output += line
            client = _client(output, messages) if is_served else None
            time.sleep(SETTLE_S)
            window = _swing(re.search(r"serving (http://\S+)", output)[1], seconds)  # type: ignore[index]
            if client is not None:
                client.kill()
                client.join()
            process.send_signal(signal.SIGTERM)
        (log,) = (Path(folder) / "logs").glob("*.mcap")
        ticks = [tick for tick in logs.read(log) if window[0] <= tick[0].t_ns < window[1]]
        return {
            "late": [inputs.late_ns for inputs, _, _ in ticks],
            "missed": [inputs.missed for inputs, _, _ in ticks],
            "compute": [t.read_ns + t.compute_ns + t.write_ns for _, _, t in ticks],
            "bare": bare.lateness_ns(window),
            "messages": [messages.value],
        }


def _swing(url: str, seconds: float) -> tuple[int, int]:
    """Send goals for a while and return the time window in monotonic nanoseconds."""
    targets, began = random.Random(0), time.monotonic()
    with httpx.Client(base_url=url) as api:
        api.post("/api/arm").raise_for_status()
        while (passed := time.monotonic() - began) < seconds:
            goal = targets.choice(TEST_TARGETS)
            api.post("/api/goal", json={"kind": "reach", "y_m": goal.y_m, "z_m": goal.z_m})
            time.sleep(min(GOAL_EVERY_S, seconds - passed))
    return round(began * 1e9), time.monotonic_ns()


def _client(output: str, messages: Any) -> Any:
    url = re.search(r"(ws://\S+)", output)[1]  # type: ignore[index]
    client = multiprocessing.get_context("spawn").Process(target=_listen, args=(url, messages), daemon=True)
    client.start()
    return client


def _listen(url: str, messages: Any) -> None:
    """Subscribe to every channel and count the messages."""
    from websockets.sync.client import connect

    with connect(url, subprotocols=["foxglove.sdk.v1"], max_size=None) as socket:  # type: ignore[list-item]
        for data in socket:
            if isinstance(data, bytes):
                messages.value += 1
                continue
            message = json.loads(data)
            if message["op"] == "advertise":
                channels = [{"id": one["id"], "channelId": one["id"]} for one in message["channels"]]
                socket.send(json.dumps({"op": "subscribe", "subscriptions": channels}))


def _figures(part: dict[str, list[int]]) -> dict[str, Any]:
    return {
        "lateness_ms": spread(part["late"]),
        "compute_ms": spread(part["compute"]),
        "bare_loop_lateness_ms": spread(part["bare"]),
        "ticks": len(part["late"]),
        "missed_ticks": sum(part["missed"]),
        "messages": sum(part["messages"]),
    }


@click.command()
@click.option(
    "--seconds",
    default=60.0,
    show_default=True,
    type=click.FloatRange(5, 3600),
    help="Duration with and without a client each.",
)
@click.option("--rounds", default=2, show_default=True, type=click.IntRange(1, 100), help="Number of turns each.")
@results.json_option
def main(seconds: float, rounds: int, json_file: Path | None) -> None:
    """Measure the lateness of the loop with and without a client of Foxglove.

    \b
    Example:
      python -m validation.foxglove --seconds 60 --json foxglove.json
    """
    result = run(seconds, rounds)
    if json_file is not None:
        results.write(json_file, result)
    table = Table("p50 / p99 / p99.9 / max", *(f"{name} Foxglove" for name in result))
    for key, label in (
        ("lateness_ms", "lateness (ms)"),
        ("compute_ms", "compute (ms)"),
        ("bare_loop_lateness_ms", "lateness of a bare loop (ms)"),
    ):
        shown = ("{p50:.2f} / {p99:.2f} / {p999:.2f} / {max:.2f}".format(**part[key]) for part in result.values())
        table.add_row(label, *shown)
    for key in ("ticks", "missed_ticks", "messages"):
        table.add_row(key.replace("_", " "), *(str(part[key]) for part in result.values()))
    Console().print(table)


if __name__ == "__main__":
    main()
