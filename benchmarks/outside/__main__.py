"""Be the robot from outside, in real time.

    python -m softarm.benchmarks.outside --serial /tmp/regulator --rail-port 15020 --status status.json

One thread steps the body 1000 times a second by absolute deadlines and serves the serial line and the drive in between.
Ends on SIGINT or SIGTERM. Later than PAUSE_S, the robot's world stands still and does not catch up; the status says so.
"""

import argparse
import contextlib
import json
import os
import signal
import threading
import time

from .body import Body
from .cameras import Cameras
from .drive import Drive, Port
from .regulator import Board
from .robot import STEP_S, Robot

STATUS_S = 0.05
LATE_S = 0.005
PAUSE_S = 0.1
PRIORITY = 30  # of SCHED_FIFO, where the system grants it: hardware does not wait for other programs


def main() -> None:
    """Parse, build, run."""
    parser = argparse.ArgumentParser(description="Be the robot from outside, in real time.")
    add = parser.add_argument
    add("--serial", required=True, help="symbolic link to make for the regulator's pseudo-terminal")
    add("--rail-host", default="127.0.0.1")
    add("--rail-port", type=int, required=True)
    add("--endpoint", default="tcp/127.0.0.1:7447", help="where the daemon listens for motion capture")
    add("--key", default="softarm/mocap")
    add("--status", required=True, help="JSON file, written anew twenty times a second")
    add("--bound-m", type=float, default=0.255, help="of the cart from the middle; excursions beyond are counted")
    add("--latency-ms", type=float, default=20.0, help="from a written 60FFh to the start of the ramp")
    add("--ramp", type=float, help="m/s^2 really driven, whatever 6083h to 6085h say")
    add("--age-ms", type=float, default=0.0, help="age of what 6064h and 606Ch say")
    add("--keep", action="store_true", help="the drive keeps its last set-point when its master is gone or silent")
    add("--payload-g", type=float, default=0.0)
    add("--friction-n", type=float, default=1.0)
    add("--start", type=float, default=0.0, help="cart, m")
    add("--rate", type=float, default=120.0, help="frames a second")
    add("--delay-ms", type=float, default=8.0, help="from a frame's exposure to its sample")
    add("--noise-mm", type=float, default=0.1)
    options = parser.parse_args()

    body = Body(options.payload_g / 1000, options.friction_n, options.start)
    drive = Drive(options.ramp, options.latency_ms / 1000, options.age_ms / 1000, options.keep)
    robot = Robot(body, drive, options.bound_m)
    port = Port(drive, options.rail_host, options.rail_port)
    board = Board(robot.firmware, options.serial)
    cameras = Cameras(options.endpoint, options.key, options.delay_ms / 1000, options.noise_mm / 1000)
    try:
        run(robot, port, board, cameras, options.rate, options.status)
    finally:
        board.close()
        port.close()
        cameras.close()


def run(robot: Robot, port: Port, board: Board, cameras: Cameras, frame_rate_hz: float, status: str) -> None:
    """Until a signal comes."""
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(threading.get_native_id(), os.SCHED_FIFO, os.sched_param(PRIORITY))
    late_steps, max_late_s, paused_s = 0, 0.0, 0.0
    begin = time.monotonic()
    frame_due = status_due = begin
    steps = 0
    while not ended.is_set():
        now, due = time.monotonic(), begin + steps * STEP_S
        if now < due:
            time.sleep(due - now)
            continue
        late_steps, max_late_s = late_steps + (now - due > LATE_S), max(max_late_s, now - due)
        if now - due > PAUSE_S:
            begin, paused_s = begin + now - due, paused_s + now - due
            continue
        board.serve(int(now * 1e6), robot.body.pressure_kpa)
        port.serve(now)
        robot.step(due)
        steps += 1
        if due >= frame_due:
            frame_due = max(frame_due + 1 / frame_rate_hz, due)
            cameras.take(int(due * 1e9), robot.body.poses())
        cameras.send(int(now * 1e9))
        if due >= status_due:
            status_due = due + STATUS_S
            timing = {"steps": steps, "late_steps": late_steps, "max_late_s": max_late_s, "paused_s": paused_s}
            with open(f"{status}.new", "w") as file:
                json.dump({"t_s": due, **robot.truth(), **timing}, file)
            os.replace(f"{status}.new", status)


if __name__ == "__main__":
    main()
