"""Real-time scheduling, if the system grants it."""

import logging
import os
import threading

log = logging.getLogger(__name__)

BASE_PRIORITY = 1


def outrank_other_programs(priority: int) -> None:
    """Raise the calling thread, and all it starts from now on, above every ordinary program (SCHED_FIFO).

    This applies to every thread of the daemon: the holder of the interpreter's lock must not wait for another program,
    or the control loop waits for both. Priority 0 leaves the scheduling unchanged.
    """
    if priority:
        _set(BASE_PRIORITY)


def outrank_own_threads(priority: int) -> None:
    """Raise the calling thread above the other threads of this process; 0 leaves it unchanged."""
    if priority:
        _set(priority)


def refused(priority: int) -> str | None:
    """Return why the system would not grant a priority, or None; changes nothing."""
    answers: list[OSError | None] = [None]
    if priority:
        asking = threading.Thread(target=lambda: answers.append(ask(priority)), name="real-time priority")
        asking.start()
        asking.join()
    error = answers[-1]
    return None if error is None else f"not granted here ({error.strerror}); LimitRTPRIO= or `ulimit -r` grant it"


def ask(priority: int) -> OSError | None:
    """Set the real-time priority of the calling thread; return the system's error, or None."""
    try:
        os.sched_setscheduler(threading.get_native_id(), os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        return error
    return None


def _set(priority: int) -> None:
    error = ask(priority)
    if isinstance(error, PermissionError):
        log.info("no real-time priority (control.realtime_priority): grant it with LimitRTPRIO= or `ulimit -r`")
    elif error is not None:
        raise error
