"""Selector for any number of descriptors with time-outs accurate to the microsecond.

select accepts no descriptor above 1,023; epoll accepts any, but rounds its time-out up to a whole millisecond. So epoll
waits for a timer's descriptor as well. Python offers these timers from 3.13 on; until then they come from libc
(timerfd_create(2)).
"""

import ctypes
import os
import select
import selectors
import time

_libc = ctypes.PyDLL(None, use_errno=True)  # keeps the interpreter's lock, since no call blocks


class _TimeSpec(ctypes.Structure):
    _fields_ = [("s", ctypes.c_long), ("ns", ctypes.c_long)]


class _TimerSpec(ctypes.Structure):
    _fields_ = [("interval", _TimeSpec), ("value", _TimeSpec)]


_libc.timerfd_settime.argtypes = (ctypes.c_int, ctypes.c_int, ctypes.POINTER(_TimerSpec), ctypes.c_void_p)


class PunctualSelector(selectors.EpollSelector):
    """An epoll selector whose time-outs are not rounded."""

    def __init__(self) -> None:
        super().__init__()
        self._timer = _libc.timerfd_create(time.CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC)
        if self._timer < 0:
            super().close()
            raise OSError(ctypes.get_errno(), "timerfd_create")
        self._spec = _TimerSpec()
        # Not registered as a key: `select` skips descriptors without one, so the timer stays invisible.
        with select.epoll.fromfd(os.dup(self.fileno())) as epoll:
            epoll.register(self._timer, select.EPOLLIN)

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        """Wait for descriptors like `selectors.BaseSelector.select`."""
        if timeout is None or timeout > 0:
            self._set_timer(0 if timeout is None else max(1, int(timeout * 1e9)))
            timeout = None
        return super().select(timeout)

    def close(self) -> None:
        """Close the timer and the selector."""
        os.close(self._timer)
        super().close()

    def _set_timer(self, after_ns: int) -> None:
        """Set the timer to fire once after a delay, or never for 0; discard an unread expiry."""
        value = self._spec.value
        value.s, value.ns = divmod(after_ns, 1_000_000_000)
        if _libc.timerfd_settime(self._timer, 0, self._spec, None) < 0:
            raise OSError(ctypes.get_errno(), "timerfd_settime")
