"""The black box: frames, ticks and what happened into MCAP files, never holding up the loop.

The loop only appends to a bounded queue. One thread encodes and writes, and begins a new file when one is full, also in
flight (the queue waits for it), or when a disk that failed is there again. It hands its bytes to the system every flush
interval, so a daemon that is killed loses no more of a flight than that, and to the disk once a second.
"""

import logging
import secrets
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from softarm.daemon.control.records import Inputs, Outputs, TickTiming
from softarm.daemon.logbook import folder, ticks
from softarm.daemon.logbook.history import History
from softarm.daemon.logbook.incidents import Incidents
from softarm.daemon.logbook.recent import Recent
from softarm.daemon.logbook.thinning import Thinning, Tick
from softarm.daemon.logbook.tick_file import TickFile
from softarm.policies.base import PolicySpec
from softarm.recordings import finishing
from softarm.schemas.config import Config
from softarm.schemas.events import Entry

log = logging.getLogger(__name__)

FINISH_S = 5.0  # a log that takes longer to finish at stop is finished at the next start
RETRY_S = 2.0  # a disk that failed is looked at so often
OVERFULL = 1.1  # of file_max_mb: no longer does a full file wait for the end of a goal, whose policy remembers the past
BREATH_RECORDS, BREATH_S = 20, 0.002  # tidying old logs gives the interpreter back this often

Clock = Callable[[], int]


class RecorderError(Exception):
    """The log cannot be written; names the directory and the next step."""


@dataclass(frozen=True, slots=True)
class _PolicyChange:
    spec: PolicySpec


@dataclass(frozen=True, slots=True)
class _Unkept:
    """A tick that is counted already, or asked for by nobody: of it only what happened is told."""

    tick: Tick


@dataclass(frozen=True, slots=True)
class _Deed:
    """What somebody had done beside the control loop."""

    t_ns: int
    what: str
    text: str
    who: str


class _Enough(Exception):
    """Tidying up is over: the recorder stops, or it takes too long."""


