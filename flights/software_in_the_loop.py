"""Software in the loop: twin and daemon as two processes of their own, joined by a pty, TCP and Zenoh.

The demo, the loop's benchmark and tests fly it. The processes are the commands that a person starts, `softarm twin`
and `softarm run`; all that is asked of them goes over REST.
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
from types import TracebackType
from typing import Any, Self

import httpx
import yaml

from softarm.schemas.goals import Goal
from softarm.schemas.policy import Observation

START_S = 60.0  # a cold start compiles the simulator
STOP_S = 5.0
SETTLED_M_S = 0.05  # tip speed at which the arm hangs nearly still
SETTLE_MIN_S, SETTLE_MAX_S = 0.5, 6.0
POLL_S = 0.05


class SoftwareInTheLoopError(Exception):
    """A process did not come up or went away, with the end of what it printed; or the daemon refused, with why."""


class SoftwareInTheLoop:
    """A context: inside it twin and daemon run on free ports of this machine, outside it neither does."""

    def __init__(
        self,
        logs: Path,
        overrides: dict[str, Any] | None = None,
        model: Path | None = None,
        twin_drivers: dict[str, Any] | None = None,
    ) -> None:
        """`overrides`: further keys of the configuration file, or other values; `model`: the twin's model file.

        `twin_drivers`: where the twin answers, when that is not where the daemon asks: something stands between them.
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
        self.client = httpx.Client(base_url=self.url, timeout=5.0)
        self.twin: subprocess.Popen[bytes] | None = None
        self.daemon: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        """Start both and wait until the daemon is healthy."""
        try:
            self.start_twin()
            self.start_daemon()
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.end()
        self.client.close()
        self._folder.cleanup()

    def end(self) -> None:
        """End the daemon, then the twin."""
        for process in (self.daemon, self.twin):
            if process is not None:
                _end(process)

    def start_twin(self) -> None:
        """The robot."""
        self.twin = self._start("twin", self._twin_file, *self._twin_options)
        link = Path(yaml.safe_load(self._twin_file.read_text())["drivers"]["regulator"]["port"])
        self._wait("twin", self.twin, link.exists)

    def start_daemon(self) -> None:
        """The daemon, until it sees the whole robot. A stop that the one before it left is acknowledged."""
        self.daemon = self._start("run", self.config_file)
        self._wait("run", self.daemon, self._taken_up)

    def healthy(self) -> bool:
        """Would arming be accepted?"""
        with contextlib.suppress(httpx.TransportError):
            status = self.client.get("/api/status")
            return status.status_code == 200 and status.json()["arming_refusals"] == []
        return False

    def _taken_up(self) -> bool:
        """Healthy, once nothing that was left holds it."""
        with contextlib.suppress(httpx.TransportError):
            status = self.client.get("/api/status")
            if status.status_code == 200 and status.json()["estop"] == "latched":
                self.client.post("/api/acknowledge")
        return self.healthy()

    def arm(self) -> None:
        """Arm and wait until it is.

        Raises SoftwareInTheLoopError with the daemon's own reasons.
        """
        self.post("arm")
        deadline = time.monotonic() + 5.0
        while (status := self.status())["mode"] != "armed":
            if time.monotonic() > deadline:
                raise SoftwareInTheLoopError(f"did not arm: {status['mode']}, {status['last_stop']}")
            time.sleep(0.02)

    def post(self, verb: str, **body: Any) -> None:
        """POST /api/VERB.

        Raises SoftwareInTheLoopError with the daemon's own reasons when it refuses.
        """
        answer = self.client.post(f"/api/{verb}", json=body or None)
        if answer.status_code != 200:
            stopped = self.status()["last_stop"]
            raise SoftwareInTheLoopError(f"{verb} was refused: {answer.json()['detail']} (last stop: {stopped})")

    def reach(self, goal: Goal) -> None:
        """Give the arm a target. Raises SoftwareInTheLoopError when it is refused."""
        self.post("goal", kind="reach", y_m=goal.y_m, z_m=goal.z_m)

    def fly(self, goal: Goal, on_tip: Callable[[float, float], None]) -> dict[str, Any]:
        """A target from a hanging arm to its end; returns GET /api/goal's last answer. on_tip(y, z, in metres).

        Raises SoftwareInTheLoopError when it is refused.
        """
        self.settle()
        self.reach(goal)
        while (result := self.client.get("/api/goal").json())["state"] == "running":
            observed = self.observed()
            on_tip(observed.tip_y_m, observed.tip_z_m)
            time.sleep(POLL_S)
        return dict(result)

    def status(self) -> dict[str, Any]:
        """GET /api/status."""
        return dict(self.client.get("/api/status").raise_for_status().json())

    def observed(self) -> Observation:
        """The newest observation. Raises SoftwareInTheLoopError while there is none."""
        status = self.status()
        if status["observed"] is None:
            raise SoftwareInTheLoopError(f"nothing is observed: {status['mode']}, last stop: {status['last_stop']}")
        return Observation(*status["observed"]["values"])

    def printed(self, verb: str) -> str:
        """What a process has printed."""
        path = self.folder / f"{verb}.out"
        return path.read_text(errors="replace") if path.exists() else ""

    def settle(self) -> None:
        """Wait until the arm hangs nearly still, or for long enough."""
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
    """Sections key by key; what stands above counts."""
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
    """So many TCP ports that nobody listens at now."""
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket()) for _ in range(count)]
        for one in sockets:
            one.bind(("127.0.0.1", 0))
        return [one.getsockname()[1] for one in sockets]
