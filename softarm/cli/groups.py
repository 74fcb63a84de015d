"""Click group of verbs, whose module is imported when the verb is used, and its handling of errors."""

import errno
import logging
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import click

from softarm.cli.shared.errors import INTERRUPTED, fail, left_now
from softarm.common.processes import work_clock

DEFECT = 70  # exit code of a defect in softarm (EX_SOFTWARE of sysexits.h)
NAME_SHOWN = 40  # letters of a file's name that is too long
LOGGER = "softarm.simulator.compiled"


class Verb(NamedTuple):
    """Location of a verb's click command, and its line in `softarm --help`."""

    target: str  # module of `softarm.cli`:attribute
    help: str
    extra: str = ""  # extra that installs the imported packages


class LazyGroup(click.Group):
    """Group of verbs from a table: section -> name -> verb."""

    def __init__(self, *args: Any, sections: Mapping[str, Mapping[str, Verb]], **options: Any) -> None:
        super().__init__(*args, **options)
        self._sections = sections
        # click suggests a name of these; `get_command` imports the verb.
        self.commands = {name: click.Command(name) for name in self._verbs}

    @property
    def _verbs(self) -> dict[str, Verb]:
        return {name: verb for section in self._sections.values() for name, verb in section.items()}

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names in the order of the table."""
        return list(self._verbs)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a verb's module and return its command; explain a missing package."""
        if (verb := self._verbs.get(cmd_name)) is None:
            return None
        module, _, attribute = verb.target.partition(":")
        try:
            command = getattr(import_module(f"softarm.cli.{module}"), attribute)
        except ModuleNotFoundError as error:
            self._explain_missing(cmd_name, error)
        assert isinstance(command, click.Command)
        return command

    def invoke(self, ctx: click.Context) -> Any:
        """Run the verb and end it with a sentence for an error of softarm's own kinds, of a file, and for Ctrl-C.

        Any other exception is a defect: one line or, with --debug, a traceback.
        """
        try:
            with compilation_announced():
                return super().invoke(ctx)
        except ModuleNotFoundError as error:
            self._explain_missing(ctx.invoked_subcommand or "", error)
        except (KeyboardInterrupt, click.Abort):
            left = left_now()
            click.echo(f"\ninterrupted: {left}" if left else "\ninterrupted", err=True)
            ctx.exit(INTERRUPTED)
        except (click.ClickException, click.exceptions.Exit, BrokenPipeError):
            raise
        except Exception as error:
            if type(error).__module__.startswith("softarm."):
                fail(str(error))  # such an error is no defect: its text states cause and remedy
            if isinstance(error, OSError) and error.errno == errno.ENAMETOOLONG:
                fail(f"{str(error.filename)[:NAME_SHOWN]}...: no file system holds a name that long; name another file")
            if ctx.params["debug"]:
                raise
            if isinstance(error, OSError) and error.filename is not None:
                fail(f"{error.filename}: cannot be read or written ({error.strerror}); choose another place")
            click.echo(defect(ctx.invoked_subcommand or "", error), err=True)
            ctx.exit(DEFECT)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the verbs from the table, so that help imports nothing."""
        for title, section in self._sections.items():
            with formatter.section(title):
                formatter.write_dl([(name, verb.help) for name, verb in section.items()])

    def _explain_missing(self, name: str, error: ModuleNotFoundError) -> NoReturn:
        """Explain a package that is not installed; raise the error if the module is softarm's own."""
        package = (error.name or "").partition(".")[0]
        if package == "softarm":
            raise error
        verb = self._verbs.get(name)
        fail(
            f"softarm {name} needs the package '{package}': "
            + (f"pip install 'softarm[{verb.extra}]'" if verb and verb.extra else "install softarm again")
        )


def defect(name: str, error: Exception) -> str:
    """Return one line about an unexpected error: where it was raised, and the next step."""
    at = traceback.extract_tb(error.__traceback__)[-1]
    what = " ".join(f"{type(error).__name__}: {error}".split())
    where = f"{Path(at.filename).name}:{at.lineno}"
    return f"softarm {name}: a defect in softarm ({where}): {what}; report what `softarm --debug {name} ...` shows"


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
