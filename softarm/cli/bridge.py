"""`softarm bridge`: pass on motion capture of other systems to the daemon, and find the pose of the cameras."""

import json
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import closing
from datetime import date
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.shared.console import (
    FILE,
    Number,
    check_places,
    print_json,
    print_option,
    print_table,
    waiting,
    warn,
    write,
)
from softarm.cli.shared.errors import NOTHING, fail, leaves
from softarm.common.processes import bar

if TYPE_CHECKING:
    from softarm.drivers.bridge.bridging import Bridging, Row, Status
    from softarm.drivers.bridge.calibration import Found
    from softarm.drivers.bridge.gathering import Gathering, Phase
    from softarm.schemas.bridge import Bridge

server_option = click.option(
    "--server", metavar="ADDRESS", help="Computer that runs Motive; overrides the file's `server`."
)


def settings(server: str | None, config_file: Path | None) -> "tuple[Bridge, str]":
    """Return the bridge's configuration and the server's address; end the command if one is wrong."""
    from softarm.drivers.bridge.bridging import read
    from softarm.schemas.bridge import Bridge

    config = Bridge() if config_file is None else read(config_file)
    if (address := server or config.server) is None:
        raise click.UsageError("which cameras? --server ADDRESS of the computer that runs Motive, or --config FILE")
    return config, address


LOOK_S = 10.0  # time for the first frame


def look(config: "Bridge", address: str, as_json: bool) -> None:
    """Print the bodies that a server streams, and the frames that the daemon would receive."""
    from softarm.drivers.bridge.bridging import look_at
    from softarm.drivers.bridge.client import Client

    with waiting(f"looking at {address}"), Client(config, address, warn) as client:
        found = look_at(config, client, LOOK_S)
    if as_json:
        print_json({**found.status._asdict(), "bodies": [row._asdict() for row in found.rows]})
    else:
        print_table(
            ("body", "rigid body", "id", "seen", "in the room, m", "y, z, angle"), map(_cells, found.rows), width=120
        )
        click.echo(found.status.line())
    if found.problem:
        fail(found.problem)


def _cells(row: "Row") -> tuple[str, ...]:
    room = "" if row.room_m is None else " ".join(f"{part:+.3f}" for part in row.room_m)
    pose = "" if row.pose is None else "{:+.3f} {:.3f} m {:+.3f} rad".format(*row.pose)
    number = "" if row.id is None else str(row.id)
    return row.body or "-", row.rigid_body, number, f"{100 * row.seen:.0f} %", room, pose


def screen(as_json: bool) -> "tuple[Callable[[Status], None], Callable[[str], None]]":
    """Return functions that show a status and print a line, in the form for a terminal, a file or JSON."""
    if as_json:
        return lambda status: click.echo(json.dumps(status._asdict())), lambda text: click.echo(text, err=True)
    if not sys.stdout.isatty():
        return lambda status: None, lambda text: click.echo(f"softarm bridge: {text}")
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    live = Live(console=Console(), auto_refresh=False)
    click.get_current_context().with_resource(live)

    def show(status: "Status") -> None:
        live.update(Text(status.line()), refresh=True)

    return show, lambda text: live.console.print(Text(text))


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
@click.option("--seconds", type=Number(1, 3600), default=90.0, show_default=True, help="Time limit of each step.")
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


SHOWN_S = 0.2  # interval of the status on a terminal
PRINTED_S = 1.0  # interval of the objects of --json


@click.group()
def bridge() -> None:
    """Pass on motion capture to the daemon, and find the pose of the cameras relative to the robot.

    \b
    Examples:
      softarm bridge natnet --server 192.168.1.10 --once        show the server and its bodies
      softarm bridge calibrate --server 192.168.1.10            write bridge.yaml
      softarm bridge natnet --config bridge.yaml                next to `softarm run`
    """


@bridge.command()
@server_option
@click.option(
    "--config", "config_file", type=FILE, help="bridge.yaml; without it the cameras' frame is used unchanged."
)
@click.option("--once", is_flag=True, help="Print the bodies seen within a second; publish nothing.")
@print_option
def natnet(server: str | None, config_file: Path | None, once: bool, as_json: bool) -> None:
    """Publish the rigid bodies that OptiTrack's Motive streams, until Ctrl-C or SIGTERM.

    Daemon and Motive may start later, and may restart. Changes are printed as lines; on a terminal the last line shows
    the current status. With --json one object per second is printed. docs/hardware/bridge.md describes the settings of
    Motive.

    \b
    Examples:
      softarm bridge natnet --server 192.168.1.10 --once
      softarm bridge natnet --config bridge.yaml
      softarm bridge natnet --config bridge.yaml --json > bridge.jsonl
    """
    from softarm.common import realtime
    from softarm.drivers.bridge.bridging import Bridging, Publisher
    from softarm.drivers.bridge.client import Client

    config, address = settings(server, config_file)
    if once:
        leaves(NOTHING)
        look(config, address, as_json)
        return
    leaves("publishing has ended; an arm in flight makes a soft stop")
    ended = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: ended.set())
    signal.signal(signal.SIGINT, signal.default_int_handler)  # shells ignore SIGINT in background commands
    realtime.outrank_other_programs(realtime.BASE_PRIORITY)  # cameras do not wait for other programs
    if config_file is None:
        click.echo(
            "not calibrated: the room is taken as it stands; `softarm bridge calibrate` finds how it lies", err=True
        )
    show, log = screen(as_json)
    with closing(Publisher(config.daemon, log)) as publisher, Client(config, address, log) as client:
        publisher.open()
        _carry(Bridging(config, client, publisher, log), show, PRINTED_S if as_json else SHOWN_S, ended)


def _carry(bridging: "Bridging", show: "Callable[[Status], None]", period_s: float, ended: threading.Event) -> None:
    """Relay frames until the end is requested."""
    due_s = 0.0
    while not ended.is_set():
        bridging.step()
        if (now_s := time.monotonic()) >= due_s:
            due_s = now_s + period_s
            show(bridging.status())


bridge.add_command(calibrate)
