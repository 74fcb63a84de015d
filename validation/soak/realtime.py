"""Soak test in real time: daemon and twin as separate processes, with faults and misbehaving clients."""

import contextlib
import json
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import httpx
import numpy as np
import zenoh

from softarm.drivers.mocap import zenoh_session
from softarm.drivers.twin.cameras import FAULT_KEY, STATE_KEY
from softarm.evaluation.software_in_the_loop import SoftwareInTheLoop
from validation.soak import growth
from validation.soak.clients import Act, Hammer, Script, Unexpected
from validation.soak.growth import Slope, Statistic, slope

LOOK_S = 0.1  # between two reads of the status
SAMPLES = 1000  # per run, at least 1 s apart
RAIL_PROCESS = "softarm.drivers.rail.process"  # on its command line
KEEP_MB, FILE_MB = 20, 5  # small, so that files are rotated and deleted within the run
AROUND_S = 1.0  # a new file may begin this soon after disarming
LOGS_MAX_MB = KEEP_MB + 50  # the file being written does not end while the robot flies

# Growth per hour that does not count as a leak, and the statistic of a window.
ALLOWED: dict[str, tuple[float, Statistic]] = {
    "memory_mb": (10.0, np.min),
    "descriptors": (3.0, np.min),
    "threads": (2.0, np.min),
    "cpu_percent": (10.0, np.median),
    "late_ms": (0.5, np.median),
}


class Sample(NamedTuple):
    """Resources of the daemon and of the rail's process at one time."""

    time_h: float
    memory_mb: float
    descriptors: int
    threads: int
    cpu_percent: float  # of one core, since the sample before
    late_ms: float  # median since the sample before
    missed: int  # ticks, since the beginning
    logs_mb: float


class Soaked(NamedTuple):
    """Result of a soak test in real time."""

    seed: int
    hours: float
    armed_share: float  # of the time
    samples: list[Sample]
    slopes: dict[str, Slope]
    counts: dict[str, int]
    unexpected: list[Unexpected]
    cart_max_m: float
    logs_max_mb: float


def soak(hours: float, seed: int, logs: Path, on_progress: Callable[[str, float], None]) -> Soaked:
    """Fly for `hours` and write recordings to the empty folder `logs`.

    `on_progress` receives a text and the share done. Raises SoftwareInTheLoopError if twin or daemon does not start.
    """
    recorder = {"directory": str(logs), "keep_mb": KEEP_MB, "file_max_mb": FILE_MB, "around_s": AROUND_S}
    with SoftwareInTheLoop(logs, {"recorder": recorder}) as sil, contextlib.ExitStack() as stack:
        assert sil.daemon is not None
        session = stack.enter_context(zenoh.open(zenoh_session.client(sil.settings["drivers"]["mocap"]["endpoint"])))
        states = session.declare_subscriber(STATE_KEY, zenoh.handlers.RingChannel(1))
        watch = _Watch(sil.daemon.pid, logs)
        script, begun_s = Script(seed), time.monotonic()
        unexpected = script.unexpected
        # A trial of a policy may take a minute, so requests run in threads.
        with Hammer(sil.url, sil.stop_port, seed) as hammer, ThreadPoolExecutor(8) as doing:
            truth: dict[str, Any] = {}
            while (now_s := time.monotonic() - begun_s) < 3600 * hours:
                if sil.daemon.poll() is not None:
                    unexpected.append(Unexpected(now_s, f"the daemon ended with {sil.daemon.returncode}", None))
                    break
                try:
                    status = sil.status()
                    for act in script.acts(status, now_s):
                        doing.submit(_do, act, sil.url, session, script.counts)
                    watch.look(status)
                except httpx.HTTPError as error:
                    what = f"no answer to the script: {type(error).__name__} {error}"
                    unexpected.append(Unexpected(now_s, what, None))
                while (sample := states.try_recv()) is not None:
                    truth = json.loads(sample.payload.to_bytes())
                watch.sample_when_due(3600 * hours)
                on_progress(f"{script.counts['goals']} goals, {len(unexpected)} unexpected", now_s / 3600 / hours)
                time.sleep(LOOK_S)
        end_s = time.monotonic() - begun_s
        unexpected += [Unexpected(end_s, what, None) for what in _anomalies(sil, hammer, truth, watch)]
        counts = script.counts + Counter({f"answer: {code}": n for code, n in hammer.answers.items()})
    slopes = {
        name: slope([s.time_h for s in watch.samples], [getattr(s, name) for s in watch.samples], allowed, of)
        for name, (allowed, of) in ALLOWED.items()
    }
    hours, armed, counted = end_s / 3600, script.armed / max(1, script.looks), dict(sorted(counts.items()))
    cart_max_m = float(truth.get("cart_max_abs_m", 0.0))
    return Soaked(seed, hours, armed, watch.samples, slopes, counted, unexpected, cart_max_m, watch.logs_max_mb)


