"""`softarm rail`: home the axis and find the middle of the rail, without a daemon."""

import select
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import click

from softarm.cli.shared.client import Remote, options_for, url_of
from softarm.cli.shared.console import FILE, Number, given, load_config, token_of, token_option, url_option, write
from softarm.cli.shared.errors import fail, leaves
from softarm.common.processes import bar

if TYPE_CHECKING:
    from softarm.drivers.rail.commissioning.centre import Centre, Sample
    from softarm.drivers.rail.commissioning.session import DriveSession, Homed
    from softarm.drivers.rail.feedback import Feedback
    from softarm.schemas.config import Config, DryveRail

SEEN_MS = 100.0  # older frames show a former position
AT_REST = ("disarmed", "stopped")


class Source(NamedTuple):
    """Source of samples of a cart that is pushed by hand."""

    sample: "Callable[[], Sample | None]"
    pause: Callable[[float], object]
    clock: Callable[[], int]  # ns
    name: str


@contextmanager
def only_one(config: "Config") -> Iterator[None]:
    """Keep daemons from using this axis while the context lasts; end the command if one does."""
    from softarm.daemon.config.configuration import latch_path
    from softarm.daemon.doctor.ports import is_connected
    from softarm.daemon.stop.latch import LatchError, LatchKeeper

    drive = config.drivers.rail
    keeper = LatchKeeper(latch_path(config))
    try:
        keeper.start()
    except LatchError as error:
        fail(f"the drive has one master at a time: {error}")
    try:
        if is_connected(drive.host, drive.port):
            end = "end the daemon (Ctrl-C where it runs, or `systemctl stop softarmd`), then wait 3 s"
            fail(f"{drive.host}:{drive.port} is in use by another program, and accepts one master: {end}")
        if keeper.left is not None:
            click.echo(f"the robot's stop stays latched: {keeper.left}", err=True)
        yield
    finally:
        keeper.stop()


@contextmanager
def source(config: "Config", file: Path, named: str | None, token: str | None) -> Iterator[Source]:
    """Yield the daemon at a `named` URL or of this configuration, which has motion capture, or else the drive."""
    from softarm.daemon.doctor import running

    url = named or url_of(config.api)
    with Remote(url, token, options_for(config.api) if named is None else given("url", "token_file")) as daemon:
        try:
            found = running.look(url, token, samples=1)
        except ValueError as error:
            raise click.BadParameter(f"{error}; e.g. http://127.0.0.1:8080", param_hint="--url") from None
        if found is None and named is not None:
            fail(f"no daemon at {url}: correct --url, or omit it to read the drive")
        if found is not None and found.refused is not None:
            fail(f"{url}: {found.refused}; give its token with --token-file")
        if found is not None and not daemon.get("/api/robot")["simulated"]:
            if file.stat().st_mtime > time.time() - found.statuses[-1]["uptime_s"]:
                fail(f"{file} has changed since the daemon started with it: restart the daemon first")
            yield Source(
                lambda: _of_daemon(daemon, config.drivers.rail), time.sleep, time.monotonic_ns, f"daemon at {url}"
            )
            return
    from softarm.drivers.rail.commissioning.centre import Sample
    from softarm.drivers.rail.commissioning.session import DriveSession
    from softarm.drivers.rail.settings import settings_of

    settings = settings_of(config.drivers.rail)
    with only_one(config), DriveSession(settings) as drive:
        if drive.homed() is False:
            fail("the drive is not homed, so its middle is meaningless: `softarm rail home` first")
        name = f"drive at {settings.host}:{settings.port}; motion capture is not looked at without a daemon"
        yield Source(lambda: Sample(settings.axis_m(drive.poll().position_m)), drive.pause, drive.clock, name)


