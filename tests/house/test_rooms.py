"""The house: rooms at the top level, one import name."""

import subprocess
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
COMES_ALONG = {"softarm.yaml", "twin.yaml", "systemd", "docs"}  # no code, and installed with it


def rooms() -> set[str]:
    """Folders of the top level that are packages."""
    found = (path.parent for path in ROOT.glob("*/__init__.py"))
    return {path.name for path in found if path.name != "softarm"}


def test_softarm_links_to_every_room_to_what_comes_along_and_to_nothing_else():
    links = {path.name: path.readlink() for path in (ROOT / "softarm").iterdir() if path.is_symlink()}
    assert links == {name: Path("..") / name for name in rooms() | COMES_ALONG}


def test_git_holds_the_links_as_links():
    listed = subprocess.run(["git", "ls-files", "-s", "softarm"], cwd=ROOT, capture_output=True, text=True, check=True)
    modes = {line.split("\t")[1]: line.split()[0] for line in listed.stdout.splitlines()}
    assert {path for path, mode in modes.items() if mode == "120000"} == {
        f"softarm/{name}" for name in rooms() | COMES_ALONG
    }


def test_a_bare_import_of_a_room_is_forbidden_for_each():
    banned = PROJECT["tool"]["ruff"]["lint"]["flake8-tidy-imports"]["banned-api"]
    assert banned.keys() == rooms()


def test_every_folder_with_code_is_a_package_and_holds_fewer_than_500_lines_a_file():
    for room in rooms():
        for file in (ROOT / room).rglob("*.py"):
            assert (file.parent / "__init__.py").is_file(), file
            assert len(file.read_text(encoding="utf-8").splitlines()) < 500, file


def test_the_floors_name_every_room_once():
    floors = next(c for c in PROJECT["tool"]["importlinter"]["contracts"] if c["type"] == "layers")["layers"]
    named = [room.strip() for floor in floors for room in floor.split("|")]
    assert sorted(named) == sorted(rooms())
