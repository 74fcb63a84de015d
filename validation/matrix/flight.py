"""Execution of the cells, with a daemon, a twin, disturbed wires between them and a sweeping cart."""

import contextlib
import os
import re
import resource
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx

from softarm.daemon.logbook import logs
from softarm.evaluation.software_in_the_loop import SoftwareInTheLoop, SoftwareInTheLoopError, free_ports
from softarm.schemas.config import Config
from validation.daemon_process import plugins, rail_process_of, recover
from validation.matrix import faulty_policies
from validation.matrix.cells import DEVICES, Cell, Outcome
from validation.matrix.wires import Fault, MocapWire, RailWire, RegulatorWire, Wire, Wires

FAULT_S = 2.0
MOVING_S = 1.2  # motion before a fault
RECOVERY_S = 8.0
SETTLED_S = 0.3
POLL_S = 0.03
EXIT_S = 10.0
POLICY_S = faulty_policies.GOOD_S - 0.3  # a goal is slightly older than its answer
FULL_BYTES = 200_000  # how much the log may grow


class Bench:
    """Context in which daemon, twin and the wires between them run; `truth` holds the robot's true states."""

    def __init__(self, folder: Path, seed: int = 0) -> None:
        self._folder = folder
        self._logs = folder / "logs"
        ports = free_ports(4)
        endpoints = [f"tcp/127.0.0.1:{port}" for port in ports[:2]]
        lines = [str(folder / "regulator"), str(folder / "regulator-device")]
        sides: list[dict[str, Any]] = [
            {
                "mocap": {"endpoint": endpoints[side]},
                "regulator": {"port": lines[side]},
                "rail": {"host": "127.0.0.1", "port": ports[2 + side]},
            }
            for side in range(2)
        ]
        self.truth: list[dict[str, Any]] = []
        self.wires = Wires(
            RailWire(seed, ports[2], ports[3]),
            RegulatorWire(seed + 1, Path(lines[0]), Path(lines[1])),
            MocapWire(seed + 2, Config().drivers.mocap.key, endpoints[0], endpoints[1], self.truth.append),
        )
        overrides = {"drivers": sides[0], "control": {"policy": "sweep"}, "goals": {"time_limit_s": 600.0}}
        self.sil = SoftwareInTheLoop(self._logs, overrides, twin_drivers=sides[1])
        self._stack = contextlib.ExitStack()

    def __enter__(self) -> "Bench":
        self._stack.enter_context(plugins(faulty_policies.PLUGINS))
        self._stack.enter_context(self.wires)
        self._stack.enter_context(self.sil)
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def status(self) -> dict[str, Any] | None:
        """Return the daemon's status, or None if it does not answer."""
        with contextlib.suppress(httpx.HTTPError, ValueError):
            return dict(self.sil.client.get("/api/status", timeout=0.5).json())
        return None

    def plain(self, text: str) -> str:
        """Return a text without folder and ports, which differ between runs."""
        return re.sub(r"127\.0\.0\.1:\d+", "127.0.0.1", text.replace(str(self._folder), "").replace("|", "/"))

    def wire(self, device: str) -> Wire:
        """Return the wire of a device."""
        return {"rail": self.wires.rail, "regulator": self.wires.regulator, "mocap": self.wires.mocap}[device]

    def daemon(self) -> subprocess.Popen[bytes]:
        """Return the daemon's process."""
        assert self.sil.daemon is not None
        return self.sil.daemon

    def restart(self) -> None:
        """Start the daemon again after it has ended."""
        self.sil.start_daemon()

    def renew(self) -> None:
        """Restart twin and daemon with the cart in the middle."""
        self.sil.end()
        self.sil.start_twin()
        self.sil.start_daemon()

    def ready(self, patience_s: float = RECOVERY_S) -> str:
        """Wait until arming would be accepted and return how that was reached.

        Raises:
            SoftwareInTheLoopError: Arming is still refused after `patience_s`.
        """
        is_acknowledged = recover(self.sil, patience_s)
        return "acknowledged, then armed" if is_acknowledged else "armed again"

    def sweep(self, policy: str = "sweep") -> None:
        """Arm and start a sweeping policy.

        Raises:
            SoftwareInTheLoopError: A request was refused.
        """
        self.ready(2 * RECOVERY_S)
        answer = self.sil.client.put("/api/policy", json={"name": policy}, timeout=30)
        if answer.status_code != 200:
            raise SoftwareInTheLoopError(f"PUT policy {policy}: {answer.text}")
        self.sil.arm()
        self.sil.post("goal", kind="run")

    def events(self, log: Path, since_ns: int, until_ns: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return the events that stopped the arm or prevented arming in a period, and all events of that period."""
        causes: dict[str, None] = {}
        seen: dict[str, None] = {}
        before = ""
        for _, outputs, _ in logs.read(log):
            if not since_ns <= outputs.t_ns <= until_ns:
                continue
            seen |= {event.name: None for event in outputs.events}
            stops = before in ("armed", "stopping") and outputs.mode in ("stopping", "stopped")
            if outputs.mode == "disarmed" == before or (stops and outputs.mode != before):
                causes |= {event.name: None for event in outputs.events if event.response != "warn"}
            before = outputs.mode
        return tuple(causes), tuple(seen)


def fly(bench: Bench, cell: Cell) -> Outcome:
    """Fly one cell, from a healthy bench to a healthy bench."""
    outcome = Outcome()
    try:
        _fly(bench, cell, outcome)
    except (SoftwareInTheLoopError, httpx.HTTPError, OSError) as error:
        outcome.problems.append(f"not flown: {error}")
    finally:
        for wire in bench.wires:
            wire.mend()
    try:
        if bench.daemon().poll() is not None:
            bench.restart()
        bench.ready()
    except SoftwareInTheLoopError:
        bench.renew()
    return outcome


def _fly(bench: Bench, cell: Cell, outcome: Outcome) -> None:
    if cell.phase == "open":
        bench.ready()
        bench.sil.post("disarm")
    else:
        bench.sweep(cell.fault if cell.who == "policy" else "sweep")
        time.sleep(0.0 if cell.who == "policy" else MOVING_S)
    status = bench.status() or {}
    log = Path(status["recorder"]["log"])
    crashes, mark = bench.truth[-1]["crashes"], len(bench.truth)
    since_ns = time.monotonic_ns() + (int(POLICY_S * 1e9) if cell.who == "policy" else 0)
    with _wrong(bench, cell):
        _watch(bench, outcome, FAULT_S + (faulty_policies.GOOD_S if cell.who == "policy" else 0.0))
        _measure(bench, outcome, mark, crashes, since_ns)
    until_ns = time.monotonic_ns()
    if cell.phase == "close" or (cell.who, cell.fault) == ("daemon", "kill -9"):
        bench.restart()
        outcome.recovery = "a restarted daemon arms"
        outcome.stopped = True
    if cell.phase == "process":
        _watch(bench, outcome, 1.0)  # messages of a daemon that resumes
        until_ns = time.monotonic_ns()
    outcome.causes, outcome.logged = bench.events(log, since_ns, until_ns)
    resumed = bench.ready()
    outcome.recovery = outcome.recovery or ("-" if not outcome.stopped else resumed)
    if bench.daemon().poll() is None and not outcome.stopped:
        bench.sil.post("disarm")
    time.sleep(SETTLED_S)


@contextlib.contextmanager
def _wrong(bench: Bench, cell: Cell) -> Iterator[None]:
    """Apply the fault of a cell while the context lasts."""
    daemon = bench.daemon()
    if cell.who in DEVICES:
        wire = bench.wire(cell.who)
        wire.spoil(Fault(cell.fault), *cell.directions)
        if cell.phase == "open":
            wire.hang_up()
        if cell.phase == "close":
            daemon.send_signal(signal.SIGTERM)
        yield
        if cell.phase == "close" and _ended(daemon, EXIT_S) is None:
            raise SoftwareInTheLoopError(f"the daemon did not end within {EXIT_S:g} s")
        wire.mend()
    elif cell.who == "disk":
        before = resource.prlimit(daemon.pid, resource.RLIMIT_FSIZE)
        log = Path((bench.status() or {})["recorder"]["log"])
        resource.prlimit(daemon.pid, resource.RLIMIT_FSIZE, (log.stat().st_size, before[1]))
        yield
        resource.prlimit(daemon.pid, resource.RLIMIT_FSIZE, before)
    elif cell.phase == "process":
        pid = daemon.pid if cell.who == "daemon" else rail_process_of(daemon.pid)
        os.kill(pid, signal.SIGKILL if cell.fault == "kill -9" else signal.SIGSTOP)
        yield
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)
        if pid == daemon.pid and cell.fault == "kill -9":
            daemon.wait(EXIT_S)
    else:
        yield


def _ended(process: subprocess.Popen[bytes], patience_s: float) -> int | None:
    try:
        return process.wait(patience_s)
    except subprocess.TimeoutExpired:
        return None


def _watch(bench: Bench, outcome: Outcome, seconds: float) -> None:
    """Poll the status for a while and keep the message that an operator would read."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        status = bench.status()
        if status is not None and status["mode"] != "armed":
            outcome.stopped = True
        if status is not None:
            outcome.message = bench.plain(_message(status)) or outcome.message
        time.sleep(POLL_S)


def _message(status: dict[str, Any]) -> str:
    if status["mode"] == "armed":
        texts = [event["text"] for event in status["events"]]
        return texts[0] if texts else ""
    refusals: list[str] = status["arming_refusals"]
    last: str | None = status["last_stop"]
    return last if last and "by request" not in last else refusals[0] if refusals else ""


def _measure(bench: Bench, outcome: Outcome, mark: int, crashes: int, since_ns: int) -> None:
    seen = bench.truth[mark:]
    if not seen:
        outcome.problems.append("not flown: the robot reported no state")
        return
    last = seen[-1]
    outcome.farthest_m = max(abs(state["cart_position_m"]) for state in seen)
    outcome.crashes = last["crashes"] - crashes

    def after_ms(stamp: str) -> float | None:
        return None if last[stamp] is None else max(0.0, (last[stamp] - since_ns) / 1e6)

    outcome.braked_ms, outcome.vented_ms = after_ms("braked_since_ns"), after_ms("vented_since_ns")


def fly_all(cells: list[Cell], report: Callable[[Cell, Outcome], None]) -> None:
    """Fly cells one after the other.

    Raises:
        SoftwareInTheLoopError: The bench does not start.
    """
    with tempfile.TemporaryDirectory(prefix="softarm-matrix-") as folder, Bench(Path(folder)) as bench:
        for cell in cells:
            report(cell, fly(bench, cell))
