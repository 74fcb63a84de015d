"""`softarm model`: show, compare and check model files, and export the robot to MuJoCo."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.shared.completion import models
from softarm.cli.shared.console import FILE, WIDE, load_model, print_table, write

if TYPE_CHECKING:
    from softarm.schemas.model import Model

MODEL = click.Path(path_type=Path)


@click.group()
def model() -> None:
    """Show, compare, check and export model files: a robot's parameters and the effects of its simulator.

    A MODEL is a file or a shipped name: seed, no-pressure-lag, no-acceleration-limit, no-delay, no-finite-difference.

    \b
    Examples:
      softarm model show seed
      softarm model diff seed no-delay
    """


@model.command()
@click.argument("name", metavar="MODEL", type=MODEL, shell_complete=models)
def show(name: Path) -> None:
    """Print every parameter with its value, unit, bounds and source.

    \b
    Example:
      softarm model show seed
    """
    from softarm.simulator.model_file import effect_rows, robot_rows

    loaded = load_model(name)
    columns = ("parameter", "value", "unit", "allowed", "source of the seed value")
    rows = [(row.key, row.value, *row[2:]) for row in robot_rows(loaded)]
    print_table(columns, rows, f"{name}: robot", WIDE)
    rows = [(row.key, row.value, *row[2:]) for row in effect_rows(loaded)]
    print_table(("effect.parameter", "value", "unit", "allowed", "source"), rows, f"{name}: effects", WIDE)
    click.echo(_idle(loaded), nl=False)


@model.command()
@click.argument("one", metavar="MODEL", type=MODEL, shell_complete=models)
@click.argument("other", metavar="MODEL", type=MODEL, shell_complete=models)
def diff(one: Path, other: Path) -> None:
    """Print the differences between two models.

    \b
    Example:
      softarm model diff seed mine.yaml
    """
    from softarm.simulator.model_file import differences

    found = differences(load_model(one), load_model(other))
    if not found:
        click.echo("no difference")
        return
    print_table(("parameter", "unit", str(one), str(other)), found, width=WIDE)


@model.command()
@click.argument("file", metavar="MODEL", type=MODEL, shell_complete=models)
def check(file: Path) -> None:
    """Check a model; exit code 1, with every mistake and its line, if it is invalid.

    \b
    Example:
      softarm model check mine.yaml
    """
    loaded = load_model(file)
    names = ", ".join(loaded.effects) or "none"
    click.echo(f"{_idle(loaded)}{file}: valid; {loaded.arm.links} links; effects: {names}")


@model.command()
@click.argument("name", metavar="MODEL", type=MODEL, shell_complete=models)
@click.option("--mjcf", "out", required=True, type=FILE, help="The file to write.")
def export(name: Path, out: Path) -> None:
    """Write the robot as MJCF for MuJoCo; stderr and the file list the effects that MJCF cannot express.

    \b
    Example:
      softarm model export --mjcf arm.xml seed      then: python -m mujoco.viewer --mjcf=arm.xml
    """
    from softarm.simulator import mjcf

    exported = mjcf.export(load_model(name))
    write(out, exported.xml)
    for sentence in exported.left_out:
        click.echo(f"left out: {sentence}", err=True)


def _idle(loaded: "Model") -> str:
    from softarm.simulator.model_file import idle_effects

    return "".join(f"{name} has its neutral value and no effect\n" for name in idle_effects(loaded))
