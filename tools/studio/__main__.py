"""Open a log of `softarm logs export --to foxglove` in Foxglove Studio, with the exported layout.

    python -m tools.studio LOG --at 0.46 --out docs/pictures/foxglove.png

The Studio is @foxglove/studio-base 1.48 from npm (MPL-2.0), the last open version. It is downloaded into a temporary
folder (180 MB) and opened in Chromium. Exits with 1 if it reports a problem with the log.
"""

import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import quote

import click
import uvicorn
from playwright.sync_api import Page
from rich.console import Console
from rich.markup import escape
from starlette.applications import Starlette
from starlette.routing import Mount
from starlette.staticfiles import StaticFiles

from softarm.daemon.logbook import logs
from softarm.recordings.foxglove import export
from tools import chromium

PACKAGES = "@foxglove/studio-base@1.48.0", "react@17", "react-dom@17"
WIDTH_PX, HEIGHT_PX = 1500, 900
WEBGL = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")  # WebGL without a GPU
LOADS_S, DRAWS_MS = 120.0, 6000
EDGE_PX, STRIP_PX = 8, 55  # distance of the time line from the window's sides and from its lower edge


def fetch(folder: Path) -> Path:
    """Return a folder with the Studio's files and a start page.

    Raises:
        click.ClickException: npm does not provide them.
    """
    if (npm := shutil.which("npm")) is None:
        raise click.ClickException("there is no npm here: apt-get install npm")
    command = [npm, "install", "--prefix", str(folder), "--ignore-scripts", "--legacy-peer-deps", *PACKAGES]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise click.ClickException(f"npm did not install the Studio: {done.stderr.strip()[-400:]}")
    site = folder / "node_modules" / "@foxglove" / "studio-base" / "assets"
    for name in ("react", "react-dom"):
        shutil.copy(folder / "node_modules" / name / "umd" / f"{name}.production.min.js", site)
    return site


@contextmanager
def served(site: Path) -> Iterator[str]:
    """Serve a folder over HTTP at a free port of this machine, with ranges, which the Studio needs."""
    files = Starlette(routes=[Mount("/", StaticFiles(directory=site, html=True))])
    server = uvicorn.Server(uvicorn.Config(files, port=0, log_level="warning"))
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    while not server.started:
        thread.join(0.05)
    try:
        yield f"http://127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}"
    finally:
        server.should_exit = True
        thread.join()


def look(page: Page, url: str, share: float) -> list[str]:
    """Open the log at a share of its time and return the Studio's problems with it."""
    problems: list[str] = []
    page.on("console", lambda said: problems.append(said.text) if said.text.startswith("Player problem") else None)
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.goto(f"{url}/?ds=remote-file&ds.url={quote(f'{url}/log.mcap')}", timeout=LOADS_S * 1e3)
    page.get_by_text("softarm.State").wait_for(timeout=LOADS_S * 1e3)
    page.wait_for_timeout(DRAWS_MS)  # the Studio does not report that it has drawn
    hint = page.get_by_text("Open settings to configure")
    if hint.is_visible():
        hint.locator("xpath=..").get_by_role("button").click()
    page.mouse.click(EDGE_PX + share * (WIDTH_PX - 2 * EDGE_PX), HEIGHT_PX - STRIP_PX)
    page.wait_for_timeout(DRAWS_MS)
    return list(dict.fromkeys(problems))


@click.command()
@click.argument("log", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--at", default=0.5, show_default=True, type=click.FloatRange(0, 1), help="A share of the log's time.")
@click.option("--out", required=True, type=click.Path(dir_okay=False, path_type=Path), help="The picture, PNG.")
def main(log: Path, at: float, out: Path) -> None:
    """Open LOG in Foxglove Studio and write a picture of it."""
    console = Console()
    with tempfile.TemporaryDirectory() as folder:
        with console.status("fetching the Studio: 180 MB ..."):
            site = fetch(Path(folder))
        recorded = logs.read(log)
        export.export(recorded, site / "log.mcap", recorded.entries())
        (site / "layout.json").write_text(export.layout())
        shutil.copy(Path(__file__).with_name("index.html"), site)
        with console.status("opening the log ..."), served(site) as url, chromium.opened(*WEBGL) as browser:
            page = browser.new_page(viewport={"width": WIDTH_PX, "height": HEIGHT_PX})
            problems = look(page, url, at)
            chromium.keep(page, out)
    for problem in problems:
        console.print(f"[red]{escape(problem[:300])}[/red]")
    console.print(f"{len(problems)} problems")
    sys.exit(bool(problems))


if __name__ == "__main__":
    main()
