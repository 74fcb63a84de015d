"""Checks before, announcement of and report after `softarm rail home`."""

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.shared.errors import fail
from softarm.cli.shared.interrupt import leaves
from softarm.common.processes import bar

if TYPE_CHECKING:
    from softarm.drivers.rail.commissioning.session import DriveSession, Homed
    from softarm.drivers.rail.feedback import Feedback
    from softarm.schemas.config import Config

RELAY_S = 4.0  # the board closes the relay a second after the first command
WAIT_S = 0.02
CREEP = 0.2  # share of the speed, towards the zero after the switch was found


@contextmanager
def relay_held(config: "Config", wanted: bool) -> Iterator[Callable[[], object]]:
    """Yield a function that keeps the board's relay closed while it is called; it does nothing if not wanted."""
    if not wanted:
        yield lambda: None
        return
    from softarm.drivers.rail.commissioning.relay import Relay

    with Relay(config.drivers.regulator) as relay:
        yield relay.hold


def enabled(drive: "DriveSession", relay: bool) -> None:
    """Wait for the enable input, as long as a relay needs to close; end the command if it stays low."""
    until_ns = drive.clock() + round(RELAY_S * 1e9 if relay else 0.0)
    while not drive.poll().remote:
        if drive.clock() >= until_ns:
            what = (
                "or check the connection of the board (docs/hardware/firmware.md)"
                if relay
                else "or use --relay if a board has a relay"
            )
            fail(f"{drive.settings.host}:{drive.settings.port}: DI7 is low; release the hardware e-stop, {what}")
        drive.pause(WAIT_S)


def ready(drive: "DriveSession", reset_fault: bool, relay: bool) -> None:
    """Check that the drive can search its zero; end the command otherwise."""
    where = f"{drive.settings.host}:{drive.settings.port}"
    if drive.was_operating:
        fail(f"{where}: was in operation and has been switched off: end its other master, on this or another computer")
    enabled(drive, relay)
    if reset_fault:
        drive.reset_fault()
    seen = drive.poll()
    if seen.faults():
        remedy = "remove the cause, then use --reset-fault; an invalid boot state needs a power cycle"
        fail(f"{where}: the drive reports {', '.join(seen.faults())}; {remedy}")
    if drive.method() == 0:
        fail(
            f"{where}: no homing method is set (6098h is 0); "
            "choose one on the drive's web page (docs/operate/homing.md)"
        )


def announce_motion(drive: "DriveSession", file: Path, speed_m_s: float, relay: bool) -> None:
    """Print which robot moves, by which drive, where and how fast."""
    from softarm.drivers.rail.commissioning.session import METHODS
    from softarm.schemas.robot import RAIL_TRAVEL_M

    method = drive.method()
    way = "that its web page shows" if method is None else f"{method} ({METHODS.get(method, 'see its manual')})"
    said = {True: "says that it is homed", False: "says that it is not homed", None: "cannot say whether it is homed"}
    axis_m = drive.settings.axis_m(drive.poll().position_m)
    click.echo(
        f"The robot of {file} will move: the cart, by the drive at {drive.settings.host}:{drive.settings.port}, "
        f"anywhere between the ends of its {2 * RAIL_TRAVEL_M:g} m of travel, at {speed_m_s:g} m/s and back at "
        f"{CREEP * speed_m_s:g} m/s, by the drive's homing method {way}. The drive {said[drive.homed()]}; its axis "
        f"reads {axis_m:.4f} m. The muscle is {'vented' if relay else 'not touched'}. Ctrl-C brakes and switches off; "
        "the e-stop is surer.",
        err=True,
    )


def allowed() -> bool:
    """Return whether a person agrees; end the command if no terminal is connected."""
    if not sys.stdin.isatty():
        fail("nothing moved, because no terminal can confirm: use --yes")
    return click.confirm("Is the whole rail free, and a person at the emergency stop?", default=False, err=True)


def searched(drive: "DriveSession", speed_m_s: float) -> "Homed":
    """Run the search, checking for SIGINT and SIGTERM at every poll instead of raising."""
    asked: list[int] = []
    leaves("the cart was braked and the drive is off; the search was NOT finished: home the axis before arming")
    ends = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.signal(number, lambda got, _: asked.append(got)) for number in ends}
    try:
        with bar("homing", None) as progress:

            def show(seen: "Feedback") -> None:
                progress.show(text=f"homing: the axis at {drive.settings.axis_m(seen.position_m):.3f} m")

            return drive.home(speed_m_s, CREEP * speed_m_s, lambda: bool(asked), show)
    except Exception:
        if signal.SIGINT in asked:
            raise KeyboardInterrupt from None
        raise
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def report_homed(found: "Homed", config: "Config", file: Path) -> None:
    """Print the result and the next step."""
    limits = config.limits.rail
    said = "the drive says so" if found.confirmed else "the drive cannot say"
    click.echo(
        f"homed ({said}), and the drive is off: the axis reads {found.axis_m:.4f} m; with drivers.rail.centre_m "
        f"{config.drivers.rail.centre_m:g} the cart stands at {found.position_m:+.4f} m"
    )
    if not limits.position_min_m <= found.position_m <= limits.position_max_m:
        click.echo("outside limits.rail: push the cart to the middle by hand before arming")
    click.echo(f"next: `softarm rail centre --config {file}` the first time, then `softarm run --config {file}`")
