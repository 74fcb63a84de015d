"""`softarm model`: what a model file says, what sets two apart, whether one is sound, and the robot for MuJoCo."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.completion import models
from softarm.cli.errors import fail
from softarm.cli.options import FILE, load_model
from softarm.cli.printing import print_table

if TYPE_CHECKING:
    from softarm.schemas.model import Model

MODEL = click.Path(path_type=Path)
WIDTH = 160  # of tables where there is no terminal


@click.group()
def model() -> None:
    """Look at model files: a robot's parameters, and the effects that its simulator has.

    A MODEL is a file or a shipped name: seed, no-pressure-lag, no-acceleration-limit, no-delay, no-finite-difference.

    \b
    Examples:
      softarm model show seed
      softarm model diff seed no-delay
    """


@model.command()
@click.argument("name", metavar="MODEL", type=MODEL, shell_complete=models)
def show(name: Path) -> None:
    """Print every parameter in force, with unit, bounds and source.

    \b
    Example:
      softarm model show seed
    """
    from softarm.simulator.model_rows import effect_rows, robot_rows

    loaded = load_model(name)
    columns = ("parameter", "value", "unit", "allowed", "source of the seed's")
    rows = [(row.key, row.value, *row[2:]) for row in robot_rows(loaded)]
    print_table(columns, rows, f"{name}: robot", WIDTH)
    rows = [(row.key, row.value, *row[2:]) for row in effect_rows(loaded)]
    print_table(("effect.parameter", "value", "unit", "allowed", "source"), rows, f"{name}: effects", WIDTH)
    click.echo(_idle(loaded), nl=False)


@model.command()
@click.argument("one", metavar="MODEL", type=MODEL, shell_complete=models)
@click.argument("other", metavar="MODEL", type=MODEL, shell_complete=models)
def diff(one: Path, other: Path) -> None:
    """Print what two models have different.

    \b
    Example:
      softarm model diff seed mine.yaml
    """
    from softarm.simulator.model_rows import differences

    found = differences(load_model(one), load_model(other))
    if not found:
        click.echo("no difference")
        return
    print_table(("parameter", "unit", str(one), str(other)), found, width=WIDTH)


@model.command()
@click.argument("file", metavar="MODEL", type=MODEL, shell_complete=models)
def check(file: Path) -> None:
    """Say whether a model is sound; exit code 1, with every mistake and its line, when it is not.

    \b
    Example:
      softarm model check mine.yaml
    """
    loaded = load_model(file)
    names = ", ".join(loaded.effects) or "none"
    click.echo(f"{_idle(loaded)}{file}: sound; {loaded.arm.links} links; effects: {names}")


@model.command()
@click.argument("name", metavar="MODEL", type=MODEL, shell_complete=models)
@click.option("--mjcf", "out", required=True, type=FILE, help="The file to write.")
def export(name: Path, out: Path) -> None:
    """Write the robot as MJCF for MuJoCo; what that cannot express is listed on stderr and in the file.

    \b
    Example:
      softarm model export --mjcf arm.xml seed      then: python -m mujoco.viewer --mjcf=arm.xml
    """
    from softarm.common import files
    from softarm.simulator import mjcf

    exported = mjcf.export(load_model(name))
    try:
        files.write_text(out, exported.xml)
    except OSError as error:
        fail(f"{out}: cannot be written ({error.strerror}); name a file in an existing folder")
    for sentence in exported.left_out:
        click.echo(f"left out: {sentence}", err=True)
    click.echo(f"wrote {out}")


def _idle(loaded: "Model") -> str:
    from softarm.simulator.model_rows import idle_effects

    return "".join(f"{name} is at its neutral value: it changes nothing\n" for name in idle_effects(loaded))
