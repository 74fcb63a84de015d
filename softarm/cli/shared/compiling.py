"""Announce on standard error that the simulator is being compiled, which takes half a minute once."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager

import click

LOGGER = "softarm.simulator.compiled"


class _PrintHandler(logging.Handler):
    """Handler that prints to standard error unless the root logger has a handler of its own."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print the message of a record."""
        if not logging.getLogger().handlers:
            click.echo(record.getMessage(), err=True)


@contextmanager
def compilation_announced() -> Iterator[None]:
    """Print the compiler's messages while the context lasts."""
    logger, handler = logging.getLogger(LOGGER), _PrintHandler()
    before = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(before)
