"""Tests of `softarm logs view`."""

import json
from pathlib import Path

import pytest

from tests.cli.invoke import invoke

FLIGHT = Path(__file__).parents[2] / "data" / "flight.mcap"


@pytest.fixture
def browser(monkeypatch):
    """Return the list of addresses that a browser has to open."""
    asked = []
    monkeypatch.setattr("webbrowser.open", lambda url: asked.append(url) or True)
    return asked


def view(*arguments):
    return invoke("logs", "view", *arguments)


def test_a_page_is_written_and_opened(browser, tmp_path):
    result = view("--out", tmp_path / "swing.html", FLIGHT)
    assert (result.exit_code, result.stdout) == (0, f"wrote {tmp_path}/swing.html\n")
    assert browser == [(tmp_path / "swing.html").as_uri()]
    assert (tmp_path / "swing.html").read_text().startswith("<!doctype html>")


def test_without_opening_the_page_is_written_to_this_folder(browser, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert view("--no-open", FLIGHT).stdout == "wrote flight.html\n"
    assert (tmp_path / "flight.html").stat().st_size < 200_000  # chart library included
    assert browser == []


def test_a_missing_browser_is_reported(tmp_path, monkeypatch):
    monkeypatch.setattr("webbrowser.open", lambda url: False)
    result = view("--out", tmp_path / "a.html", FLIGHT)
    assert result.exit_code == 0
    assert f"no browser here: open {tmp_path}/a.html in one" in result.stderr


def test_view_writes_the_layout(tmp_path):
    assert view("--layout", tmp_path / "layout.json").stdout == f"wrote {tmp_path}/layout.json\n"
    assert "3D!softarm" in json.loads((tmp_path / "layout.json").read_text())["configById"]
