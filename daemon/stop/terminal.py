"""A key on the terminal of `softarm run` that asks for an emergency stop."""

import os
import signal
import sys
import termios
import threading
import tty
from collections.abc import Callable
from typing import Self

KEYS = b" sS"
BACKGROUND_S = 0.5  # between tries to read while another program has the terminal


class StopKey:
    """A context: inside it each press of space or s calls `pressed`; outside, the terminal is as it was before.

    Does nothing where there is no terminal, or another program has it.
    """

    def __init__(self, pressed: Callable[[], object], terminal: int | None = None) -> None:
        """terminal: a file descriptor, standard input's by default."""
        self._pressed = pressed
        self._terminal = _standard_input() if terminal is None else terminal
        self._over = threading.Event()

    def __enter__(self) -> Self:
        """From the main thread: a read or a change of mode in the background must not stop the whole process."""
        if os.isatty(self._terminal) and _in_foreground(self._terminal):
            self._signals = {number: signal.signal(number, signal.SIG_IGN) for number in (_IN, _OUT)}
            self._mode = termios.tcgetattr(self._terminal)
            tty.setcbreak(self._terminal, termios.TCSANOW)
            threading.Thread(target=self._read, name="stop key", daemon=True).start()
        else:
            self._over.set()
        return self

    def __exit__(self, *_: object) -> None:
        """The thread is left behind; it waits for a key and ends with the process."""
        if self._over.is_set():
            return
        self._over.set()
        termios.tcsetattr(self._terminal, termios.TCSANOW, self._mode)
        for number, handler in self._signals.items():
            signal.signal(number, handler)

    def _read(self) -> None:
        while True:
            try:
                typed = os.read(self._terminal, 64)
            except OSError:  # in the background now
                if self._over.wait(BACKGROUND_S):
                    return
                continue
            if not typed or self._over.is_set():
                return
            if any(key in KEYS for key in typed):
                self._pressed()


_IN, _OUT = signal.SIGTTIN, signal.SIGTTOU


def is_offered() -> bool:
    """Whether standard input is a terminal that is ours."""
    return os.isatty(_standard_input()) and _in_foreground(_standard_input())


def _standard_input() -> int:
    return sys.__stdin__.fileno() if sys.__stdin__ is not None else -1


def _in_foreground(terminal: int) -> bool:
    try:
        return os.tcgetpgrp(terminal) == os.getpgrp()
    except OSError:
        return True  # a terminal that controls nobody, so nobody else either
