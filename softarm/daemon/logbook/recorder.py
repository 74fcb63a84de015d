"""Recorder of frames, ticks and events in MCAP files, which never blocks the control loop.

The loop appends to a bounded queue. One thread encodes and writes; it starts a new file when one is full or when a
failed disk works again. A killed daemon loses at most one flush interval; the disk gets the data once a second.
"""

import logging
import secrets
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import BinaryIO

from softarm.daemon.control.records import Inputs, Outputs, Tick, TickTiming
from softarm.daemon.logbook import folder, ticks
from softarm.daemon.logbook.history import History
from softarm.daemon.logbook.incidents import Incidents
from softarm.daemon.logbook.recent import Recent
from softarm.daemon.logbook.thinning import Thinning
from softarm.daemon.logbook.ticks import TickFile
from softarm.policies.base import PolicySpec
from softarm.recordings import log_file
from softarm.schemas.config import Config
from softarm.schemas.events import Entry

log = logging.getLogger(__name__)

FINISH_S = 5.0  # a log that takes longer to finish at stop is finished at the next start
RETRY_S = 2.0  # between attempts after a disk failure
OVERFULL = 1.1  # of file_max_mb: a larger file is ended even during a goal

Clock = Callable[[], int]


class RecorderError(Exception):
    """A log that cannot be written, with the directory and the next step."""


@dataclass(frozen=True, slots=True)
class _Unrecorded:
    """A tick that is not recorded; only its events are kept."""

    tick: Tick


@dataclass(frozen=True, slots=True)
class _Action:
    """An action outside the control loop."""

    t_ns: int
    what: str
    text: str
    who: str


class _Enough(Exception):
    """End of the clean-up: the recorder stops, or the time limit is over."""


