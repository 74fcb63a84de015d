"""Jobs beside the control loop, one at a time: an excitation, a diagnosis or a replay."""

import logging
import threading
from collections.abc import Callable
from datetime import UTC, datetime
from typing import NamedTuple, Protocol

from softarm.schemas.rest import JobEntry, JobKind

log = logging.getLogger(__name__)

KEPT = 20
Progress = Callable[[str, float | None], None]  # the current work, and its share from 0 to 1 if known


class JobError(Exception):
    """A job that failed; the arguments are sentences."""


class Busy(Exception):
    """Another job is running; the text names it."""


class Done(NamedTuple):
    """Result of a job."""

    sentences: tuple[str, ...]
    log: str | None = None  # name of the log that the job recorded


class Work(Protocol):
    """Work of a job, in a thread of its own."""

    def run(self, progress: Progress) -> Done:
        """Do the work and return its result, or raise JobError."""

    def end(self) -> None:
        """Make `run` return soon; called from another thread."""


class Jobs:
    """The running job and the results of earlier ones. A restart of the daemon forgets them."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._entries: dict[int, JobEntry] = {}  # oldest first
        self._running: tuple[int, Work] | None = None
        self._cancelled = False

    @property
    def entries(self) -> tuple[JobEntry, ...]:
        """Return the jobs, newest first."""
        with self._lock:
            return tuple(reversed(self._entries.values()))

    def start(self, kind: JobKind, text: str, work: Work, report: str | None = None) -> JobEntry:
        """Start a job and return its entry.

        Args:
            kind: kind of the job.
            text: what it does, for people.
            work: the work.
            report: name of the report that it writes.

        Raises:
            Busy: Another job is running.
        """
        with self._lock:
            if self._running is not None:
                other = self._entries[self._running[0]]
                raise Busy(f"job {other.number} ({other.text}) is running: wait for its end or cancel it")
            number = max(self._entries, default=0) + 1
            entry = JobEntry(number=number, kind=kind, text=text, started=datetime.now(UTC))
            self._entries = dict([*self._entries.items(), (number, entry)][-KEPT:])
            self._running, self._cancelled = (number, work), False
        threading.Thread(target=self._run, args=(number, work, report), name=f"job {number}", daemon=True).start()
        return entry

    def cancel(self, number: int) -> JobEntry | None:
        """End a job, which is then `cancelled`; return its entry, or None if there is no such job."""
        with self._lock:
            running = self._running
            self._cancelled |= running is not None and running[0] == number
        if running is not None and running[0] == number:
            running[1].end()
        return self._entries.get(number)

    def stop(self) -> None:
        """End the running job."""
        if (running := self._running) is not None:
            self.cancel(running[0])

    def _run(self, number: int, work: Work, report: str | None) -> None:
        def progress(text: str, share: float | None) -> None:
            with self._lock:
                self._change(number, progress=text, share=share)

        changes: dict[str, object] = {"state": "failed"}
        try:
            done = work.run(progress)
            changes = {"state": "done", "sentences": done.sentences, "log": done.log, "report": report, "share": 1.0}
        except JobError as error:
            changes["sentences"] = error.args
        except Exception as error:
            log.exception("job %d failed", number)
            changes["sentences"] = (f"a defect in softarm: {type(error).__name__}: {error}; see the service's log",)
        if self._cancelled and changes["state"] == "failed":
            changes = {"state": "cancelled"}
        with self._lock:
            self._change(number, ended=datetime.now(UTC), progress="", **changes)
            self._running = None

    def _change(self, number: int, **changes: object) -> None:
        self._entries[number] = self._entries[number].model_copy(update=changes)
