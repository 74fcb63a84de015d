"""Measure what the OptiTrack bridge adds to a frame: latency, and the error of its stamp.

A test server streams an arm at 120 Hz with a clock that is 30 ppm fast; `softarm bridge natnet` runs in another
process; this process listens as the daemon does. All run on one computer, so a network's latency is not included.

    python -m benchmarks.cameras --seconds 60 --json FILE
"""

import contextlib
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import yaml
import zenoh

from benchmarks import results
from softarm.drivers.bridge.frame import Plane
from softarm.drivers.mocap import payload
from softarm.drivers.mocap.zenoh_session import listener
from softarm.drivers.twin import motive
from softarm.drivers.twin.motive import Motive, bodies_of
from softarm.evaluation.software_in_the_loop import free_ports
from softarm.schemas.bridge import Room
from softarm.schemas.messages import BODY_NAMES, Pose

RATE_HZ, PPM = 120, 30.0
AGE_NS = 8_000_000  # age of a frame when it is streamed
SETTLING_S = 10.0  # until the drift of the clocks is estimated
ROOM = Room(yaw_rad=0.4, origin_m=(1.2, 0.1, -0.7))
SHOWN = {"added_ms": "from the server to the daemon (ms)", "stamp_error_ms": "a stamp's error (ms)"}


def run(seconds: float) -> dict[str, Any]:
    """Stream for `seconds` after settling and return percentiles of latency and stamp error."""
    received: dict[int, tuple[int, int]] = {}  # frame -> arrival, stamp
    streamed: dict[int, int] = {}  # frame -> time of sending
    [port] = free_ports(1)
    endpoint, key = f"tcp/127.0.0.1:{port}", "softarm/mocap"

    def hear(sample: zenoh.Sample) -> None:
        now_ns = time.monotonic_ns()
        seen = payload.decode(sample.payload.to_bytes(), now_ns)
        received[round(seen.bodies[0].y_m * 1e6)] = (
            now_ns,
            seen.t_capture_ns,
        )  # the cart position encodes the number of the frame

    with contextlib.suppress(OSError):  # before any thread starts, as daemon and bridge do
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    server = Motive(rate=1 + PPM * 1e-6, began_ns=time.monotonic_ns() - 10**12)
    with server, zenoh.open(listener(endpoint)) as session, _bridge(server, endpoint):
        session.declare_subscriber(key, hear)
        begin_ns, ended = time.monotonic_ns(), threading.Event()
        for number in range(1, round((SETTLING_S + seconds) * RATE_HZ) + 1):
            due_ns = begin_ns + round(number * 1e9 / RATE_HZ)
            ended.wait(max(0, due_ns - time.monotonic_ns()) / 1e9)
            poses = {name: Pose(number * 1e-6, 0.965 - 0.0885 * i, 0.1 * i) for i, name in enumerate(BODY_NAMES)}
            bodies = bodies_of(Plane(ROOM), poses)
            streamed[number] = now_ns = time.monotonic_ns()
            taken = server.ticks(now_ns - AGE_NS)
            server.stream(motive.frame(server.version, number, bodies, (taken, taken, server.ticks(now_ns))))
        time.sleep(0.2)
    late = [number for number in streamed if number > SETTLING_S * RATE_HZ]
    common = [number for number in late if number in received]
    added = [(received[number][0] - streamed[number]) / 1e6 for number in common]
    wrong = [abs(received[number][1] - (streamed[number] - AGE_NS)) / 1e6 for number in common]
    return {
        "added_ms": results.spread(added),
        "stamp_error_ms": results.spread(wrong),
        "frames": len(late),
        "lost": len(late) - len(common),
    }


@contextlib.contextmanager
def _bridge(server: Motive, endpoint: str) -> Iterator[None]:
    """Run the bridge as a user starts it."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "bridge.yaml"
        settings = {"server": "127.0.0.1", "command_port": server.port, "received_after_s": 0.0}
        settings |= {"room": ROOM.model_dump(mode="json"), "daemon": {"endpoint": endpoint}}
        file.write_text(yaml.safe_dump(settings))
        command = [sys.executable, "-m", "softarm.cli.main", "bridge", "natnet", "--config", str(file)]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        try:
            yield
        finally:
            process.terminate()
            process.wait(10)


@click.command()
@click.option("--seconds", default=60.0, show_default=True, type=click.FloatRange(1, 3600), help="Of streaming.")
@results.json_option
def main(seconds: float, json_file: Path | None) -> None:
    """Measure what the OptiTrack bridge adds to a frame.

    \b
    Example:
      python -m benchmarks.cameras --seconds 60 --json cameras.json
    """
    result = run(seconds)
    if json_file is not None:
        results.write(json_file, result)
    for name, label in SHOWN.items():
        click.echo("{}: p50 {p50:.2f}, p99 {p99:.2f}, max {max:.2f}".format(label, **result[name]))
    click.echo(f"{result['frames']} frames, {result['lost']} lost")


if __name__ == "__main__":
    main()