class Recorder:
    """Writes logs from start to stop. The control loop's thread calls `tick`, which never blocks."""

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
        self._queue: deque[Tick | _Unrecorded | PolicySpec | _Action] = deque()
        self._stopping = threading.Event()
        self._writer: threading.Thread | None = None
        self._tidier: threading.Thread | None = None
        self._policy = policy
        self._thinning = Thinning(self._settings.idle_interval_s, self._settings.around_s)
        self._run, self._parts = secrets.token_hex(8), 0  # one run may write several files
        self.history = History(self._run, monotonic_ns, wall_ns)
        self.recent = Recent(monotonic_ns, wall_ns)
        self._incidents = Incidents(config, monotonic_ns, wall_ns) if self._settings.enabled else None
        self._refused = 0  # ticks refused by a full queue
        self._lost = 0  # ticks that could not be written
        self._in_goal = False  # a policy executes a goal
        self._splitting = False  # a new file was requested
        self.begun_ns = 0  # CLOCK_MONOTONIC at the start of the file
        self._next_try_s = 0.0  # next attempt to start a file
        self.listener: Callable[[Tick, list[Entry]], None] | None = None  # another consumer of ticks; must not block
        self.path: Path | None = None  # of the log being written
        self.problem: str | None = None  # why nothing is written now

    @property
    def dropped(self) -> int:
        """Return the number of ticks that were not recorded."""
        return self._refused + self._lost

    def start(self) -> None:
        """Open the log and start, or raise RecorderError; if recording is disabled, keep only the event history."""
        work: Callable[[], None] = self._watch
        if self._settings.enabled:
            try:
                self.path, file = folder.new_log(self._settings.directory, self._wall_ns())
            except OSError as error:
                raise RecorderError(folder.advice(self._settings.directory, error)) from error
            work = partial(self._write, self.path, file)
        self._writer = threading.Thread(target=work, name="recorder", daemon=True)
        self._writer.start()

    def stop(self) -> None:
        """Write the queue, then compress and index the file, within some seconds."""
        self._stopping.set()
        if self._writer is not None:
            self._writer.join(timeout=FINISH_S + 2.0)
        if self._tidier is not None:  # begun by the writer
            self._tidier.join(timeout=FINISH_S)
        if self._incidents is not None:
            self._incidents.end()

    def tick(self, inputs: Inputs, outputs: Outputs, timing: TickTiming) -> None:
        """Queue a tick. Never blocks or raises; a full queue counts it in `dropped`."""
        is_full, tick = len(self._queue) >= self._settings.queue_max, (inputs, outputs, timing)
        is_kept = self._settings.enabled and self.problem is None and not is_full
        self._refused += self._settings.enabled and not is_kept
        if not is_full:
            self._queue.append(tick if is_kept else _Unrecorded(tick))

    def policy(self, spec: PolicySpec) -> None:
        """Note the policy of the following ticks. Never blocks."""
        if self._settings.enabled:
            self._queue.append(spec)

    def split(self) -> None:
        """Begin a new file soon, between two goals. Never blocks; `path` changes when it is done."""
        self._splitting = True

    def done(self, what: str, text: str, who: str) -> None:
        """Note an action outside the control loop, such as a deleted log. Never blocks."""
        self._queue.append(_Action(self._monotonic_ns(), what, text, who))

    def _write(self, path: Path, file: BinaryIO) -> None:
        """Write one file after the other in the writer's thread."""
        following: tuple[Path, BinaryIO] | None = (path, file)
        while following is not None:
            self.path, file = following
            self.problem = None
            try:
                following = self._fill(self.path, file)
            except OSError as error:
                why = folder.advice(self._settings.directory, error)
                self._fail(f"the log ends here: {why}; recording continues by itself in a new one")
                following = self._when_it_can()
            except Exception as error:
                what = f"{type(error).__name__} in the recorder ({error})"
                self._fail(f"the log ends here: {what}; report it and restart the service")
                self._watch()
                return

    def _fill(self, path: Path, file: BinaryIO) -> tuple[Path, BinaryIO] | None:
        """Write a file from its first record until it is finished; return the next file if it is full."""
        with file:
            live = TickFile(file)
            self._parts += 1
            self._splitting, self.begun_ns = False, self._monotonic_ns()
            run = {"id": self._run, "part": str(self._parts)}
            live.head(self._config, self._policy, self._monotonic_ns(), self._wall_ns(), run)
            self._thinning.begin()
            self._tidy_up(path)
            full_bytes = self._settings.file_max_mb * 1e6
            end_ns = self._monotonic_ns() + round(self._settings.file_max_days * 86_400e9)

            def ends() -> bool:
                return self._may_end_file(file.tell() / full_bytes, self._monotonic_ns() >= end_ns)

            while not self._stopping.wait(self._settings.flush_interval_s):
                if self._drain(live, ends) and (following := self._following()) is not None:
                    return following
            self._drain(live)
            for tick in self._thinning.rest():
                self._put(live, tick)
            live.flush()
            self._finish(path)  # while the file is open: its lock keeps others from doing the same
        return None

    def _may_end_file(self, fullness: float, is_old: bool) -> bool:
        """Return whether the file may end: if possible between goals, so that the next file replays by itself."""
        due = fullness >= OVERFULL or ((fullness >= 1 or is_old or self._splitting) and not self._in_goal)
        return due and time.monotonic() >= self._next_try_s

    def _following(self) -> tuple[Path, BinaryIO] | None:
        """Return the next file, or None if it cannot be created now: then a full one is continued."""
        try:
            return folder.new_log(self._settings.directory, self._wall_ns())
        except OSError as error:
            self._next_try_s = time.monotonic() + RETRY_S
            if self.problem is None:
                why = folder.advice(self._settings.directory, error)
                log.warning("the next log cannot be created: %s; continuing %s", why, self.path)
            return None

    def _drain(self, live: TickFile, ends: Callable[[], bool] = lambda: False) -> bool:
        """Write the queue; return whether the file ends here."""
        while self._queue:
            item = self._queue.popleft()
            if isinstance(item, PolicySpec):
                self._policy = item
                live.policy(item)
                continue
            for entry in self._events(item):
                live.entry(entry)
            if isinstance(item, _Unrecorded | _Action):
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
        """Write a tick, or count it as lost if it cannot be encoded."""
        try:
            messages = live.write(tick)
        except ticks.EncodingError as error:
            self._lost += 1
            if self._lost & (self._lost - 1) == 0:  # the 1st, 2nd, 4th, ... avoids a flood
                log.error("%s: left out of the log, like %d before it", error, self._lost - 1)
        else:
            if self._incidents is not None:
                self._incidents.wrote(tick[0].t_ns, self._policy, messages)

    def _finish(self, path: Path) -> None:
        """Compress and index the log; after the time limit it stays complete and uncompressed until the next start."""
        deadline_s = time.monotonic() + FINISH_S

        def check_time() -> None:
            if time.monotonic() > deadline_s:
                raise _Enough

        try:
            log_file.finish(path, check_time)
        except _Enough:
            log.info("%s is long: it will be compressed at the next start", path)
        except OSError as error:
            why = folder.advice(self._settings.directory, error)
            log.warning("%s is complete but could not be compressed: %s", path, why)

    def _fail(self, problem: str) -> None:
        """Stop recording for now; the control loop continues."""
        self.problem = problem
        self._drop()
        log.error("%s", problem)

    def _drop(self) -> None:
        """Count the queued ticks as lost and remember the policy for the next log."""
        while self._queue:
            item = self._queue.popleft()
            if isinstance(item, PolicySpec):
                self._policy = item
                continue
            self._lost += not isinstance(item, _Unrecorded | _Action)
            self._events(item)

    def _events(self, item: Tick | _Unrecorded | _Action) -> list[Entry]:
        """Return the events of a tick or action, and update charts and incident files."""
        if isinstance(item, _Action):
            return self.history.done(item.t_ns, item.what, item.text, item.who)
        tick = item.tick if isinstance(item, _Unrecorded) else item
        entries = self.history.take(*tick[:2])
        self.recent.take(tick[1], tick[0].mocap)
        if self._incidents is not None:
            self._incidents.happened(tick[1], entries)
        if self.listener is not None:
            self.listener(tick, entries)
        return entries

    def _watch(self) -> None:
        """Keep the event history without writing a log."""
        while not self._stopping.wait(self._settings.flush_interval_s):
            self._drop()
        self._drop()

    def _when_it_can(self) -> tuple[Path, BinaryIO] | None:
        """Return a new file as soon as one can be written, or None if the recorder stops."""
        self._next_try_s = time.monotonic() + RETRY_S
        while not self._stopping.wait(self._settings.flush_interval_s):
            self._drop()
            if time.monotonic() >= self._next_try_s and (following := self._following()) is not None:
                log.info("recording continues: %s", following[0])
                return following
        return None

    def _tidy_up(self, own: Path) -> None:
        """Start the clean-up of the directory in a separate thread, unless it is running."""
        if self._tidier is None or not self._tidier.is_alive():
            self._tidier = threading.Thread(target=self._tidy, args=(own,), name="recorder tidying", daemon=True)
            self._tidier.start()

    def _tidy(self, own: Path) -> None:
        """Finish interrupted logs and delete the oldest, with pauses for the control loop."""
        pause = folder.Pause()

        def between_records() -> None:
            if self._stopping.is_set():
                raise _Enough
            pause()

        try:
            folder.finish_left(own.parent, own, between_records)
            folder.delete_oldest(own.parent, own, self._settings)
        except _Enough:
            return
        except Exception as error:
            log.warning("%s: clean-up failed: %s", own.parent, error)
