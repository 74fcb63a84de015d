"""Run the outside robot in real time.

    python -m validation.outside --serial /tmp/regulator --rail-port 15020 --status status.json

One thread steps the body 1000 times a second by absolute deadlines and serves the drive in between; the regulator has
its own thread. If a step is later than PAUSE_S, the simulated time pauses and does not catch up; the status reports it.
Ends on SIGINT or SIGTERM.
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

STATUS_S, STATUS_BYTES = 0.05, 4096
LATE_S, STALL_S = 0.005, 0.02
PAUSE_S = 0.1
LATENCY_S = 0.02  # from a written 60FFh to the start of the ramp
FRICTION_N = 3.0  # of axis and motor; all that holds a cart without power
KEY, FRAME_RATE_HZ = "softarm/mocap", 120.0
CAMERA_DELAY_S, CAMERA_NOISE_M = 0.008, 0.0001  # from a frame's exposure to its sample
PRIORITY = 30  # SCHED_FIFO where the system grants it, since hardware does not wait for other programs


def main() -> None:
    """Parse the options, build the robot and run it."""
    parser = argparse.ArgumentParser(description="Be the robot from outside, in real time.")
    add = parser.add_argument
    add("--serial", required=True, help="symbolic link to make for the regulator's pseudo-terminal")
    add("--rail-port", type=int, required=True)
    add("--endpoint", default="tcp/127.0.0.1:7447", help="where the daemon listens for motion capture")
    add("--status", required=True, help="file to make: one JSON object and blanks, twenty times a second")
    add("--bound-m", type=float, default=0.255, help="of the cart from the middle; excursions beyond are counted")
    options = parser.parse_args()

    with contextlib.suppress(PermissionError):  # before any thread starts, since threads inherit it
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    drive = Drive(LATENCY_S, keep=False, friction_n=FRICTION_N)
    robot = Robot(Body(FRICTION_N), drive, options.bound_m)
    port = Port(drive, "127.0.0.1", options.rail_port)
    board = Board(robot.firmware, options.serial, lambda: robot.body.pressure_kpa)
    cameras = Cameras(options.endpoint, KEY, CAMERA_DELAY_S, CAMERA_NOISE_M)
    try:
        run(robot, port, board, cameras, options.status)
    finally:
        board.close()
        port.close()
        cameras.close()


class Pace:
    """Absolute deadlines of the steps, with statistics of their lateness."""

    def __init__(self, begin: float) -> None:
        self._begin = begin
        self._stalled = False
        self.steps = self.late_steps = self.stalls = 0
        self.max_late_s = self.paused_s = 0.0

    @property
    def due(self) -> float:
        """Return the time of the next step."""
        return self._begin + self.steps * STEP_S

    def step(self, now: float) -> float:
        """Record a step taken now and return its nominal time."""
        late = now - self.due
        self.late_steps += late > LATE_S
        self.stalls += late > STALL_S and not self._stalled
        self._stalled = late > STALL_S
        self.max_late_s = max(self.max_late_s, late)
        if late > PAUSE_S:
            self._begin += late
            self.paused_s += late
        due, self.steps = self.due, self.steps + 1
        return due

    def figures(self) -> dict[str, float]:
        """Return the statistics for the status file."""
        return {name: value for name, value in vars(self).items() if not name.startswith("_")}


def run(robot: Robot, port: Port, board: Board, cameras: Cameras, status: str) -> None:
    """Run the robot until a signal arrives."""
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    file = os.open(status, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o644)
    pace = Pace(time.monotonic())
    frame_due = status_due = pace.due
    while not ended.is_set():
        now = time.monotonic()
        if now < pace.due:
            time.sleep(pace.due - now)
            continue
        due = pace.step(now)
        board.watch()
        port.serve(now)
        robot.step(due)
        if due >= frame_due:
            frame_due = max(frame_due + 1 / FRAME_RATE_HZ, due)
            cameras.take(int(due * 1e9), robot.body.poses())
        cameras.send(int(now * 1e9))
        if due >= status_due:
            status_due = due + STATUS_S
            # Written in place, since renaming may wait for the disk. A reader of a partial file tries again.
            text = json.dumps({"t_s": due, **robot.truth(), **pace.figures()})
            os.pwrite(file, text.encode().ljust(STATUS_BYTES), 0)
    os.close(file)


if __name__ == "__main__":
    main()
