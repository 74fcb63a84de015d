"""Debian's Chromium without a window, for tests and pictures of the project's pages."""

import contextlib
import io
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Locator, Page

BYTES_MAX, COLOURS = 150_000, 256  # limits of a picture for the pages
# The shell comes first: it shows the same pages for two thirds of the processor time.
NAMES = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
MISSING = "there is no chromium here: apt-get install chromium-headless-shell, or chromium"


def found() -> str | None:
    """Return the path of Chromium, or None if it is not installed."""
    return next(filter(None, map(shutil.which, NAMES)), None)


@contextlib.contextmanager
def opened() -> "Iterator[Browser]":
    """Run Chromium while the context lasts. Raises ClickException if it is not installed."""
    from playwright.sync_api import sync_playwright

    if (path := found()) is None:
        raise click.ClickException(MISSING)
    with sync_playwright() as playwright:
        # Chromium refuses to build its sandbox as root.
        rights = ["--no-sandbox"] if os.geteuid() == 0 else []
        browser = playwright.chromium.launch(executable_path=path, args=rights)
        try:
            yield browser
        finally:
            browser.close()


def keep(page: "Page | Locator", path: Path) -> None:
    """Write a screenshot of a page, or of a part, as PNG and print its size. Raises ClickException above BYTES_MAX."""
    from PIL import Image

    picture = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
    picture.quantize(COLOURS, kmeans=1, dither=Image.Dither.NONE).save(path, optimize=True)
    size = path.stat().st_size
    click.echo(f"{path}: {size / 1000:.0f} kB")
    if size > BYTES_MAX:
        raise click.ClickException(f"{path} has {size} bytes; allowed {BYTES_MAX}: show less on it")
