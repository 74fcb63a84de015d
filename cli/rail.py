"""`softarm rail`: the axis's zero and its middle, found by a person with the drive and no daemon."""

from pathlib import Path

import click

from softarm.cli import rail_sources
from softarm.cli.errors import fail
from softarm.cli.interrupt import leaves
from softarm.cli.options import FILE, token_of
from softarm.cli.rail_alone import configuration, only_one, relay_held
from softarm.cli.rail_centring import pushed, tell_centre
from softarm.cli.rail_homing import allowed, enabled, ready, say_what_moves, searched, tell
from softarm.cli.verbs import Verbs

config_option = click.option(
    "--config", "config_file", type=FILE, required=True, help="The daemon's own file: it names the drive."
)


@click.group(cls=Verbs)
def rail() -> None:
    """Find the axis's zero, and the middle of the rail (docs/homing.md).

    \b
    Examples:
      softarm rail home --config softarm.yaml        after every power cycle of a drive that forgets its zero
      softarm rail centre --config softarm.yaml      once, and when something on the rail was changed
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
@click.option("--relay", is_flag=True, help="Hold a board's relay in DI7 closed (docs/homing.md).")
@click.option("--yes", is_flag=True, help="Do not ask: the rail is free, and somebody at the emergency stop.")
def home(config_file: Path, speed_m_s: float, reset_fault: bool, relay: bool, yes: bool) -> None:
    """Have the drive find its zero by its own method, slowly, and leave it off. THE CART MOVES.

    No daemon may run with this configuration: a drive has one master. The regulator is not touched; with
    --relay it is vented. What moves, where and how fast is said first. Ctrl-C brakes and switches off, and so does
    everything that goes wrong.

    \b
    Examples:
      softarm rail home --config softarm.yaml
      softarm rail home --config softarm.yaml --speed 0.02 --yes
      softarm rail home --config softarm.yaml --reset-fault      after a limit switch, or another fault
    """
    from softarm.drivers.base import DeviceError
    from softarm.drivers.rail.commissioning.visit import Visit
    from softarm.drivers.rail.settings import settings_of

    if speed_m_s != speed_m_s:
        raise click.BadParameter("nan is no speed; allowed 0.005 to 0.1 m/s", param_hint="--speed")
    config = configuration(config_file)
    leaves("nothing had moved; the drive is off")
    with only_one(config), relay_held(config, relay) as hold:
        try:
            with Visit(settings_of(config.drivers.rail), beside=hold) as drive:
                ready(drive, reset_fault, relay)
                say_what_moves(drive, config_file, speed_m_s, relay)
                if not (yes or allowed()):
                    fail("nothing moved: not wanted")
                enabled(drive, relay)
                found = searched(drive, speed_m_s)
        except DeviceError as error:
            fail(str(error))
    tell(found, config, config_file)


@rail.command()
@config_option
@click.option("--seconds", type=click.FloatRange(1, 600), help="Watch for so long (default: until Enter is pressed).")
@click.option("--write", is_flag=True, help="Write what was found into the configuration; comments stay.")
@click.option("--url", envvar="SOFTARM_URL", show_envvar=True, help="A running daemon's (default: as the file says).")
@click.option("--token-file", type=FILE, help="File with the API's token; else $SOFTARM_TOKEN. Not needed on loopback.")
def centre(config_file: Path, seconds: float | None, write: bool, url: str | None, token_file: Path | None) -> None:
    """Find the middle of the rail while you push the cart from end to end by hand. Nothing moves by itself.

    With a disarmed daemon of this configuration running, motion capture is held against the axis as well: a wrong
    units_per_m and an axis that counts the other way show. Without one the drive itself is asked, which is off.

    \b
    Examples:
      softarm rail centre --config softarm.yaml              says what it finds
      softarm rail centre --config softarm.yaml --write      and writes drivers.rail.centre_m
      softarm rail centre --config softarm.yaml --seconds 30
    """
    from softarm.drivers.rail.commissioning.centre import centre as judge

    leaves("nothing was written, and nothing had moved by itself")
    config = configuration(config_file)
    with rail_sources.source(config, config_file, url, token_of(token_file)) as source:
        end = "Enter ends it" if seconds is None else f"you have {seconds:g} s"
        click.echo(
            f"Push the cart by hand, slowly, until it stops at one end, then at the other; {end}. ({source.name})"
        )
        samples = pushed(source, seconds)
    tell_centre(judge(samples, config.drivers.rail), config, config_file, write)