class Recorder:
    """Writes logs, from start to stop. `tick` is for the control loop's thread and never blocks."""

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
        self._queue: deque[Tick | _Unkept | _PolicyChange | _Deed] = deque()
        self._stopping = threading.Event()
        self._writer: threading.Thread | None = None
        self._tidier: threading.Thread | None = None
        self._policy = policy
        self._thinning = Thinning(self._settings.idle_interval_s, self._settings.around_s)
        self._run, self._parts = secrets.token_hex(8), 0  # one run may leave several files
        self.history = History(self._run, monotonic_ns, wall_ns)
        self.recent = Recent(monotonic_ns, wall_ns)
        self._incidents = Incidents(config, monotonic_ns, wall_ns) if self._settings.enabled else None
        self._refused = 0  # ticks that the loop could not leave here
        self._lost = 0  # ticks that the writer took and could not write
        self._in_goal = False  # a policy flies one
        self._next_try_s = 0.0  # to begin the next file
        self.beside: Callable[[Tick, list[Entry]], None] | None = None  # who else takes ticks here; may not block
        self.path: Path | None = None  # of the log being written
        self.problem: str | None = None  # why nothing is written now

    @property
    def dropped(self) -> int:
        """Ticks that could not be kept, since start."""
        return self._refused + self._lost

    def start(self) -> None:
        """Open the log and begin; where `recorder.enabled` is false, only to tell what happens.

        Raises RecorderError when the directory cannot be written or its disk is full.
        """
        if not self._settings.enabled:
            self._writer = threading.Thread(target=self._watch, name="recorder", daemon=True)
            self._writer.start()
            return
        try:
            self.path, file = folder.new_log(self._settings.directory, self._wall_ns())
        except OSError as error:
            raise RecorderError(folder.advice(self._settings.directory, error)) from error
        self._writer = threading.Thread(target=self._write, args=(self.path, file), name="recorder", daemon=True)
        self._writer.start()

    def stop(self) -> None:
        """Write what is queued and finish the file: compressed, with an index. Takes some seconds at most."""
        self._stopping.set()
        if self._writer is not None:
            self._writer.join(timeout=FINISH_S + 2.0)
        if self._tidier is not None:  # begun by the writer
            self._tidier.join(timeout=FINISH_S)
        if self._incidents is not None:
            self._incidents.end()

    def tick(self, inputs: Inputs, outputs: Outputs, timing: TickTiming) -> None:
        """Keep a tick. Never blocks, never raises; one that finds the queue full is counted in `dropped`."""
        is_full, tick = len(self._queue) >= self._settings.queue_max, (inputs, outputs, timing)
        is_kept = self._settings.enabled and self.problem is None and not is_full
        self._refused += self._settings.enabled and not is_kept
        if not is_full:
            self._queue.append(tick if is_kept else _Unkept(tick))

    def policy(self, spec: PolicySpec) -> None:
        """Note that the ticks from here on are another policy's. Never blocks."""
        if self._settings.enabled:
            self._queue.append(_PolicyChange(spec))

    def done(self, what: str, text: str, who: str) -> None:
        """Note that somebody had something done beside the control loop, such as a log deleted. Never blocks."""
        self._queue.append(_Deed(self._monotonic_ns(), what, text, who))

    def _write(self, path: Path, file: BinaryIO) -> None:
        """The writer's thread: one file after the other."""
        following: tuple[Path, BinaryIO] | None = (path, file)
        while following is not None:
            self.path, file = following
            self.problem = None
            try:
                following = self._fill(self.path, file)
            except OSError as error:
                why = folder.advice(self._settings.directory, error)
                self._fail(f"the log ends here: {why}; recording goes on by itself in a new one")
                following = self._when_it_can()
            except Exception as error:
                what = f"{type(error).__name__} in the recorder ({error})"
                self._fail(f"the log ends here: {what}; report it and restart the service")
                self._watch()
                return

    def _fill(self, path: Path, file: BinaryIO) -> tuple[Path, BinaryIO] | None:
        """Write one file, from the first record to the finished file; the next one when it is full."""
        with file:
            live = TickFile(file)
            self._parts += 1
            run = {"id": self._run, "part": str(self._parts)}
            live.head(self._config, self._policy, self._monotonic_ns(), self._wall_ns(), run)
            self._thinning.begin()
            self._tidy_up(path)
            full_bytes = self._settings.file_max_mb * 1e6
            end_ns = self._monotonic_ns() + round(self._settings.file_max_days * 86_400e9)

            def ends() -> bool:
                return self._may_part(file.tell() / full_bytes, self._monotonic_ns() >= end_ns)

            while not self._stopping.wait(self._settings.flush_interval_s):
                if self._drain(live, ends) and (following := self._following()) is not None:
                    return following
            self._drain(live)
            for tick in self._thinning.rest():
                self._put(live, tick)
            live.flush()
            self._finish(path)  # while the file is open: its lock keeps others from doing the same
        return None

    def _may_part(self, fullness: float, is_old: bool) -> bool:
        """May the file end here? Where no policy flies a goal, if it can be: the next file is replayed by itself."""
        due = fullness >= OVERFULL or ((fullness >= 1 or is_old) and not self._in_goal)
        return due and time.monotonic() >= self._next_try_s

    def _following(self) -> tuple[Path, BinaryIO] | None:
        """The next file; None where it cannot be made: then the full one goes on, as long as it can."""
        try:
            return folder.new_log(self._settings.directory, self._wall_ns())
        except OSError as error:
            self._next_try_s = time.monotonic() + RETRY_S
            log.warning("no next log: %s; %s goes on", folder.advice(self._settings.directory, error), self.path)
            return None

    def _drain(self, live: TickFile, ends: Callable[[], bool] = lambda: False) -> bool:
        """Write what is queued, or up to where the file ends: then it is True."""
        while self._queue:
            item = self._queue.popleft()
            if isinstance(item, _PolicyChange):
                self._policy = item.spec
                live.policy(item.spec)
                continue
            for entry in self._tell(item):
                live.entry(entry)
            if isinstance(item, _Unkept | _Deed):
                continue
            goal = item[1].goal
            self._in_goal = goal.state == "running" and goal.goal is not None and goal.goal.kind != "hold"
            for tick in self._thinning.take(item):
                self._put(live, tick)
            if ends():
                break
        live.flush()
        return ends()

    def _put(self, live: TickFile, tick: Tick) -> None:
        """Write a tick; one that cannot be encoded costs itself alone."""
        try:
            messages = live.write(tick)
        except ticks.EncodingError as error:
            self._lost += 1
            if self._lost & (self._lost - 1) == 0:  # the 1st, 2nd, 4th, ...: a fault in every tick floods nothing
                log.error("%s: left out of the log, like %d before it", error, self._lost - 1)
        else:
            if self._incidents is not None:
                self._incidents.wrote(tick[0].t_ns, self._policy, messages)

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
            why = folder.advice(self._settings.directory, error)
            log.warning("%s is whole but could not be compressed: %s", path, why)

    def _fail(self, problem: str) -> None:
        """Stop recording for now; the loop goes on without."""
        self.problem = problem
        self._drop()
        log.error("%s", problem)

    def _drop(self) -> None:
        """Nothing can be written: ticks are counted, changes of policy remembered for the head of the next log."""
        while self._queue:
            item = self._queue.popleft()
            if isinstance(item, _PolicyChange):
                self._policy = item.spec
                continue
            self._lost += not isinstance(item, _Unkept | _Deed)
            self._tell(item)

    def _tell(self, item: Tick | _Unkept | _Deed) -> list[Entry]:
        """What happened in a tick: told, kept for charts, and an emergency stop pinned; a deed is told."""
        if isinstance(item, _Deed):
            return self.history.done(item.t_ns, item.what, item.text, item.who)
        tick = item.tick if isinstance(item, _Unkept) else item
        entries = self.history.take(*tick[:2])
        self.recent.take(tick[1])
        if self._incidents is not None:
            self._incidents.happened(tick[1], entries)
        if self.beside is not None:
            self.beside(tick, entries)
        return entries

    def _watch(self) -> None:
        """Nothing is written any more, or at all: what happens is told."""
        while not self._stopping.wait(self._settings.flush_interval_s):
            self._drop()
        self._drop()

    def _when_it_can(self) -> tuple[Path, BinaryIO] | None:
        """Wait until a log can be written again; None when the recorder stops before."""
        self._next_try_s = time.monotonic() + RETRY_S
        while not self._stopping.wait(self._settings.flush_interval_s):
            self._drop()
            if time.monotonic() < self._next_try_s:
                continue
            self._next_try_s = time.monotonic() + RETRY_S
            try:
                following = folder.new_log(self._settings.directory, self._wall_ns())
            except OSError:
                continue
            log.info("recording goes on: %s", following[0])
            return following
        return None

    def _tidy_up(self, own: Path) -> None:
        """Begin to tidy the directory, in a thread of its own, unless that is still being done."""
        if self._tidier is None or not self._tidier.is_alive():
            self._tidier = threading.Thread(target=self._tidy, args=(own,), name="recorder tidying", daemon=True)
            self._tidier.start()

    def _tidy(self, own: Path) -> None:
        """Finish what was left and delete what is too much; in small bites, the loop needs the interpreter too."""
        records = 0

        def breathe() -> None:
            nonlocal records
            records += 1
            if self._stopping.is_set():
                raise _Enough
            if records % BREATH_RECORDS == 0:
                time.sleep(BREATH_S)

        try:
            folder.finish_left(own.parent, own, breathe)
            folder.delete_oldest(own.parent, own, self._settings)
        except _Enough:
            return
        except Exception as error:
            log.warning("%s: cannot be tidied: %s", own.parent, error)
