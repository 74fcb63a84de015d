import subprocess
import sys

import pytest

import softarm
from softarm.common import revision

UNKNOWN = f"unknown, softarm {softarm.__version__}"


def git(folder, *arguments):
    identity = ("-c", "user.name=A", "-c", "user.email=a@example.org", "-c", "commit.gpgsign=false")
    done = subprocess.run(["git", *identity, *arguments], cwd=folder, capture_output=True, text=True, check=True)
    return done.stdout.strip()


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """A repository with one commit, under a tag; git sees nobody's settings."""
    monkeypatch.setenv("GIT_CONFIG_GLOBAL", "/dev/null")
    folder = tmp_path / "checkout"
    (folder / "softarm").mkdir(parents=True)
    (folder / "softarm" / "file").write_text("once\n")
    git(folder, "init", "--quiet")
    git(folder, "add", ".")
    git(folder, "commit", "--quiet", "--message", "All")
    git(folder, "tag", "v1")
    return folder


def test_a_checkout_is_named_by_its_commit_and_says_when_it_was_edited(checkout):
    commit = git(checkout, "rev-parse", "HEAD")
    assert len(commit) == 40
    assert revision.revision(checkout) == commit
    (checkout / "softarm" / "file").write_text("twice\n")
    assert revision.revision(checkout) == f"{commit}+changes"


def test_a_users_checkout_does_not_give_its_commit_to_softarm(checkout):
    assert revision.revision(checkout / "softarm") == UNKNOWN


def test_a_hook_of_another_repository_changes_nothing(checkout, monkeypatch, tmp_path):
    commit = git(checkout, "rev-parse", "HEAD")
    monkeypatch.setenv("GIT_DIR", str(tmp_path / "other"))
    assert revision.revision(checkout) == commit


def test_without_git_the_version_is_what_is_known(checkout, monkeypatch):
    monkeypatch.setenv("PATH", str(checkout))
    assert revision.revision(checkout) == UNKNOWN


def test_software_lists_softarm_python_and_the_requested_packages():
    described = revision.software(("numpy", "no-such-package"))
    assert described["softarm"] == softarm.__version__
    assert described["python"] == sys.version.split()[0]
    assert described["numpy"].startswith("2.")
    assert described["no-such-package"] == "not installed"


def test_the_version_of_the_code_changes_with_the_code_that_counts(tmp_path, monkeypatch):
    monkeypatch.setattr(revision, "PACKAGE", tmp_path)
    found = set()
    for place in ("one/a.py", "other/b.js", "one/notes.md"):
        file = tmp_path / place
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("text")
        revision.code_version.cache_clear()
        found.add((revision.code_version(), revision.code_version("one")))
    revision.code_version.cache_clear()
    assert len({whole for whole, _ in found}) == 2
    assert len({part for _, part in found}) == 1
