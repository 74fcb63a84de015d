"""What `softarm rail home` asks first, says first, and says last."""

import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.errors import fail
from softarm.cli.interrupt import leaves
from softarm.common.processes import bar

if TYPE_CHECKING:
    from softarm.drivers.rail.commissioning.visit import Homed, Visit
    from softarm.drivers.rail.feedback import Feedback
    from softarm.schemas.config import Config

RELAY_S, WAIT_S = 4.0, 0.02  # the board closes it a second after it hears the first command
CREEP = 0.2  # of the speed: towards the zero, once the switch was found


def enabled(drive: "Visit", relay: bool) -> None:
    """The enable input is high; a relay has a while to close. Ends the command otherwise."""
    until_ns = drive.clock() + round(RELAY_S * 1e9 if relay else 0.0)
    while not drive.look().remote:
        if drive.clock() >= until_ns:
            what = (
                "or see that the board hears (docs/firmware.md)" if relay else "or give --relay if a board's is there"
            )
            fail(f"{drive.settings.host}:{drive.settings.port}: DI7 is low; release the hardware e-stop, {what}")
        drive.pause(WAIT_S)


def ready(drive: "Visit", reset_fault: bool, relay: bool) -> None:
    """Nothing stands against a search. Ends the command otherwise."""
    where = f"{drive.settings.host}:{drive.settings.port}"
    if drive.found_in_operation:
        fail(f"{where}: was in operation, and was switched off: end whatever leads it, on this computer or another")
    enabled(drive, relay)
    if reset_fault:
        drive.reset_fault()
    seen = drive.look()
    if seen.faults():
        remedy = "see to its cause, then give --reset-fault; an invalid boot state needs a power cycle"
        fail(f"{where}: the drive reports {', '.join(seen.faults())}; {remedy}")
    if drive.method() == 0:
        fail(f"{where}: no homing method is set (6098h is 0); choose one on the drive's web page (docs/homing.md)")


def say_what_moves(drive: "Visit", file: Path, speed_m_s: float, relay: bool) -> None:
    """The robot of which file, what of it, by whom, where and how fast."""
    from softarm.drivers.rail.commissioning.visit import METHODS
    from softarm.schemas.robot import RAIL_TRAVEL_M

    method = drive.method()
    way = "that its web page shows" if method is None else f"{method} ({METHODS.get(method, 'see its manual')})"
    said = {True: "says that it is homed", False: "says that it is not homed", None: "cannot say whether it is homed"}
    axis_m = drive.settings.axis_m(drive.look().position_m)
    click.echo(
        f"The robot of {file} will move: the cart, by the drive at {drive.settings.host}:{drive.settings.port}, "
        f"anywhere between the ends of its {2 * RAIL_TRAVEL_M:g} m of travel, at {speed_m_s:g} m/s and back at "
        f"{CREEP * speed_m_s:g} m/s, by the drive's homing method {way}. The drive {said[drive.homed()]}; its axis "
        f"reads {axis_m:.4f} m. The muscle is {'vented' if relay else 'not touched'}. Ctrl-C brakes and switches off; "
        "the e-stop is surer.",
        err=True,
    )


def allowed() -> bool:
    """Ask a person. Ends the command where there is none."""
    if not sys.stdin.isatty():
        fail("nothing moved, for nobody can be asked: give --yes")
    return click.confirm("Is the whole rail free, and somebody at the emergency stop?", default=False, err=True)


def searched(drive: "Visit", speed_m_s: float) -> "Homed":
    """Ctrl-C and SIGTERM are no exception here: they are asked after at every poll."""
    asked: list[int] = []
    leaves("the cart was braked and the drive is off; its search was NOT finished: home it before the arm is armed")
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


def tell(found: "Homed", config: "Config", file: Path) -> None:
    """What was found, and the next step."""
    limits = config.limits.rail
    said = "the drive says so" if found.confirmed else "the drive cannot say"
    click.echo(
        f"homed ({said}), and the drive is off: the axis reads {found.axis_m:.4f} m; with drivers.rail.centre_m "
        f"{config.drivers.rail.centre_m:g} the cart stands at {found.position_m:+.4f} m"
    )
    if not limits.position_min_m <= found.position_m <= limits.position_max_m:
        click.echo("that is outside limits.rail: push the cart to the middle by hand before you arm")
    click.echo(f"next: `softarm rail centre --config {file}` the first time, then `softarm run --config {file}`")
