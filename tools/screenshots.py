"""Make the pictures of the dashboard and tutorial pages from a real browser.

    python -m tools.screenshots --out docs/pictures

The browser shows a daemon with a simulated robot, and the report of a diagnosis.
"""

import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import click
import httpx
from playwright.sync_api import Browser, Page

from softarm.daemon.assembly import Daemon
from softarm.daemon.runtime.devices import Devices, simulated_devices
from softarm.diagnosis.data.read import read_all
from softarm.diagnosis.diagnose import diagnose
from softarm.diagnosis.report import page as page_of_report
from softarm.drivers.base import MocapSource
from softarm.evaluation.robots import with_faults
from softarm.reality.parameters import RobotParameters
from softarm.reality.record import record
from softarm.schemas.config import Config
from softarm.schemas.excitation import EXCITATIONS
from softarm.schemas.model import Model
from tools import chromium

TARGETS = ((-0.3, 0.6), (-0.12, 0.68), (-0.34, 0.65), (-0.05, 0.58), (-0.26, 0.64))
BETWEEN_S = 2.2
PATIENCE_S = 20.0
FAULTS, RECORDED = ("regulator.dead_time_s=0.06", "arm.payload_kg=0.03"), ("seed", "free-decay", "rail-steps", "both")
DESK, WIDE, PHONE = ({"width": w, "height": h} for w, h in ((1280, 860), (1920, 1080), (390, 844)))
# A browser makes a small machine skip ticks, which must not stop a simulated arm.
TOLERANT = {"missed_ticks_max": 30, "policy_budget_s": 0.03} | dict.fromkeys(
    ("mocap_stale_s", "pressure_stale_s", "rail_stale_s"), 1.0
)


@contextmanager
def _daemon() -> Iterator[tuple[Daemon, Devices]]:
    devices = simulated_devices()
    with tempfile.TemporaryDirectory() as folder:
        settings = {"api": {"port": 0, "stop_port": 0}, "recorder": {"directory": f"{folder}/logs"}}
        settings["control"] = {"realtime_priority": 0}  # the browser would inherit it
        settings["failsafe"] = TOLERANT
        with Daemon(Config.model_validate(settings), devices) as made:
            yield made, devices


def _until(met: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not met():
        if time.monotonic() > deadline:
            raise click.ClickException(f"{what}: not within {PATIENCE_S:g} s; is this computer busy? Try again")
        time.sleep(0.02)


def _fly(robot: httpx.Client) -> None:
    """Arm and fly some swings, the last of which continues."""

    def mode() -> str:
        return str(robot.get("/api/status").json()["mode"])

    _until(lambda: robot.post("/api/arm").is_success or mode() == "armed", "arming")
    _until(lambda: mode() == "armed", "arming")
    for y_m, z_m in TARGETS:
        time.sleep(BETWEEN_S)
        _until(partial(_sent, robot, y_m, z_m), "sending a target")


def _sent(robot: httpx.Client, y_m: float, z_m: float) -> bool:
    """Send a target; arm again first if a busy machine has disarmed the arm."""
    if robot.post("/api/goal", json={"kind": "reach", "y_m": y_m, "z_m": z_m}).is_success:
        return True
    robot.post("/api/arm")
    return False


def _open(browser: Browser, url: str, **options: Any) -> Page:
    page = browser.new_context(**{"viewport": DESK} | options).new_page()
    page.goto(url)
    page.locator("#link[data-link=live]").wait_for()
    return page


def _flying(browser: Browser, out: Path) -> None:
    with _daemon() as (daemon, _), httpx.Client(base_url=daemon.url) as robot:
        light = _open(browser, daemon.url)
        night = _open(browser, daemon.url, viewport=WIDE, color_scheme="dark")
        phone = _open(browser, daemon.url, viewport=PHONE, has_touch=True)
        night.locator("#panel-goals-tab").click()
        for page, name in ((light, "light"), (night, "night"), (phone, "phone")):
            _fly(robot)
            page.evaluate("scrollTo(0, 0)")
            page.wait_for_timeout(350)  # during the swing
            chromium.keep(page, out / f"dashboard-{name}.png")
        _swing(_open(browser, daemon.url, reduced_motion="reduce"), out)
        light.keyboard.press("Space")
        light.locator("#stopped[data-state=stopped]").wait_for()
        light.locator("#panel-events-tab").click()
        light.locator("#panel-events li.of-stop").first.wait_for()
        light.evaluate("scrollTo(0, 0)")
        chromium.keep(light, out / "dashboard-stopped.png")
    light.locator("#link[data-link=lost]").wait_for()
    light.wait_for_timeout(3000)
    chromium.keep(light, out / "dashboard-lost.png")


def _swing(page: Page, out: Path) -> None:
    """Take a picture of the last swing shortly before its closest moment."""
    page.locator("#swing[data-goal]").wait_for()
    page.locator("#replay input").fill("0.3")
    page.locator("#replay input").blur()
    page.evaluate("document.querySelector('header').style.position = 'static'")  # it would cover the panel
    chromium.keep(page.locator("#swing"), out / "dashboard-swing.png")


def _covered(cameras: MocapSource) -> AbstractContextManager[object]:
    """Simulate a dropout of the cameras."""
    real = cameras.read
    return mock.patch.object(cameras, "read", side_effect=lambda now_ns: real(now_ns)[:0])


def _refused(browser: Browser, out: Path) -> None:
    with _daemon() as (daemon, devices), _covered(devices.mocap):
        page = _open(browser, daemon.url)
        page.locator("#reasons .reason").first.wait_for()
        page.locator("#do-arm").click()
        page.locator("#said .notice.refused").wait_for()
        page.mouse.move(0, 0)
        chromium.keep(page, out / "dashboard-refused.png")


def _report(browser: Browser, out: Path) -> None:
    """Take pictures of the report of `softarm diagnose --report` for a robot with two faults."""
    robot = with_faults(RobotParameters(), FAULTS)
    with tempfile.TemporaryDirectory() as folder:
        for kind in RECORDED:
            flown = EXCITATIONS[kind]
            record(flown.at, Path(folder) / kind, flown.duration_s, robot, kind=kind, held=not flown.moves_rail)
        file = Path(folder) / "report.html"
        page_of_report.write(diagnose(read_all([Path(folder)]), Model()), file)
        page = browser.new_context(viewport={"width": 1100, "height": 760}).new_page()
        page.goto(file.as_uri())
        chromium.keep(page, out / "report.png")


@click.command()
@click.option(
    "--out", type=click.Path(file_okay=False, path_type=Path), default=Path("docs/pictures"), show_default=True
)
def main(out: Path) -> None:
    """Make the pictures of the pages again, which takes a minute and a half.

    \b
    Example:
      python -m tools.screenshots --out docs/pictures
    """
    with chromium.opened() as browser:
        out.mkdir(parents=True, exist_ok=True)
        _flying(browser, out)
        _refused(browser, out)
        _report(browser, out)


if __name__ == "__main__":
    main()
