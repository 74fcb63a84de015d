"""Announce on standard error that the simulator is being compiled, which takes half a minute once."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager

LOGGER = "softarm.simulator.compiled"


@contextmanager
def compilation_announced() -> Iterator[None]:
    """Print the compiler's messages while the context lasts, unless the root logger has a handler of its own."""
    logger, handler = logging.getLogger(LOGGER), logging.StreamHandler()
    handler.addFilter(lambda record: not logging.getLogger().handlers)
    before = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(before)
