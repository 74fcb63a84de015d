"""Opens a page in the browser of this desktop."""

import os
import subprocess
import sys
import threading

import click

_DESKTOP = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")
# A browser must not inherit the daemon's real-time priority.
_CODE = """
import os, sys
os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
import webbrowser
sys.exit(not webbrowser.open(sys.argv[1]))
"""


def open_page(url: str) -> threading.Thread:
    """Open an address in the browser, or print that there is none.

    Returns at once, with the thread that waits for the answer. The browser has no terminal, so none in text mode takes
    the daemon's.
    """
    thread = threading.Thread(target=_open, args=(url,), name="browser", daemon=True)
    thread.start()
    return thread


def _open(url: str) -> None:
    command, null = [sys.executable, "-c", _CODE, url], subprocess.DEVNULL
    if (
        not any(map(os.environ.get, _DESKTOP))
        or subprocess.run(command, stdin=null, stdout=null, stderr=null, start_new_session=True).returncode
    ):
        click.echo(f"no browser here: open {url} in one", err=True)
