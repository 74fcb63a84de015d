"""`softarm rail`: home the axis and find the middle of the rail, without a daemon."""

from pathlib import Path

import click

from softarm.cli.rail.centring import pushed, report_centre
from softarm.cli.rail.homing import allowed, announce_motion, enabled, ready, relay_held, report_homed, searched
from softarm.cli.rail.sources import only_one, source
from softarm.cli.shared.errors import fail
from softarm.cli.shared.interrupt import leaves
from softarm.cli.shared.options import FILE, load_config, token_of, token_option, url_option
from softarm.cli.verbs import Verbs

config_option = click.option(
    "--config", "config_file", type=FILE, required=True, help="The daemon's configuration, which names the drive."
)


@click.group(cls=Verbs)
def rail() -> None:
    """Home the axis and find the middle of the rail (docs/operate/homing.md).

    \b
    Examples:
      softarm rail home --config softarm.yaml        after every power cycle of a drive that loses its zero
      softarm rail centre --config softarm.yaml      once, and after every change of the rail
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
    help="Speed towards the switch, 0.005 to 0.1 m/s; a fifth of it towards the zero.",
)
@click.option("--reset-fault", is_flag=True, help="First reset a fault of the drive whose cause you have removed.")
@click.option("--relay", is_flag=True, help="Keep the board's relay in DI7 closed (docs/operate/homing.md).")
@click.option("--yes", is_flag=True, help="Do not ask: the rail is free, and a person is at the emergency stop.")
def home(config_file: Path, speed_m_s: float, reset_fault: bool, relay: bool, yes: bool) -> None:
    """Let the drive search its zero slowly with its own homing method, then switch it off. THE CART MOVES.

    No daemon may run with this configuration, since a drive has one master. The regulator is not touched; with --relay
    the muscle is vented. The command first states what moves, where and how fast. Ctrl-C and every error brake the cart
    and switch the drive off.

    \b
    Examples:
      softarm rail home --config softarm.yaml
      softarm rail home --config softarm.yaml --speed 0.02 --yes
      softarm rail home --config softarm.yaml --reset-fault      after a limit switch, or another fault
    """
    from softarm.drivers.rail.commissioning.session import DriveSession
    from softarm.drivers.rail.settings import settings_of

    if speed_m_s != speed_m_s:
        raise click.BadParameter("nan is no speed; allowed 0.005 to 0.1 m/s", param_hint="--speed")
    config = load_config(config_file)
    leaves("nothing moved; the drive is off")
    with (
        only_one(config),
        relay_held(config, relay) as hold,
        DriveSession(settings_of(config.drivers.rail), on_exchange=hold) as drive,
    ):
        ready(drive, reset_fault, relay)
        announce_motion(drive, config_file, speed_m_s, relay)
        if not (yes or allowed()):
            fail("nothing moved: you declined")
        enabled(drive, relay)
        found = searched(drive, speed_m_s)
    report_homed(found, config, config_file)


@rail.command()
@config_option
@click.option(
    "--seconds", type=click.FloatRange(1, 600), help="Duration of the push (default: until Enter is pressed)."
)
@click.option("--write", is_flag=True, help="Write the result into the configuration, keeping its comments.")
@url_option
@token_option
def centre(config_file: Path, seconds: float | None, write: bool, url: str | None, token_file: Path | None) -> None:
    """Find the middle of the rail while you push the cart from end to end by hand. The drive does not move it.

    With a disarmed daemon of this configuration, motion capture is compared with the axis, too: this shows a wrong
    units_per_m and an axis with reversed direction. Without a daemon the command reads the drive, which is off.

    \b
    Examples:
      softarm rail centre --config softarm.yaml              prints the result
      softarm rail centre --config softarm.yaml --write      also writes drivers.rail.centre_m
      softarm rail centre --config softarm.yaml --seconds 30
    """
    from softarm.drivers.rail.commissioning.centre import centre as judge

    leaves("nothing was written, and the drive did not move")
    config = load_config(config_file)
    with source(config, config_file, url, token_of(token_file)) as seen:
        end = "Enter ends it" if seconds is None else f"you have {seconds:g} s"
        click.echo(f"Push the cart by hand, slowly, until it stops at one end, then at the other; {end}. ({seen.name})")
        samples = pushed(seen, seconds)
    report_centre(judge(samples, config.drivers.rail), config, config_file, write)
