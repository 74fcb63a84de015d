"""Time the first minutes of a new user: from a fresh clone to a target clicked in the browser, then their own policy.

    python -m tools.first_use --json FILE

The steps are those of README.md and docs/tutorial.md in an empty folder: clone this checkout, run `make demo` (packages
come over the network unless pip has them), start the daemon, and let a real browser arm, click and watch. The time to
read and think is not included. Needs Chromium and Playwright.
"""

import os
import re
import shlex
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from benchmarks import results
from softarm.common.revision import CHECKOUT
from tools import chromium

_SERVING = re.compile(r"serving (http://\S+)")
AIMS_S = {"a target clicked, and reached": 300.0, "an own policy flown": 600.0}


def typed(command: str, folder: Path, environment: dict[str, str] | None = None) -> str:
    """Run a command as a user would type it and return its output. Raises ClickException if it fails."""
    done = subprocess.run(command, shell=True, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise click.ClickException(f"{command}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}")
    return done.stdout


@contextmanager
def daemon(folder: Path, environment: dict[str, str], command: str = "softarm run --simulated") -> Iterator[str]:
    """Run the daemon on a free port while the context lasts and yield its URL."""
    ports = folder / "ports.yaml"
    ports.write_text("api: {port: 0, stop_port: 0}\n", encoding="utf-8")
    program = [*shlex.split(command), "--config", str(ports)]
    with subprocess.Popen(program, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True) as running:
        try:
            assert running.stdout is not None
            found = next((found for line in running.stdout if (found := _SERVING.search(line))), None)
            if found is None:
                raise click.ClickException("the daemon ended before it served; see its message above")
            yield found[1]
        finally:
            running.send_signal(signal.SIGINT)


def click_a_target(url: str, seen: str) -> None:
    """Arm in the dashboard at `url`, click into the drawing and wait until the text about the goal matches `seen`."""
    from playwright.sync_api import expect

    with chromium.opened() as browser:
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        page.goto(url)
        expect(page.locator("#do-arm")).to_be_enabled(timeout=30_000)
        expect(page.locator("#reasons .reason")).to_have_count(0, timeout=30_000)  # reasons against arming
        page.locator("#do-arm").click()
        expect(page.locator("#mode")).to_have_attribute("data-mode", "armed", timeout=15_000)
        box = page.locator("#drawing").bounding_box()
        assert box is not None
        page.mouse.click(box["x"] + 0.36 * box["width"], box["y"] + 0.55 * box["height"])
        expect(page.locator("#goal")).to_contain_text(re.compile(seen), timeout=20_000)


def first_use(clone: Path) -> Iterator[str]:
    """Run every step and yield its name at its end."""
    typed(f"git clone --quiet {CHECKOUT} {clone}", clone.parent)
    yield "cloned"
    mine = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")
    bare = {key: value for key, value in os.environ.items() if key not in mine}
    typed("make demo", clone, bare)
    yield "make demo: set up, ten targets"
    environment = {**bare, "VIRTUAL_ENV": str(clone / ".venv"), "PATH": f"{clone / '.venv/bin'}:{bare['PATH']}"}
    with daemon(clone, environment) as url:
        yield "softarm run --simulated"
        click_a_target(url, "reached ✓")
        yield "a target clicked, and reached"
    typed("softarm new policy my-swing", clone, environment)
    typed("pip install --editable softarm-my-swing", clone, environment)
    yield "softarm new policy, installed"
    with daemon(clone, environment) as url:
        typed("softarm policy use my-swing", clone, {**environment, "SOFTARM_URL": url})
        click_a_target(url, "reached ✓|Not reached")  # the first policy is a simple one
        yield "an own policy flown"


@click.command()
@results.json_option
def main(json_file: Path | None) -> None:
    """Run all steps and print their times.

    \b
    Example:
      python -m tools.first_use --json first-use.json
    """
    steps = []
    with tempfile.TemporaryDirectory() as folder:
        begun_s = time.monotonic()
        for step in first_use(Path(folder) / "softarm"):
            after_s = time.monotonic() - begun_s
            click.echo(f"{after_s:6.1f} s  {step}")
            steps.append({"step": step, "after_s": round(after_s, 1), "aim_s": AIMS_S.get(step)})
    results.report("first-use", {"steps": steps}, json_file)


if __name__ == "__main__":
    main()
