"""Real-time scheduling, where the system grants it."""

import logging
import os
import threading

log = logging.getLogger(__name__)

GUEST_PRIORITY = 1


def outrank_other_programs(priority: int) -> None:
    """Put the calling thread, and all it starts from now on, above every ordinary program (SCHED_FIFO).

    Every thread of the daemon, not only the control loop's: whoever holds the interpreter's lock must not be
    held up by another program, or the loop waits for both. 0: leave the scheduling as it is.
    """
    if priority:
        _set(GUEST_PRIORITY)


def outrank_guests(priority: int) -> None:
    """Put the calling thread, the control loop's, above the daemon's own others."""
    if priority:
        _set(priority)


def refused(priority: int) -> str | None:
    """Why the system would not grant the control loop that priority; None where it would. Changes nothing."""
    answers: list[OSError | None] = [None]
    if priority:
        asking = threading.Thread(target=lambda: answers.append(ask(priority)), name="real-time priority")
        asking.start()
        asking.join()
    error = answers[-1]
    return None if error is None else f"not granted here ({error.strerror}); LimitRTPRIO= or `ulimit -r` grant it"


def ask(priority: int) -> OSError | None:
    """Put the calling thread there; what the system has against it, None where it is done."""
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
