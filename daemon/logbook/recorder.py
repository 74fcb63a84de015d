"""The black box: every motion capture frame and every tick into an MCAP file, never holding up the loop.

The loop only appends to a bounded queue. One thread encodes and writes. It hands its bytes to the system
every flush interval, so a daemon that is killed loses no more than that, and to the disk once a second.
"""

import errno
import logging
import os
import shutil
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import BinaryIO

from softarm.common import revision
from softarm.daemon.control.records import Inputs, Outputs, TickTiming
from softarm.daemon.logbook import ticks
from softarm.policies.base import PolicySpec
from softarm.recordings import finishing, mcap_file
from softarm.recordings.live import LiveFile
from softarm.schemas import log as names
from softarm.schemas.config import Config

log = logging.getLogger(__name__)

# What the daemon stands on, besides Python.
PACKAGES = ("numpy", "onnxruntime", "pyserial", "eclipse-zenoh", "pydantic", "mcap", "fastapi", "uvicorn")
FREE_MIN_BYTES = 100_000_000  # about ten minutes
FINISH_S = 5.0  # a log that takes longer to finish at stop is finished at the next start
BREATH_RECORDS, BREATH_S = 20, 0.002  # tidying old logs gives the interpreter back this often

Tick = tuple[Inputs, Outputs, TickTiming]
Clock = Callable[[], int]


class RecorderError(Exception):
    """The log cannot be written; names the directory and the next step."""


@dataclass(frozen=True, slots=True)
class _PolicyChange:
    spec: PolicySpec


class _Enough(Exception):
    """Tidying up is over: the recorder stops, or it takes too long."""


