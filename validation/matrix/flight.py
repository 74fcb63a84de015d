"""Execution of the cells, with a daemon, a twin, disturbed wires between them and a sweeping cart."""

import contextlib
import os
import re
import resource
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Self

import httpx
from anyio.from_thread import start_blocking_portal

from softarm.daemon.logbook import logs
from softarm.evaluation.software_in_the_loop import SoftwareInTheLoopError, free_ports
from validation.daemon_process import DisturbedDaemon
from validation.matrix import faulty_policies
from validation.matrix.cells import DEVICES, Cell, Outcome
from validation.matrix.wires import Fault, MocapWire, RailWire, RegulatorWire, Wire

FAULT_S = 2.0
MOVING_S = 1.2  # motion before a fault
RECOVERY_S = 8.0
SETTLED_S = 0.3
POLL_S = 0.03
EXIT_S = 10.0
POLICY_S = faulty_policies.GOOD_S - 0.3  # a goal is slightly older than its answer


class Bench(DisturbedDaemon):
    """Context in which daemon, twin and the wires between them run; `truth` holds the robot's true states."""

    def __init__(self, folder: Path) -> None:
        ports = free_ports(4)
        endpoints = [f"tcp/127.0.0.1:{port}" for port in ports[:2]]
        lines = [folder / "regulator", folder / "regulator-device"]
        ours, theirs = (
            {
                "mocap": {"endpoint": endpoints[side]},
                "regulator": {"port": str(lines[side])},
                "rail": {"host": "127.0.0.1", "port": ports[2 + side]},
            }
            for side in range(2)
        )
        overrides = {
            "drivers": ours,
            "control": {"policy": "sweep"},
            "goals": {"time_limit_s": 600.0},
            "policies": {each: {"plugin": "sweep", "options": {"fault": each}} for each in faulty_policies.FAULTS},
        }
        super().__init__(folder / "logs", overrides, theirs)
        self.truth: list[dict[str, Any]] = []
        self.wires: dict[str, Wire] = {
            "rail": RailWire(0, ports[2], ports[3]),
            "regulator": RegulatorWire(1, lines[0], lines[1]),
            "mocap": MocapWire(2, endpoints[0], endpoints[1], self.truth.append),
        }
        self._bench_folder = str(folder)

    def __enter__(self) -> Self:
        portal = self.beside.enter_context(start_blocking_portal())
        for wire in self.wires.values():
            self.beside.callback(portal.start_task_soon(wire.run).cancel)
        return super().__enter__()

    def plain(self, text: str) -> str:
        """Return a text without folder and ports, which differ between runs."""
        return re.sub(r"127\.0\.0\.1:\d+", "127.0.0.1", text.replace(self._bench_folder, "").replace("|", "/"))

    def sweep(self, policy: str) -> None:
        """Select a sweeping policy and let it drive. Raises SoftwareInTheLoopError."""
        self.recover(2 * RECOVERY_S)
        answer = self.client.put("/api/policy", json={"name": policy}, timeout=30)
        if answer.status_code != 200:
            raise SoftwareInTheLoopError(f"PUT policy {policy}: {answer.text}")
        self.drive(2 * RECOVERY_S)


def events(log: Path, since_ns: int, until_ns: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
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
        for wire in bench.wires.values():
            wire.mend()
    try:
        if bench.process.poll() is not None:
            bench.start_daemon()
        bench.recover(RECOVERY_S)
    except SoftwareInTheLoopError:  # again, with the cart in the middle
        bench.end()
        bench.start_twin()
        bench.start_daemon()
    return outcome


def _fly(bench: Bench, cell: Cell, outcome: Outcome) -> None:
    if cell.phase == "open":
        bench.recover(RECOVERY_S)
        bench.post("disarm")
    else:
        bench.sweep(cell.fault if cell.who == "policy" else "sweep")
        time.sleep(0.0 if cell.who == "policy" else MOVING_S)
    log = Path(bench.status()["recorder"]["log"])
    crashes, mark = bench.truth[-1]["crashes"], len(bench.truth)
    since_ns = time.monotonic_ns() + (int(POLICY_S * 1e9) if cell.who == "policy" else 0)
    with _wrong(bench, cell):
        _watch(bench, outcome, FAULT_S + (faulty_policies.GOOD_S if cell.who == "policy" else 0.0))
        _measure(bench, outcome, mark, crashes, since_ns)
    until_ns = time.monotonic_ns()
    if cell.phase == "close" or (cell.who, cell.fault) == ("daemon", "kill -9"):
        bench.start_daemon()
        outcome.recovery = "a restarted daemon arms"
        outcome.stopped = True
    if cell.phase == "process":
        _watch(bench, outcome, 1.0)  # messages of a daemon that resumes
        until_ns = time.monotonic_ns()
    outcome.causes, outcome.logged = events(log, since_ns, until_ns)
    resumed = "acknowledged, then armed" if bench.recover(RECOVERY_S) else "armed again"
    outcome.recovery = outcome.recovery or ("-" if not outcome.stopped else resumed)
    if bench.process.poll() is None and not outcome.stopped:
        bench.post("disarm")
    time.sleep(SETTLED_S)


@contextlib.contextmanager
def _wrong(bench: Bench, cell: Cell) -> Iterator[None]:
    """Apply the fault of a cell while the context lasts."""
    daemon = bench.process
    if cell.who in DEVICES:
        wire = bench.wires[cell.who]
        wire.spoil(Fault(cell.fault), *cell.directions)
        if cell.phase == "open":
            wire.hang_up()
        if cell.phase == "close":
            daemon.send_signal(signal.SIGTERM)
        yield
        if cell.phase == "close":
            try:
                daemon.wait(EXIT_S)
            except subprocess.TimeoutExpired:
                raise SoftwareInTheLoopError(f"the daemon did not end within {EXIT_S:g} s") from None
        wire.mend()
    elif cell.who == "disk":
        before = resource.prlimit(daemon.pid, resource.RLIMIT_FSIZE)
        log = Path(bench.status()["recorder"]["log"])
        resource.prlimit(daemon.pid, resource.RLIMIT_FSIZE, (log.stat().st_size, before[1]))
        try:
            yield
        finally:
            resource.prlimit(daemon.pid, resource.RLIMIT_FSIZE, before)
    elif cell.phase == "process":
        pid = daemon.pid if cell.who == "daemon" else bench.rail_process()
        os.kill(pid, signal.SIGKILL if cell.fault == "kill -9" else signal.SIGSTOP)
        try:
            yield
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)
        if pid == daemon.pid and cell.fault == "kill -9":
            daemon.wait(EXIT_S)
    else:
        yield


def _watch(bench: Bench, outcome: Outcome, seconds: float) -> None:
    """Poll the status for a while and keep the message that an operator would read."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        with contextlib.suppress(httpx.HTTPError):
            status = bench.client.get("/api/status", timeout=0.5).raise_for_status().json()
            outcome.stopped |= status["mode"] != "armed"
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


def fly_all(cells: list[Cell]) -> Iterator[tuple[Cell, Outcome]]:
    """Fly cells one after the other. Raises SoftwareInTheLoopError if the bench does not start."""
    with tempfile.TemporaryDirectory(prefix="softarm-matrix-") as folder, Bench(Path(folder)) as bench:
        for cell in cells:
            yield cell, fly(bench, cell)
