"""Emergency stop by a key on the terminal of `softarm run`."""

import os
import signal
import sys
import termios
import threading
import tty
from collections.abc import Callable
from typing import Self

KEYS = b" sS"
BACKGROUND_S = 0.5  # between attempts to read while another program uses the terminal


class StopKey:
    """Context in which each press of space or s calls `pressed`; afterwards the terminal is restored.

    Without a terminal, or if another program uses it, the context has no effect.
    """

    def __init__(self, pressed: Callable[[], object], terminal: int | None = None) -> None:
        """Create an inactive context; `terminal` is a file descriptor, by default that of standard input."""
        self._pressed = pressed
        self._terminal = _standard_input() if terminal is None else terminal
        self._over = threading.Event()

    def __enter__(self) -> Self:
        """Start reading keys. Call from the main thread, which handles signals.

        A read or a change of mode in the background must not stop the process.
        """
        if os.isatty(self._terminal) and _in_foreground(self._terminal):
            self._signals = {number: signal.signal(number, signal.SIG_IGN) for number in (_IN, _OUT)}
            self._signals[signal.SIGCONT] = signal.signal(signal.SIGCONT, self._resume)
            self._mode = termios.tcgetattr(self._terminal)
            tty.setcbreak(self._terminal, termios.TCSANOW)
            threading.Thread(target=self._read, name="stop key", daemon=True).start()
        else:
            self._over.set()
        return self

    def __exit__(self, *_: object) -> None:
        """Restore the terminal; the thread ends with the process."""
        if self._over.is_set():
            return
        self._over.set()
        termios.tcsetattr(self._terminal, termios.TCSANOW, self._mode)
        for number, handler in self._signals.items():
            signal.signal(number, handler)

    def _resume(self, *_: object) -> None:
        """Read single keys again: after Ctrl-Z and `fg` a shell has restored its own mode."""
        if _in_foreground(self._terminal):
            tty.setcbreak(self._terminal, termios.TCSANOW)

    def _read(self) -> None:
        while True:
            try:
                typed = os.read(self._terminal, 64)
            except OSError:  # now in the background
                if self._over.wait(BACKGROUND_S):
                    return
                continue
            if not typed or self._over.is_set():
                return
            if any(key in KEYS for key in typed):
                self._pressed()


_IN, _OUT = signal.SIGTTIN, signal.SIGTTOU


def is_offered() -> bool:
    """Return whether standard input is a terminal in the foreground."""
    return os.isatty(_standard_input()) and _in_foreground(_standard_input())


def _standard_input() -> int:
    return sys.__stdin__.fileno() if sys.__stdin__ is not None else -1


def _in_foreground(terminal: int) -> bool:
    try:
        return os.tcgetpgrp(terminal) == os.getpgrp()
    except OSError:
        return True  # not a controlling terminal: no other program can use it
