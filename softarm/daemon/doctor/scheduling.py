"""Checks that this computer wakes threads in time: priority, memory lock, cores and measured timers."""

import os
import resource
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from softarm.common import realtime
from softarm.common.finding import Finding, State, by, graded, ok, problem, warning

MEASURED_S = 1.5
INTERVAL_NS = 2_000_000
LATE_FINE_MS, LATE_BEARABLE_MS = 2.0, 8.0  # a tick has 33 ms, of which the devices take the most
MEMORY_BYTES = 16_000_000  # what the rail's process keeps in memory, nearly: docs/operate/service.md
GOVERNORS = "/sys/devices/system/cpu/cpu*/cpufreq/scaling_governor"


@dataclass(frozen=True, slots=True)
class Scheduling:
    """Facts about privileges, load and timers."""

    priority: int  # configured priority; 0 for none
    granted: bool
    memlock_bytes: float
    cores: int
    load: float  # of the last minute
    governors: frozenset[str]  # empty if unknown
    late_ms: tuple[float, ...] = field(repr=False)  # lateness of each wake-up


def look(priority: int, seconds: float = MEASURED_S) -> Scheduling:
    """Measure for some seconds in a separate, mostly sleeping thread."""
    with ThreadPoolExecutor(1) as separate:
        granted, late_ms = separate.submit(_lateness, priority, seconds).result()
    soft, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    unlimited = soft == resource.RLIM_INFINITY or os.geteuid() == 0
    governors = (path.read_text().strip() for path in Path("/").glob(GOVERNORS.lstrip("/")))
    return Scheduling(
        priority,
        granted,
        float("inf") if unlimited else soft,
        len(os.sched_getaffinity(0)),
        os.getloadavg()[0],
        frozenset(governors),
        late_ms,
    )


def _lateness(priority: int, seconds: float) -> tuple[bool, tuple[float, ...]]:
    """Return whether the priority was granted, and the lateness of each wake-up, ms."""
    granted = priority > 0 and realtime.ask(priority) is None
    late_ms, begun_ns = [], time.monotonic_ns()
    for due_ns in range(begun_ns + INTERVAL_NS, begun_ns + round(seconds * 1e9), INTERVAL_NS):
        if (left_ns := due_ns - time.monotonic_ns()) > 0:
            time.sleep(left_ns * 1e-9)
            late_ms.append((time.monotonic_ns() - due_ns) * 1e-6)
    return granted, tuple(late_ms)


def judge(facts: Scheduling, simulated: bool = False) -> Iterator[Finding]:
    """Yield findings on cores, governor and timers and, for a real robot, on priority and memory lock."""
    if not simulated:
        yield from _privileges(facts)
    yield from _power(facts)
    yield _timers(facts)


def _privileges(facts: Scheduling) -> Iterator[Finding]:
    if facts.priority == 0:
        advice = "set control.realtime_priority, e.g. to 20"
        yield warning("real-time priority", "off (control.realtime_priority is 0)", advice)
    elif facts.granted:
        yield ok("real-time priority", f"SCHED_FIFO {facts.priority} is granted")
    else:
        advice = "use the service (`softarm service install`), or `ulimit -r 50` as root or in limits.conf"
        yield warning("real-time priority", f"SCHED_FIFO {facts.priority} is not granted to this user", advice)
    if facts.memlock_bytes >= MEMORY_BYTES:
        yield ok("memory lock", "unlimited" if facts.memlock_bytes == float("inf") else _mb(facts.memlock_bytes))
    else:
        advice = "the rail's process may be swapped out: use the service, or `ulimit -l 65536`"
        yield warning("memory lock", f"{_mb(facts.memlock_bytes)}, {_mb(MEMORY_BYTES)} needed", advice)


def _power(facts: Scheduling) -> Iterator[Finding]:
    figure = f"{facts.cores}, load {facts.load:.1f}"
    if facts.cores < 2:
        yield warning("cores", figure, "use a computer with two cores, one for the rail's process")
    elif facts.load > facts.cores:
        yield warning("cores", figure, "other programs use all cores: end them before a flight")
    else:
        yield ok("cores", figure)
    state = State.WARNING if "powersave" in facts.governors else State.OK
    advice = "slow wake-ups delay ticks: run `cpupower frequency-set -g performance`"
    yield graded("governor", state, ", ".join(sorted(facts.governors)) or "unknown", advice)


def _timers(facts: Scheduling) -> Finding:
    if not facts.late_ms:
        return problem("timers", "no wake-up was in time", "this computer is overloaded: end other programs")
    median, most = float(np.median(facts.late_ms)), max(facts.late_ms)
    p99 = float(np.percentile(facts.late_ms, 99))
    figure = (
        f"wake-ups {median:.2f} ms late (median), {p99:.2f} ms (99 %), {most:.2f} ms (worst of {len(facts.late_ms)})"
    )
    state = by(p99, LATE_FINE_MS, LATE_BEARABLE_MS)
    effect = "ticks would be missed: " if state is State.PROBLEM else ""
    return graded("timers", state, figure, f"{effect}end other programs, or grant real-time priority")


def _mb(count: float) -> str:
    return f"{count / 1e6:.3g} MB"
