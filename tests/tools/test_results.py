"""Tables on the pages: generated from stored results with their origin."""

import re
import subprocess

import pytest
from click.testing import CliRunner

from benchmarks import results, tables
from tools import render

PAGES = sorted(render.DOCS.rglob("*.md"))
STORED = sorted(file.stem for file in results.FOLDER.glob("*.json"))
ABOUT = {"revision", "machine", "date", "command"}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_no_table_is_stale(page):
    text = page.read_text(encoding="utf-8")
    assert render.rendered(text) == text, "run python -m tools.render"


def test_every_table_is_on_one_page_and_every_result_in_a_table():
    marked = [name for page in PAGES for name in re.findall(r"<!-- results: (.*?) -->", page.read_text("utf-8"))]
    assert sorted(marked) == sorted(tables.TABLES)
    asked = {"detection"}  # docs/hooks.py shows it on the site
    for table in tables.TABLES.values():
        table(lambda name: asked.add(name) or results.read(name))
    assert sorted(asked) == STORED


@pytest.mark.parametrize("name", STORED)
def test_a_result_states_its_origin(name):
    about = results.read(name)["about"]
    assert about.keys() >= ABOUT
    assert all((results.CHECKOUT / path).exists() for path in results.depends_on(name)), "a path was renamed"
    assert re.fullmatch(r"[0-9a-f]{40}", about["revision"]), "measure at a commit, with nothing changed since"
    assert about.get("transcribed", True) is True


@pytest.fixture
def git(tmp_path):
    """Return git(words) in a new repository whose four commits each changed one of two files."""

    def run(*words):
        who = ("-c", "user.name=a", "-c", "user.email=a@example.org")
        return subprocess.run(["git", *who, *words], cwd=tmp_path, check=True, capture_output=True, text=True).stdout

    run("init", "-q")
    (tmp_path / "README.md").write_text("page")
    for number, name in enumerate(("code.py", "other.py", "code.py", "code.py")):
        (tmp_path / name).write_text(str(number))
        run("add", ".")
        run("commit", "-qm", name)
    return run


def test_an_edited_page_is_no_change_of_the_measured_code_but_an_edited_module_is(tmp_path, git):
    head = git("rev-parse", "HEAD").strip()
    (tmp_path / "README.md").write_text("another page")
    assert results.measured(tmp_path) == head
    (tmp_path / "code.py").write_text("edited")
    assert results.measured(tmp_path) == f"{head}+changes"


def test_a_result_counts_the_commits_that_changed_its_code_since(tmp_path, git):
    first = git("rev-list", "--max-parents=0", "HEAD").strip()
    assert results.age(first, ["code.py"], tmp_path) == 2
    assert results.age(first, ["other.py"], tmp_path) == 1
    assert results.age("HEAD", ["code.py", "other.py"], tmp_path) == 0


def test_a_revision_that_a_shallow_clone_lacks_is_stated(monkeypatch):
    about = {"revision": "0" * 40, "date": "2026-01-01", "command": ""}
    monkeypatch.setattr(results, "read", lambda name: {"about": about})
    done = CliRunner().invoke(results.main)
    assert done.exit_code == 1
    assert "run `git fetch --unshallow`" in done.output


def test_comments_docstrings_and_layout_are_no_change_of_the_code_but_a_value_is(tmp_path, git):
    def commit(text):
        (tmp_path / "code.py").write_text(text)
        git("add", ".")
        git("commit", "-qm", "code")
        return git("rev-parse", "HEAD").strip()

    first = commit('"""Double."""\n\n\ndef double(x):\n    """Return 2 x."""\n    return 2 * x\n')
    commit("def double(x):  # by two\n    return (2 * x)\n")
    assert results.age(first, ["code.py"], tmp_path) == 0
    commit("def double(x):\n    return 3 * x\n")
    assert results.age(first, ["code.py"], tmp_path) == 2


def test_an_added_or_a_removed_file_is_a_change_of_the_code(tmp_path, git):
    before = git("rev-parse", "HEAD").strip()
    (tmp_path / "new.py").write_text("")
    git("add", ".")
    git("commit", "-qm", "add")
    added = git("rev-parse", "HEAD").strip()
    git("rm", "-q", "new.py")
    git("commit", "-qm", "remove")
    assert results.age(before, ["new.py"], tmp_path) == 0
    assert results.age(added, ["new.py"], tmp_path) == 1
