"""Tests of opening a page in the browser."""

import os
import threading

import pytest

from softarm.cli.operate.run import open_page

URL = "http://127.0.0.1:8080"


@pytest.fixture(autouse=True)
def _no_desktop(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)


# Notes the address, its terminal and its scheduling.
BROWSER = """#!/bin/sh
echo "$1 $(readlink /proc/self/fd/0) $(cut -d' ' -f41 /proc/$$/stat)" > "$0.seen"
"""


def test_the_browser_gets_the_address_no_terminal_and_ordinary_scheduling(tmp_path, monkeypatch, capfd):
    browser = tmp_path / "browser"
    browser.write_text(BROWSER)
    browser.chmod(0o755)
    monkeypatch.setenv("BROWSER", str(browser))

    def daemon():
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
        open_page(URL).join()

    thread = threading.Thread(target=daemon)
    thread.start()
    thread.join()
    assert (tmp_path / "browser.seen").read_text() == f"{URL} /dev/null {os.SCHED_OTHER}\n"
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("environment", [{}, {"BROWSER": "/no/such/browser", "PATH": ""}])
def test_without_a_browser_the_address_is_printed(monkeypatch, capfd, environment):
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    open_page(URL).join()
    assert capfd.readouterr() == ("", f"no browser here: open {URL} in one\n")
