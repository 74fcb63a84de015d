"""`softarm new`: write the package of a new plug-in, or the stage file of a rig."""

from pathlib import Path

import click

from softarm.cli.gap.new_rig import rig
from softarm.cli.learn import templates
from softarm.cli.shared.errors import writing
from softarm.cli.shared.options import FOLDER
from softarm.cli.verbs import Verbs

PURPOSES = {"policy": "a policy", "task": "a task to train on", "source": "a source of motion capture"}
NEXT = {
    "policy": ("softarm evaluate {name}",),
    "task": ("softarm train {name} --minutes 5",),
    "source": (
        "in softarm.yaml, under drivers: mocap: {{driver: {name}, options: {{port: 9763}}}}",
        "softarm check softarm.yaml && softarm run --config softarm.yaml",
    ),
}


@click.group(cls=Verbs)
def new() -> None:
    """Create the package of a plug-in, or the stage file of a rig.

    \b
    Examples:
      softarm new policy lean
      softarm new task gentle --out ~/arm/gentle
      softarm new source my-cameras
      softarm new rig recordings
    """


def _plugin(kind: str) -> click.Command:
    """Return the command that writes the package of one kind of plug-in."""

    @click.command(kind, help=_HELP.format(purpose=PURPOSES[kind], kind=kind))
    @click.argument("name")
    @click.option("--out", type=FOLDER, help="The folder to write.  [default: softarm-NAME]")
    def command(name: str, out: Path | None) -> None:
        _write(kind, name, out)

    return command


_HELP = """Write a small installable package: {purpose}.

It contains a module of working code to change, and a test that flies it. The plug-in is selected by NAME.

\b
Example:
  softarm new {kind} mine
"""


def _write(kind: str, name: str, out: Path | None) -> None:
    """Write the package of a plug-in and print the next commands."""
    with writing("choose another --out"):
        package = templates.named(kind, name)
        folder = out or Path(package.project)
        for file in templates.write(package, folder):
            click.echo(f"wrote {file}")
    click.echo("next:")
    for line in (f"pip install --editable {folder}", f"pytest {folder}", *NEXT[kind]):
        click.echo(f"  {line.format(name=name)}")


for _kind in templates.KINDS:
    new.add_command(_plugin(_kind))
new.add_command(rig)
