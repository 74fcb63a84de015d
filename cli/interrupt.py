"""Ctrl-C: a verb that lasts says what it leaves behind, and in which state."""

from collections.abc import Callable

import click

INTERRUPTED = 130  # exit code: 128 and the number of SIGINT, as shells count
_KEY = "softarm.leaves"


def leaves(what: str | Callable[[], str]) -> None:
    """From now on, until it is said anew, Ctrl-C leaves this."""
    click.get_current_context().meta[_KEY] = what


def interrupted(context: click.Context) -> str:
    """What to tell somebody who has pressed Ctrl-C."""
    what = context.meta.get(_KEY, "")
    left = what() if callable(what) else what
    return f"interrupted: {left}" if left else "interrupted"
