"""The pages say what was measured: tables are made from stored results, each with where it comes from."""

import json
import re
import subprocess
import sys

import pytest
from click.testing import CliRunner

from softarm.benchmarks import keep, results, tables

PAGES = sorted(results.DOCS.glob("*.md"))
STORED = sorted(file.stem for file in results.FOLDER.glob("*.json"))
ABOUT = {"revision", "machine", "date", "command"}
FIGURE = {"mean": 0.25, "spread": None, "refused": 0}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_no_table_is_stale(page):
    text = page.read_text(encoding="utf-8")
    assert results.rendered(text) == text, "run python -m softarm.benchmarks.results"


def test_every_table_stands_on_one_page_and_every_result_in_a_table():
    marked = [name for page in PAGES for name in re.findall(r"<!-- results: (.*?) -->", page.read_text("utf-8"))]
    assert sorted(marked) == sorted(tables.TABLES)
    asked = set()
    for table in tables.TABLES.values():
        table(lambda name: asked.add(name) or results.read(name))
    assert sorted(asked) == STORED


@pytest.mark.parametrize("name", STORED)
def test_a_result_says_where_it_comes_from(name):
    about = results.read(name)["about"]
    assert about.keys() - {"transcribed"} == ABOUT
    assert re.fullmatch(r"[0-9a-f]{40}", about["revision"]), "measure at a commit, with nothing changed since"
    assert about.get("transcribed", True) is True


def test_a_page_with_another_figure_is_stale_and_is_mended(tmp_path, monkeypatch):
    name = "results.md"
    sound = (results.DOCS / name).read_text(encoding="utf-8")
    page = tmp_path / name
    page.write_text(sound.replace("| 9.8 M |", "| 98 M |"), encoding="utf-8")
    monkeypatch.setattr(results, "DOCS", tmp_path)
    run = CliRunner().invoke(results.main, ["--check"])
    assert run.exit_code == 1
    assert "results.md: stale" in run.output
    assert CliRunner().invoke(results.main, []).exit_code == 0
    assert page.read_text(encoding="utf-8") == sound
    assert CliRunner().invoke(results.main, ["--check"]).exit_code == 0


def test_a_table_that_there_is_none_of_is_no_silence():
    with pytest.raises(KeyError):
        results.rendered("<!-- results: nonsense -->\n<!-- /results -->\n")


@pytest.mark.parametrize(
    ("figure", "text"),
    [
        (None, ""),
        (FIGURE, "25.0"),
        (FIGURE | {"mean": 0.0}, "0"),
        (FIGURE | {"spread": 0.013}, "25.0 +- 1.3"),
        (FIGURE | {"mean": 0.0, "spread": 0.0}, "0.0 +- 0.0"),
        (FIGURE | {"refused": 145 / 162}, "25.0 (refused 145 of 162)"),
        (FIGURE | {"refused": 1}, "-"),
    ],
)
def test_a_figure_is_told_with_its_spread_and_what_was_refused(figure, text):
    assert tables.cell(figure, trials=162) == text


def test_a_row_that_does_not_fit_its_head_is_refused():
    assert tables.markdown(("a", "b"), [["1", ""]]) == "| a | b |\n|---|---|\n| 1 | |\n"
    with pytest.raises(ValueError, match="1 cells in a table of 2 columns"):
        tables.markdown(("a", "b"), [["1"]])


WRITES = """
import json, sys
place = sys.argv[sys.argv.index("--json") + 1]
json.dump({"speed": 2.5, "long": [1, 2], "about": "its own"}, open(place, "w"))
sys.exit(int(sys.argv[1]))
"""


def test_what_a_command_wrote_is_kept_with_the_command(tmp_path, monkeypatch):
    monkeypatch.setattr(results, "FOLDER", tmp_path)
    script = tmp_path / "measure.py"
    script.write_text(WRITES)
    run = CliRunner().invoke(keep.main, ["--without", "long", "mine", "--", sys.executable, str(script), "0"])
    assert run.exit_code == 0, run.output
    found = json.loads((tmp_path / "mine.json").read_text())
    assert found.keys() == {"about", "speed"}
    assert found["speed"] == 2.5
    assert found["about"].keys() == ABOUT
    assert found["about"]["command"].endswith("measure.py 0")


def test_of_a_command_that_failed_nothing_is_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(results, "FOLDER", tmp_path)
    script = tmp_path / "measure.py"
    script.write_text(WRITES)
    run = CliRunner().invoke(keep.main, ["mine", "--", sys.executable, str(script), "3"])
    assert run.exit_code == 1
    assert "ended with 3; nothing was kept" in run.output
    assert not (tmp_path / "mine.json").exists()


def test_results_and_pages_that_changed_since_do_not_change_the_revision(tmp_path):
    def git(*words):
        who = ("-c", "user.name=a", "-c", "user.email=a@example.org")
        return subprocess.run(["git", *who, *words], cwd=tmp_path, check=True, capture_output=True, text=True).stdout

    result, code = tmp_path / "benchmarks" / "results" / "loop.json", tmp_path / "benchmarks" / "loop.py"
    result.parent.mkdir(parents=True)
    result.write_text("1")
    code.write_text("1")
    git("init", "-q")
    git("add", ".")
    git("commit", "-qm", "all")
    commit = git("rev-parse", "HEAD").strip()
    result.write_text("2")
    assert results.measured(tmp_path) == commit
    code.write_text("2")
    assert results.measured(tmp_path) == f"{commit}+changes"
