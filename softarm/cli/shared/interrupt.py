"""Ctrl-C: a long verb states what it leaves behind, and in which state."""

from collections.abc import Callable

import click

INTERRUPTED = 130  # exit code: 128 and the number of SIGINT, as shells count
NOTHING = "nothing was written"
_KEY = "softarm.leaves"


def leaves(what: str | Callable[[], str]) -> None:
    """Set the text that Ctrl-C prints from now on, or a function that returns it."""
    click.get_current_context().meta[_KEY] = what


def left_now() -> str:
    """Return the text set with `leaves`, or an empty text."""
    what = click.get_current_context().meta.get(_KEY, "")
    return str(what() if callable(what) else what)
