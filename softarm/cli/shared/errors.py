"""How verbs end: with one sentence on standard error and exit code 1, or at Ctrl-C with what they leave behind.

Usage errors are click's and exit with 2. An exception class of any module of softarm has such a sentence as its text,
and `LazyGroup` ends the verb with it. An OSError of a file ends the verb with the file's name and the reason. A verb
itself handles Python's other exceptions, with `failing`, where their text is such a sentence.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import IO, Any, NoReturn

import click

# Exit code -> meaning, for scripts.
EXITS = {
    0: "done",
    1: "refused, failed or not reached; standard error states the cause and what to do",
    2: "usage error: unknown verb or option, or a value out of range",
    3: "`close-gap` only: finished, but the old policy is the better one",
    70: "defect in softarm: `softarm --debug VERB ...` shows the traceback",
    130: "Ctrl-C: standard error states what was left, and in which state",
}
INTERRUPTED = 130  # exit code: 128 and the number of SIGINT, as shells count
NOTHING = "nothing was written"
_KEY = "softarm.leaves"


class Failure(click.ClickException):
    """Failure of a verb, with its cause and the next step."""

    def show(self, file: IO[Any] | None = None) -> None:
        """Print the message without a prefix: a file's problem starts with FILE:LINE, which editors follow."""
        click.echo(self.format_message(), file=file, err=file is None)


class Unreachable(Failure):
    """Failure to reach a daemon; verbs that work without one catch it."""


def fail(text: str) -> NoReturn:
    """End the command with a sentence and exit code 1."""
    raise Failure(text)


@contextmanager
def failing(*kinds: type[Exception]) -> Iterator[None]:
    """End the command with the text of an error of these kinds and exit code 1."""
    try:
        yield
    except kinds as error:
        fail(str(error))


def leaves(what: str | Callable[[], str]) -> None:
    """Set the text that Ctrl-C prints from now on, or a function that returns it."""
    click.get_current_context().meta[_KEY] = what


def left_now() -> str:
    """Return the text set with `leaves`, or an empty text."""
    what = click.get_current_context().meta.get(_KEY, "")
    return str(what() if callable(what) else what)
