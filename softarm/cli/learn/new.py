"""`softarm new`: write the package of a new plug-in."""

from pathlib import Path

import click

from softarm.cli.learn import templates
from softarm.cli.shared.errors import fail
from softarm.cli.shared.options import FOLDER

NEXT = {
    "policy": ("softarm evaluate --policy {name}",),
    "task": ("softarm train {name} --minutes 5",),
    "source": (
        "in softarm.yaml, under drivers: mocap: {{driver: {name}, options: {{port: 9763}}}}",
        "softarm check softarm.yaml && softarm run --config softarm.yaml",
    ),
}


@click.command()
@click.argument("kind", type=click.Choice(templates.KINDS))
@click.argument("name")
@click.option("--out", type=FOLDER, help="The folder to write.  [default: softarm-NAME]")
def new(kind: str, name: str, out: Path | None) -> None:
    """Write a small installable package: a policy, a task to train on, or a source of motion capture.

    It contains a module of working code to change, and a test that flies it. The plug-in is selected by NAME.

    \b
    Examples:
      softarm new policy lean
      softarm new task gentle --out ~/arm/gentle
      softarm new source my-cameras
    """
    from softarm.common.plugins import PluginError

    try:
        package = templates.named(kind, name)
        folder = out or Path(package.project)
        for file in templates.write(package, folder):
            click.echo(f"wrote {file}")
    except PluginError as error:
        fail(str(error))
    except OSError as error:
        fail(f"{error.filename}: cannot be written ({error.strerror}); choose another --out")
    click.echo("next:")
    for line in (f"pip install --editable {folder}", f"pytest {folder}", *NEXT[kind]):
        click.echo(f"  {line.format(name=name)}")