class Recorder:
    """Writes one log, from start to stop. `tick` is for the control loop's thread and never blocks."""

    def __init__(
        self,
        config: Config,
        policy: PolicySpec | None = None,
        *,
        monotonic_ns: Clock = time.monotonic_ns,
        wall_ns: Clock = time.time_ns,
    ) -> None:
        self._config = config
        self._settings = config.recorder
        self._monotonic_ns, self._wall_ns = monotonic_ns, wall_ns
        self._queue: deque[Tick | _PolicyChange] = deque()
        self._stopping = threading.Event()
        self._threads: list[threading.Thread] = []
        self._policy = policy
        self.path: Path | None = None  # of the log being written
        self.dropped = 0  # ticks that could not be kept, since start
        self.problem: str | None = None  # why nothing is written any more

    def start(self) -> None:
        """Open the log and begin; nothing when `recorder.enabled` is false.

        Raises RecorderError when the directory cannot be written or its disk is full.
        """
        if not self._settings.enabled:
            return
        try:
            self.path, file = self._open()
        except OSError as error:
            raise RecorderError(self._advice(error)) from error
        self._threads = [
            threading.Thread(target=self._write, args=(self.path, file), name="recorder", daemon=True),
            threading.Thread(target=self._tidy, args=(self.path,), name="recorder tidying", daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        """Write what is queued and finish the file: compressed, with an index. Takes some seconds at most."""
        self._stopping.set()
        for thread in self._threads:
            thread.join(timeout=FINISH_S + 2.0)

    def tick(self, inputs: Inputs, outputs: Outputs, timing: TickTiming) -> None:
        """Keep a tick. Never blocks, never raises; one that finds the queue full is counted in `dropped`."""
        if not self._settings.enabled:
            return
        if self.problem is not None or len(self._queue) >= self._settings.queue_max:
            self.dropped += 1
        else:
            self._queue.append((inputs, outputs, timing))

    def policy(self, spec: PolicySpec) -> None:
        """Note that the ticks from here on are another policy's. Never blocks."""
        if self._settings.enabled:
            self._queue.append(_PolicyChange(spec))

    def _open(self) -> tuple[Path, BinaryIO]:
        directory = self._settings.directory
        directory.mkdir(parents=True, exist_ok=True)
        if shutil.disk_usage(directory).free < FREE_MIN_BYTES:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        stem = datetime.fromtimestamp(self._wall_ns() * 1e-9, UTC).strftime("softarm-%Y%m%dT%H%M%SZ")
        for suffix in ("", *(f"-{n}" for n in range(2, 1000))):
            path = directory / f"{stem}{suffix}.mcap"
            try:
                file = path.open("xb")
            except FileExistsError:
                continue
            finishing.hold(file.fileno())
            return path.absolute(), file
        raise FileExistsError(errno.EEXIST, f"a thousand logs called {stem}")

    def _advice(self, error: OSError) -> str:
        directory = self._settings.directory.absolute()
        if error.errno == errno.ENOSPC:
            return (
                f"recorder.directory {directory}: the disk is full (less than "
                f"{FREE_MIN_BYTES // 1_000_000} MB free); delete old logs or name a directory on another disk"
            )
        return (
            f"recorder.directory {directory}: no log can be written there ({error.strerror}); make it "
            f"writable for uid {os.geteuid()}, name another directory, or set recorder.enabled: false"
        )

    def _write(self, path: Path, file: BinaryIO) -> None:
        """The writer's thread, from the first record to the finished file."""
        try:
            with file:
                live = TickFile(file)
                live.head(self._config, self._policy, self._monotonic_ns(), self._wall_ns())
                while not self._stopping.wait(self._settings.flush_interval_s):
                    self._drain(live)
                self._drain(live)
                self._finish(path)  # while the file is open: its lock keeps others from doing the same
        except Exception as error:
            self._fail(error)

    def _drain(self, live: "TickFile") -> None:
        while self._queue:
            live.write(self._queue.popleft())
        live.flush()

    def _finish(self, path: Path) -> None:
        """Compress and index; a log that takes too long stays as it is, whole, until the next start."""
        deadline_s = time.monotonic() + FINISH_S

        def look_at_the_clock() -> None:
            if time.monotonic() > deadline_s:
                raise _Enough

        try:
            finishing.finish(path, look_at_the_clock)
        except _Enough:
            log.info("%s is long: it will be compressed at the next start", path)
        except OSError as error:
            log.warning("%s is whole but could not be compressed: %s", path, self._advice(error))

    def _fail(self, error: Exception) -> None:
        """Stop recording; the loop goes on without."""
        if isinstance(error, OSError):
            self.problem = f"the log ends here: {self._advice(error)}; then restart the service"
        else:
            what = f"{type(error).__name__} in the recorder ({error})"
            self.problem = f"the log ends here: {what}; report it and restart the service"
        self.dropped += sum(isinstance(item, tuple) for item in self._queue)
        self._queue.clear()
        log.error("%s", self.problem)

    def _tidy(self, own: Path) -> None:
        """Finish the logs of daemons that were killed; in small bites, the loop needs the interpreter too."""
        records = 0

        def breathe() -> None:
            nonlocal records
            records += 1
            if self._stopping.is_set():
                raise _Enough
            if records % BREATH_RECORDS == 0:
                time.sleep(BREATH_S)

        for path in sorted(own.parent.glob("*.mcap")):
            try:
                if path != own and not mcap_file.is_finished(path):
                    log.info("finishing a log that was left: %s", finishing.recover(path, breathe).ending)
            except _Enough:
                return
            except Exception as error:  # an old log is no reason to disturb the new one
                log.warning("an old log cannot be finished and stays as it is: %s: %s", path, error)


class TickFile(LiveFile):
    """A live file of ticks, with the head that a reader needs."""

    def __init__(self, file: BinaryIO) -> None:
        super().__init__(file, ticks.CHANNELS)
        self._splitter = ticks.Splitter()

    def head(self, config: Config, policy: PolicySpec | None, monotonic_ns: int, wall_ns: int) -> None:
        """What a reader of the log has to know besides the ticks."""
        self.note(names.CONFIGURATION, {"json": config.model_dump_json()})
        self.note(names.SOFTWARE, revision.software(PACKAGES))
        self.note(names.MACHINE, revision.machine())
        self.note(
            names.CLOCK,
            {
                "monotonic_ns": str(monotonic_ns),
                "wall_ns": str(wall_ns),
                "wall_minus_monotonic_ns": str(wall_ns - monotonic_ns),
            },
        )
        if policy is not None:
            self._policy(policy)
        self.flush()

    def write(self, item: Tick | _PolicyChange) -> None:
        """One queued thing."""
        if isinstance(item, _PolicyChange):
            self._policy(item.spec)
            return
        for message in self._splitter.split(*item):
            self.add(message)

    def _policy(self, spec: PolicySpec) -> None:
        self.note(names.POLICY, {"name": spec.name, "description": spec.description, "sha256": spec.sha256 or ""})
