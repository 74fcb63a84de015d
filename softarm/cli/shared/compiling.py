"""Announce on standard error that the simulator is being compiled, which takes half a minute once."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

from softarm.common.processes import work_clock

LOGGER = "softarm.simulator.compiled"


class Announcement(logging.StreamHandler[Any]):
    """Handler that prints the compiler's messages, and keeps compiling out of the remaining time of progress bars."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print a message of the compiler."""
        super().emit(record)
        _leave_compiling_out()


@cache
def _leave_compiling_out() -> None:
    from numba.core import event

    class Listener(event.Listener):  # type: ignore[misc]
        def on_start(self, event: object) -> None:
            work_clock.begin_leaving_out()

        def on_end(self, event: object) -> None:
            work_clock.end_leaving_out()

    event.register("numba:compile", Listener())


@contextmanager
def compilation_announced() -> Iterator[None]:
    """Print the compiler's messages while the context lasts, unless the root logger has a handler of its own."""
    logger, handler = logging.getLogger(LOGGER), Announcement()
    handler.addFilter(lambda record: not logging.getLogger().handlers)
    before = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(before)
