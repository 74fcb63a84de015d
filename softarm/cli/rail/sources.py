"""Exclusive access to the drive, and samples for `softarm rail centre` from the running daemon or from the drive."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import click

from softarm.cli.shared.client import Remote, options_for, url_of
from softarm.cli.shared.errors import fail
from softarm.cli.shared.options import given

if TYPE_CHECKING:
    from softarm.drivers.rail.commissioning.centre import Sample
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
            _check_age(file, found.statuses[-1]["uptime_s"])
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


def _check_age(file: Path, uptime_s: float) -> None:
    if file.stat().st_mtime > time.time() - uptime_s:
        fail(f"{file} has changed since the daemon started with it: restart the daemon first")


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
