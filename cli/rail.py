"""`softarm rail`: the axis's zero, found by a person with the drive and no daemon."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.errors import fail
from softarm.cli.interrupt import leaves
from softarm.cli.options import FILE
from softarm.cli.rail_alone import only_one
from softarm.cli.rail_homing import allowed, ready, say_what_moves, searched, tell
from softarm.cli.verbs import Verbs

if TYPE_CHECKING:
    from softarm.schemas.config import Config

config_option = click.option(
    "--config", "config_file", type=FILE, required=True, help="The daemon's own file: it names the drive."
)


@click.group(cls=Verbs)
def rail() -> None:
    """Find the axis's zero (docs/homing.md).

    \b
    Example:
      softarm rail home --config softarm.yaml        after every power cycle of a drive that forgets its zero
    """


@rail.command()
@config_option
@click.option(
    "--speed",
    "speed_m_s",
    type=click.FloatRange(0.005, 0.1),
    default=0.05,
    show_default=True,
    metavar="M_S",
    help="Towards the switch, 0.005 to 0.1 m/s; towards the zero a fifth of it.",
)
@click.option("--reset-fault", is_flag=True, help="Reset a fault of the drive first, whose cause you have seen to.")
@click.option("--yes", is_flag=True, help="Do not ask: the rail is free, and somebody at the emergency stop.")
def home(config_file: Path, speed_m_s: float, reset_fault: bool, yes: bool) -> None:
    """Have the drive find its zero by its own method, slowly, and leave it off. THE CART MOVES.

    No daemon may run with this configuration: a drive has one master. The regulator is not touched. What moves, where
    and how fast is said first. Ctrl-C brakes and switches off; so does everything that goes wrong.

    \b
    Examples:
      softarm rail home --config softarm.yaml
      softarm rail home --config softarm.yaml --speed 0.02 --yes
      softarm rail home --config softarm.yaml --reset-fault      after a limit switch, or another fault
    """
    from softarm.drivers.base import DeviceError
    from softarm.drivers.rail.commissioning.visit import Visit, settings_of

    if speed_m_s != speed_m_s:
        raise click.BadParameter("nan is no speed; allowed 0.005 to 0.1 m/s", param_hint="--speed")
    config = _config(config_file)
    leaves("nothing had moved; the drive is off")
    with only_one(config):
        try:
            with Visit(settings_of(config.drivers.rail)) as drive:
                ready(drive, reset_fault)
                say_what_moves(drive, config_file, speed_m_s)
                if not (yes or allowed()):
                    fail("nothing moved: not wanted")
                found = searched(drive, speed_m_s)
        except DeviceError as error:
            fail(str(error))
    tell(found, config, config_file)


def _config(file: Path) -> "Config":
    from softarm.daemon.config.configuration import ConfigurationError, load

    try:
        return load(file)
    except ConfigurationError as error:
        fail(str(error))
