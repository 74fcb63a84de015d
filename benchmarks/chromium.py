"""A real browser for what looks at our pages: Debian's Chromium, without a window."""

import contextlib
import os
import shutil
from collections.abc import Iterator
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from playwright.sync_api import Browser

NAMES = ("chromium", "chromium-browser", "google-chrome")


def found() -> str | None:
    """Where it is; None: there is none on this machine."""
    return next(filter(None, map(shutil.which, NAMES)), None)


@contextlib.contextmanager
def opened() -> "Iterator[Browser]":
    """A running one. Raises `click.ClickException` where there is none."""
    from playwright.sync_api import sync_playwright

    if (path := found()) is None:
        raise click.ClickException("there is no chromium here: apt-get install chromium")
    with sync_playwright() as playwright:
        # Chromium refuses to build its sandbox as root.
        rights = ["--no-sandbox"] if os.geteuid() == 0 else []
        browser = playwright.chromium.launch(executable_path=path, args=rights)
        try:
            yield browser
        finally:
            browser.close()
