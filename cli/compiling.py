"""The first start of a simulator compiles it: half a minute, of which a person is told."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager

import click

LOGGER = "softarm.simulator.compiled"


class _Told(logging.Handler):
    """To standard error, where nobody else takes what is logged."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print it."""
        if not logging.getLogger().handlers:
            click.echo(record.getMessage(), err=True)


@contextmanager
def told_of_compiling() -> Iterator[None]:
    """While this lasts."""
    logger, told = logging.getLogger(LOGGER), _Told()
    before = logger.level
    logger.addHandler(told)
    logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.removeHandler(told)
        logger.setLevel(before)
