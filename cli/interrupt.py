"""Ctrl-C: a verb that lasts says what it leaves behind, and in which state."""

from collections.abc import Callable

import click

INTERRUPTED = 130  # exit code: 128 and the number of SIGINT, as shells count
NOTHING = "nothing was written"
_KEY = "softarm.leaves"


def leaves(what: str | Callable[[], str]) -> None:
    """From now on, until it is said anew, Ctrl-C leaves this."""
    click.get_current_context().meta[_KEY] = what


def left_now() -> str:
    """What is left, where the verb that runs has said so."""
    what = click.get_current_context().meta.get(_KEY, "")
    return str(what() if callable(what) else what)


def interrupted() -> str:
    """What to tell somebody who has pressed Ctrl-C."""
    return f"interrupted: {left}" if (left := left_now()) else "interrupted"
