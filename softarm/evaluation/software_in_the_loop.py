"""Software in the loop: twin and daemon as two processes, connected by a pty, TCP and Zenoh.

The demo, the benchmark of the loop and tests use it. The processes are `softarm twin` and `softarm run`, and every
request uses REST.
"""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

import httpx
import yaml

from softarm.common import http
from softarm.schemas.goals import Goal
from softarm.schemas.policy import Observation

START_S = 60.0  # a cold start compiles the simulator
STOP_S = 5.0
SETTLED_M_S = 0.05  # tip speed of an arm that hangs nearly still
SETTLE_MIN_S, SETTLE_MAX_S = 0.5, 6.0
POLL_S = 0.05


class SoftwareInTheLoopError(Exception):
    """A process did not start or ended early (with its last output), or the daemon refused a request (with why)."""


class SoftwareInTheLoop:
    """Context in which twin and daemon run on free ports of this machine."""

    def __init__(
        self,
        logs: Path,
        overrides: dict[str, Any] | None = None,
        model: Path | None = None,
        twin_drivers: dict[str, Any] | None = None,
    ) -> None:
        """Prepare both processes, with recordings in `logs`.

        `overrides` are keys of the configuration file. `twin_drivers` are addresses of the twin, if a proxy is between
        twin and daemon.
        """
        self._twin_options = [] if model is None else ["--model", str(model)]
        self._folder = tempfile.TemporaryDirectory(prefix="softarm-")
        self.folder = Path(self._folder.name)
        mocap, rail, api, stop = free_ports(4)
        self.url, self.stop_port = f"http://127.0.0.1:{api}", stop
        self.settings: dict[str, Any] = {
            "drivers": {
                "mocap": {"endpoint": f"tcp/127.0.0.1:{mocap}"},
                "regulator": {"port": str(self.folder / "regulator")},
                "rail": {"host": "127.0.0.1", "port": rail},
            },
            "api": {"port": api, "stop_port": stop},
            "recorder": {"directory": str(logs)},
        }
        self.settings = _merged(self.settings, overrides or {})
        self.config_file, self._twin_file = self.folder / "softarm.yaml", self.folder / "twin.yaml"
        self.config_file.write_text(yaml.safe_dump(self.settings))
        apart = {} if twin_drivers is None else {"drivers": twin_drivers}
        self._twin_file.write_text(yaml.safe_dump(self.settings | apart))
        self.client = http.client(self.url)
        self.twin: subprocess.Popen[bytes] | None = None
        self.daemon: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        """Start both and wait until the daemon is healthy."""
        try:
            self.start_twin()
            self.start_daemon()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.end()
        self.client.close()
        self._folder.cleanup()

    def end(self) -> None:
        """End the daemon, then the twin."""
        for process in (self.daemon, self.twin):
            if process is not None:
                _end(process)

    def start_twin(self) -> None:
        """Start the twin and wait until it is ready."""
        self.twin = self._start("twin", self._twin_file, *self._twin_options)
        link = Path(yaml.safe_load(self._twin_file.read_text())["drivers"]["regulator"]["port"])
        self._wait("twin", self.twin, link.exists)

    def start_daemon(self) -> None:
        """Start the daemon, wait until it can be armed, and acknowledge a stop of the daemon before it."""
        self.daemon = self._start("run", self.config_file)
        self._wait("run", self.daemon, self._ready_to_arm)

    def _ready_to_arm(self) -> bool:
        """Acknowledge a latched stop and return whether arming would be accepted."""
        with contextlib.suppress(httpx.HTTPError):
            status = self.status()
            if status["estop"] == "latched":
                self._acknowledge(status["last_stop"])
            return bool(status["arming_refusals"] == [])
        return False

    def _acknowledge(self, last_stop: str) -> None:
        self.client.post("/api/acknowledge")

    def arm(self) -> None:
        """Arm and wait. Raises SoftwareInTheLoopError with the daemon's reasons."""
        self.post("arm")
        deadline = time.monotonic() + 5.0
        while (status := self.status())["mode"] != "armed":
            if time.monotonic() > deadline:
                raise SoftwareInTheLoopError(f"did not arm: {status['mode']}, {status['last_stop']}")
            time.sleep(0.02)

    def post(self, verb: str, **body: Any) -> None:
        """Send POST /api/VERB. Raises SoftwareInTheLoopError with the daemon's reasons."""
        answer = self.client.post(f"/api/{verb}", json=body or None)
        if answer.status_code != 200:
            stopped = self.status()["last_stop"]
            raise SoftwareInTheLoopError(f"{verb} was refused: {answer.json()['detail']} (last stop: {stopped})")

    def reach(self, goal: Goal) -> None:
        """Set a target. Raises SoftwareInTheLoopError if the daemon refuses it."""
        self.post("goal", kind="reach", y_m=goal.y_m, z_m=goal.z_m)

    def fly(self, goal: Goal, on_tip: Callable[[float, float], None]) -> dict[str, Any]:
        """Fly to a target from a hanging arm and return the last answer of GET /api/goal.

        `on_tip` receives the tip's y and z, m. Raises SoftwareInTheLoopError if the daemon refuses the target.
        """
        self.settle()
        self.reach(goal)
        while (result := self.client.get("/api/goal").json())["state"] == "running":
            observed = self.observed()
            on_tip(observed.tip_y_m, observed.tip_z_m)
            time.sleep(POLL_S)
        return dict(result)

    def status(self) -> dict[str, Any]:
        """Return the answer of GET /api/status."""
        return dict(self.client.get("/api/status").raise_for_status().json())

    def observed(self) -> Observation:
        """Return the newest observation. Raises SoftwareInTheLoopError if there is none."""
        status = self.status()
        if status["observed"] is None:
            raise SoftwareInTheLoopError(f"no observation: {status['mode']}, last stop: {status['last_stop']}")
        return Observation(*status["observed"]["values"])

    def printed(self, verb: str) -> str:
        """Return the output of a process."""
        path = self.folder / f"{verb}.out"
        return path.read_text(errors="replace") if path.exists() else ""

    def settle(self) -> None:
        """Wait until the arm hangs nearly still, or until a time limit."""
        started = time.monotonic()
        while (passed := time.monotonic() - started) < SETTLE_MAX_S:
            observed = self.observed()
            if passed > SETTLE_MIN_S and max(abs(observed.tip_vy_m_s), abs(observed.tip_vz_m_s)) < SETTLED_M_S:
                return
            time.sleep(POLL_S)

    def _start(self, verb: str, config_file: Path, *options: str) -> subprocess.Popen[bytes]:
        with (self.folder / f"{verb}.out").open("ab") as output:
            return subprocess.Popen(
                [sys.executable, "-m", "softarm.cli.main", verb, "--config", str(config_file), *options],
                stdout=output,
                stderr=subprocess.STDOUT,
                env={**os.environ, "PYTHONUNBUFFERED": "1"},
            )

    def _wait(self, verb: str, process: subprocess.Popen[bytes], ready: Callable[[], bool]) -> None:
        deadline = time.monotonic() + START_S
        while not ready():
            if process.poll() is not None:
                raise SoftwareInTheLoopError(f"`softarm {verb}` ended with {process.returncode}:\n{self._tail(verb)}")
            if time.monotonic() > deadline:
                raise SoftwareInTheLoopError(
                    f"`softarm {verb}` is not ready after {START_S:.0f} s:\n{self._tail(verb)}"
                )
            time.sleep(POLL_S)

    def _tail(self, verb: str) -> str:
        lines = self.printed(verb).splitlines()[-15:]
        if verb == "run":
            with contextlib.suppress(httpx.HTTPError, KeyError):
                lines += [f"arming refused: {reason}" for reason in self.status()["arming_refusals"]]
        return "\n".join(lines)


def _merged(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Merge nested sections; `above` overrides `below`."""
    return below | {
        key: _merged(below[key], value) if isinstance(value, dict) and isinstance(below.get(key), dict) else value
        for key, value in above.items()
    }


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def free_ports(count: int) -> list[int]:
    """Return TCP ports of this machine that are free now."""
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket()) for _ in range(count)]
        for one in sockets:
            one.bind(("127.0.0.1", 0))
        return [one.getsockname()[1] for one in sockets]
