"""How a verb fails: one sentence on stderr, exit code 1. Usage errors are click's own and exit with 2."""

from typing import IO, Any, NoReturn

import click

from softarm.cli.words import in_commands

EXITS = {  # what a script can tell by
    0: "done",
    1: "refused, failed or not reached: a sentence on standard error says why and what to do",
    2: "typed wrongly: a verb, an option or a value that there is none of",
    3: "`close-gap` alone: all was done, and the retrained policy is not the one to fly",
    70: "a defect of ours: `softarm --debug VERB ...` shows all of it",
    130: "Ctrl-C: standard error says what it leaves, and in which state",
}


class Failure(click.ClickException):
    """What went wrong, and the next step."""

    def show(self, file: IO[Any] | None = None) -> None:
        """Print the sentence as it is: a problem of a file begins with FILE:LINE, which editors follow."""
        click.echo(in_commands(self.format_message()), file=file, err=file is None)


class Unreachable(Failure):
    """No daemon answers; a verb that can do without one catches this."""


def fail(text: str) -> NoReturn:
    """End the command with a sentence and exit code 1."""
    raise Failure(text)