class _Watch:
    """Keeps samples of the daemon."""

    def __init__(self, pid: int, logs: Path) -> None:
        self._logs = logs
        self._watch(pid)
        self._begun_s = self._sampled_s
        self._late_ms: list[float] = []
        self._missed = 0
        self.logs_max_mb = 0.0
        self.samples: list[Sample] = []

    def _watch(self, pid: int) -> None:
        """Watch the daemon and the rail's process; the process of a policy trial is temporary."""
        self._pids = [pid, *(child for child in growth.children(pid) if RAIL_PROCESS in growth.command(child))]
        self._cpu_s, self._sampled_s = growth.usage_of(self._pids).cpu_s, time.monotonic()

    def look(self, status: dict[str, Any]) -> None:
        """Record lateness and missed ticks of a status."""
        self._late_ms.append(status["late_ns"] * 1e-6)
        self._missed = status["missed_total"]

    def sample_when_due(self, total_s: float) -> None:
        """Sample the processes if the next sample is due."""
        now_s = time.monotonic()
        if now_s - self._sampled_s < max(1.0, total_s / SAMPLES) or not self._late_ms:
            return
        try:
            now = growth.usage_of(self._pids)
        except OSError:  # the rail's process was replaced, or the daemon has ended
            with contextlib.suppress(OSError):
                self._watch(self._pids[0])
            return
        logs_mb = growth.folder_mb(self._logs)
        self.logs_max_mb = max(self.logs_max_mb, logs_mb)
        late_ms = sorted(self._late_ms)[len(self._late_ms) // 2]
        cpu = 100 * (now.cpu_s - self._cpu_s) / (now_s - self._sampled_s)
        time_h, used = (now_s - self._begun_s) / 3600, (now.memory_mb, now.descriptors, now.threads)
        self.samples.append(Sample(time_h, *used, cpu, late_ms, self._missed, logs_mb))
        self._sampled_s, self._cpu_s, self._late_ms = now_s, now.cpu_s, []


def _do(act: Act, url: str, session: zenoh.Session, counts: Counter[str]) -> None:
    if act.kind == "fault":
        session.put(FAULT_KEY, act.path.encode())
        return
    try:
        answer = httpx.request(act.kind, url + act.path, json=act.body, timeout=130.0 if act.kind == "PUT" else 5.0)
    except httpx.TransportError as error:
        counts[f"unanswered: {act.kind} {act.path}: {type(error).__name__}"] += 1
        return
    if answer.is_error:
        counts[f"refused: {act.kind} {act.path}: {answer.status_code}"] += 1


def _anomalies(sil: SoftwareInTheLoop, hammer: Hammer, truth: dict[str, Any], watch: _Watch) -> list[str]:
    """List unexpected events other than stops."""
    found = [f"{what} ({times} times)" for what, times in hammer.wrong.items()]
    for verb in ("run", "twin"):
        lines = sil.printed(verb).splitlines()
        found += [f"softarm {verb}: {line}" for line in lines if line.startswith(("ERROR", "CRITICAL", "Traceback"))]
    if truth.get("crashes"):
        found.append(f"the cart struck the end of its rail {truth['crashes']} times")
    if watch.logs_max_mb > LOGS_MAX_MB:
        found.append(f"the logs took {watch.logs_max_mb:.0f} MB; retention of {KEEP_MB} allows {LOGS_MAX_MB}")
    return found
