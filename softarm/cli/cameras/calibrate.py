"""`softarm bridge calibrate`: find the pose of the cameras from a resting arm and a pushed cart."""

import sys
from datetime import date
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.cameras.settings import server_option, settings
from softarm.cli.shared.errors import fail
from softarm.cli.shared.interrupt import NOTHING, leaves
from softarm.cli.shared.options import FILE, check_places, write
from softarm.cli.shared.printing import warn
from softarm.common.processes import bar

if TYPE_CHECKING:
    from softarm.drivers.bridge.calibration import Found
    from softarm.drivers.bridge.gathering import Gathering, Phase
    from softarm.schemas.bridge import Bridge

END = "At which end of the rail does the cart stand now: the one where the rail's own position is positive (+y)?"


@click.command()
@server_option
@click.option(
    "--config", "config_file", type=FILE, help="An existing bridge.yaml with names, ports and daemon to keep."
)
@click.option("--out", type=FILE, default=Path("bridge.yaml"), show_default=True, help="File to write.")
@click.option("--replace", is_flag=True, help="Overwrite an existing file.")
@click.option(
    "--end", type=click.Choice(["+y", "-y"]), help="End of the rail where the push ends; asked for otherwise."
)
@click.option("--middle", is_flag=True, help="The cart rests in the middle, so that one push is enough.")
@click.option(
    "--straight", is_flag=True, help="The arm hangs straight at rest; otherwise slightly bent as in the model."
)
@click.option(
    "--seconds", type=click.FloatRange(1, 3600), default=90.0, show_default=True, help="Time limit of each step."
)
def calibrate(
    server: str | None,
    config_file: Path | None,
    out: Path,
    replace: bool,
    end: str | None,
    middle: bool,
    straight: bool,
    seconds: float,
) -> None:
    """Find the pose of the cameras relative to the robot: let the arm hang, then push the cart by hand, DRIVE OFF.

    Rest is detected when nothing moves for three seconds, the end of the push when the cart stands for two, so no key
    is needed. The command moves nothing and publishes nothing. If the data does not fit, it names the reason and does
    not write.

    \b
    Examples:
      softarm bridge calibrate --server 192.168.1.10
      softarm bridge calibrate --server 192.168.1.10 --middle --end +y
      softarm bridge calibrate --config bridge.yaml --out new.yaml
    """
    from softarm.drivers.bridge import written
    from softarm.drivers.bridge.calibration import calibrate as calculate
    from softarm.drivers.bridge.client import Client
    from softarm.drivers.bridge.gathering import Gathering, gather

    config, address = settings(server, config_file)
    if out.exists() and not replace:
        fail(f"{out}: exists and was not changed; name another --out, or give --replace")
    check_places(out)
    if end is None and not sys.stdin.isatty():
        raise click.UsageError(
            "without a terminal, name the end of the rail where the last push stops: --end +y or --end -y"
        )
    leaves(NOTHING)
    gathering = Gathering(tuple(config.bodies.used), middle)
    warn("let the arm hang still, drive off and vented" + (", the cart in the middle of the rail" if middle else ""))
    with Client(config, address, warn) as client, bar("calibrating", None) as shown:
        begin = partial(_next, config, gathering, middle)
        gather(config, client, gathering, seconds, begin, lambda text: shown.show(text=text))
    if end is None:
        end = "+y" if click.confirm(END, err=True) else "-y"
    found = calculate(gathering.rest, gathering.push, config.bodies, end == "+y", middle, straight)
    whole = written.configuration(config, address, found)
    write(out, written.text(whole, found, date.today()))
    _report(found, out)


def _next(config: "Bridge", gathering: "Gathering", middle: bool, phase: "Phase") -> None:
    """Check the resting arm before the push, or raise CalibrationError."""
    from softarm.drivers.bridge.calibration import check_rest
    from softarm.drivers.bridge.gathering import Phase

    way = "to one end" if middle else "to one stop, then to the other"
    if phase is Phase.PUSHING:
        check_rest(gathering.rest, config.bodies)
        warn(f"it hangs still; now push the cart slowly along the rail {way}, and leave it there")


def _report(found: "Found", out: Path) -> None:
    room = found.room
    place = ", ".join(f"{part:.3f}" for part in room.origin_m)
    lies = f"up {room.up}, yaw {room.yaw_rad:.4f} rad"
    click.echo(f"rail: {found.travel_m:.3f} m, straight to {1e3 * found.crooked_m:.1f} mm; {lies}")
    click.echo(f"floor below the middle of the rail: {place} m; tilt {room.tilt_rad:+.4f} rad")
    for note in found.notes:
        click.echo(f"note: {note}")
    click.echo(f"next: `softarm bridge natnet --config {out} --once` shows the arm as the daemon will see it")
