"""`softarm view`: one page, where it was asked for, and the layout."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from softarm.cli.main import main

FLIGHT = Path(__file__).parents[1] / "data" / "flight.mcap"


@pytest.fixture
def browser(monkeypatch):
    """What a browser was asked to open."""
    asked = []
    monkeypatch.setattr("webbrowser.open", lambda url: asked.append(url) or True)
    return asked


def view(*arguments):
    return CliRunner().invoke(main, ["view", *map(str, arguments)])


def test_a_page_is_written_and_opened(browser, tmp_path):
    result = view("--out", tmp_path / "swing.html", FLIGHT)
    assert (result.exit_code, result.stdout) == (0, f"wrote {tmp_path}/swing.html\n")
    assert browser == [(tmp_path / "swing.html").as_uri()]
    assert (tmp_path / "swing.html").read_text().startswith("<!doctype html>")


def test_unopened_it_lies_in_this_folder(browser, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert view("--no-open", FLIGHT).stdout == "wrote flight.html\n"
    assert (tmp_path / "flight.html").stat().st_size < 100_000
    assert browser == []


def test_where_there_is_no_browser_it_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr("webbrowser.open", lambda url: False)
    result = view("--out", tmp_path / "a.html", FLIGHT)
    assert result.exit_code == 0
    assert f"no browser here: open {tmp_path}/a.html in one" in result.stderr


def test_the_layout_alone_and_nothing_at_all(tmp_path):
    assert view("--layout", tmp_path / "layout.json").stdout == f"wrote {tmp_path}/layout.json\n"
    assert "3D!softarm" in json.loads((tmp_path / "layout.json").read_text())["configById"]
    result = view()
    assert result.exit_code == 2
    assert "which log? `softarm logs` lists them" in result.stderr


def test_what_is_no_log_is_told(tmp_path):
    rubbish = tmp_path / "a.mcap"
    rubbish.write_text("nothing")
    result = view("--no-open", rubbish)
    assert (result.exit_code, result.stderr) == (
        1,
        f"{rubbish}: not a log; a log is an MCAP file, as the recorder writes it\n",
    )
