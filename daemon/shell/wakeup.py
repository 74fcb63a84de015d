"""Waiting on any number of descriptors, to the microsecond.

select takes no descriptor above 1,023, and one such ends the loop; epoll takes any, but rounds its time-out up to a
whole millisecond. So epoll waits for a timer's descriptor beside the others. Python has these timers from 3.13 on;
until then they are libc's (timerfd_create(2)).
"""

import ctypes
import os
import selectors
import time

_libc = ctypes.PyDLL(None, use_errno=True)  # keeps the interpreter's lock: no call here waits


class _TimeSpec(ctypes.Structure):
    _fields_ = [("s", ctypes.c_long), ("ns", ctypes.c_long)]


class _TimerSpec(ctypes.Structure):
    _fields_ = [("interval", _TimeSpec), ("value", _TimeSpec)]


class PunctualSelector(selectors.EpollSelector):
    """An epoll selector whose time-outs are not rounded."""

    def __init__(self) -> None:
        super().__init__()
        self._timer = _libc.timerfd_create(time.CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC)
        if self._timer < 0:
            super().close()
            raise OSError(ctypes.get_errno(), "timerfd_create")
        self.register(self._timer, selectors.EVENT_READ)

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        """See `selectors.BaseSelector.select`."""
        if timeout is None or timeout > 0:
            self._set_timer(0 if timeout is None else max(1, int(timeout * 1e9)))
            timeout = None
        return [(key, events) for key, events in super().select(timeout) if key.fd != self._timer]

    def close(self) -> None:
        """See `selectors.BaseSelector.close`."""
        os.close(self._timer)
        super().close()

    def _set_timer(self, after_ns: int) -> None:
        """Once, from now; 0: never. Takes back what has run out and was not read."""
        spec = _TimerSpec(value=_TimeSpec(*divmod(after_ns, 1_000_000_000)))
        if _libc.timerfd_settime(self._timer, 0, ctypes.byref(spec), None) < 0:
            raise OSError(ctypes.get_errno(), "timerfd_settime")
