"""Output of `softarm bridge`: the status of the stream, and its bodies."""

import json
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING

import click

from softarm.cli.shared.errors import fail
from softarm.cli.shared.printing import print_json, print_table, waiting, warn

if TYPE_CHECKING:
    from softarm.drivers.bridge.bridging import Row, Status
    from softarm.schemas.bridge import Bridge

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