def _of_daemon(daemon: Remote, rail: "DryveRail") -> "Sample | None":
    from softarm.drivers.rail.commissioning.centre import Sample
    from softarm.drivers.rail.settings import settings_of
    from softarm.schemas.policy import Observation

    status = daemon.get("/api/status")
    if status["mode"] not in AT_REST:
        fail(f"the arm is {status['mode']}: {daemon.command('disarm')} first; the cart is pushed by hand, drive off")
    if any(event["name"] == "rail_not_homed" for event in status["events"]):
        fail("the drive is not homed, so its middle is meaningless: end the daemon, then `softarm rail home`")
    if (position_m := status["rail_position_m"]) is None:
        return None
    seen, age_ms = status["observed"], status["ages_ms"]["mocap"]
    fresh = seen is not None and age_ms is not None and age_ms < SEEN_MS
    return Sample(settings_of(rail).axis_m(position_m), Observation(*seen["values"]).cart_position_m if fresh else None)


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
    """Run the search, checking for SIGINT, SIGTERM and SIGHUP at every poll instead of raising."""
    asked: list[int] = []
    leaves("the cart was braked and the drive is off; the search was NOT finished: home the axis before arming")
    ends = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
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


POLL_S = 0.05


def pushed(source: Source, seconds: float | None) -> "list[Sample]":
    """Collect samples while a person pushes the cart from end to end, until Enter or for a given time."""
    if seconds is None and not sys.stdin.isatty():
        fail("no terminal to press Enter on: give the duration with --seconds")
    until_ns = None if seconds is None else source.clock() + round(seconds * 1e9)
    samples: list[Sample] = []
    with bar("push the cart", None) as progress:
        while source.clock() < until_ns if until_ns is not None else not _enter():
            if (sample := source.sample()) is not None:
                samples.append(sample)
                axis = [each.axis_m for each in samples]
                mocap = "not seen" if sample.mocap_m is None else f"{sample.mocap_m:+.3f} m"
                progress.show(
                    text=f"axis {sample.axis_m:.4f} m, motion capture {mocap}; so far {max(axis) - min(axis):.3f} m"
                )
            source.pause(POLL_S)
    return samples


def _enter() -> bool:
    ready, _, _ = select.select([sys.stdin], [], [], 0.0)
    return bool(ready and sys.stdin.readline())


def report_centre(found: "Centre", config: "Config", file: Path, to_file: bool) -> None:
    """Print the findings and, if requested, write them into the configuration."""
    from softarm.daemon.config.edit import with_values

    for sentence in found.found:
        click.echo(sentence)
    if found.problems:
        fail("\n".join((*found.problems, "nothing was written")))
    if not found.values:
        click.echo(f"{file}: drivers.rail is correct and was not changed")
        return
    for key, value in found.values.items():
        click.echo(
            f"drivers.rail.{key}: {str(value).lower() if isinstance(value, bool) else f'{value:.10g}'}"
            f"  (is {str(getattr(config.drivers.rail, key)).lower()})"
        )
    if "reversed" in found.values:
        click.echo(
            "or motion capture's y axis is the wrong way round: with pressure the arm bends towards -y. Look first."
        )
    if not to_file:
        click.echo(f"nothing was written; repeat with --write to change {file}")
        return
    write(file, with_values(file.read_text(encoding="utf-8"), file, ("drivers", "rail"), found.values))
    click.echo(
        f"next: restart the daemon; `softarm doctor --config {file}` shows the distance between axis and cameras"
    )


config_option = click.option(
    "--config", "config_file", type=FILE, required=True, help="The daemon's configuration, which names the drive."
)


@click.group()
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
    type=Number(0.005, 0.1),
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
@click.option("--seconds", type=Number(1, 600), help="Duration of the push (default: until Enter is pressed).")
@click.option("--write", "to_file", is_flag=True, help="Write the result into the configuration, keeping its comments.")
@url_option
@token_option
def centre(config_file: Path, seconds: float | None, to_file: bool, url: str | None, token_file: Path | None) -> None:
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
    report_centre(judge(samples, config.drivers.rail), config, config_file, to_file)
