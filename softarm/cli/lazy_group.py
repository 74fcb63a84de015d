"""Click group with verbs in sections; a verb's module is imported when the verb is used."""

import shlex
import traceback
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import click

from softarm.cli.shared.compiling import compilation_announced
from softarm.cli.shared.errors import fail
from softarm.cli.shared.interrupt import INTERRUPTED, left_now
from softarm.cli.verbs import Verbs

DEFECT = 70  # exit code of a defect in softarm (EX_SOFTWARE of sysexits.h)


class Verb(NamedTuple):
    """Location of a verb's click command, and its line in `softarm --help`."""

    target: str  # module of `softarm.cli`:attribute
    help: str
    extra: str = ""  # extra that installs the imported packages


class LazyGroup(Verbs):
    """Group of verbs from a table: section -> name -> verb; `moved` maps earlier spellings to present ones."""

    def __init__(
        self, *args: Any, sections: Mapping[str, Mapping[str, Verb]], moved: Mapping[str, str], **options: Any
    ) -> None:
        super().__init__(*args, **options)
        self._sections, self._moved = sections, moved

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

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the verb; refuse an earlier spelling with the present one."""
        if (present := self._moved.get(args[0])) is not None:
            raise click.UsageError(f"`softarm {shlex.join(args)}` is now `softarm {present} {shlex.join(args[1:])}`")
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the verb and end it with a sentence for an error of softarm's own kinds and for Ctrl-C.

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
            if ctx.params["debug"]:
                raise
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
