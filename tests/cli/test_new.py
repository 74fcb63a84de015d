"""`softarm new`: what it writes is sound code of the house's kind, is found by its name, and flies."""

import os
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path

import pytest
from click.testing import CliRunner

from softarm.cli import templates
from softarm.cli.main import main

ROOT = Path(__file__).parents[2]
KINDS = {"policy": "lean-over", "task": "gentle", "source": "my-cameras"}


def new(*arguments: str | Path):
    return CliRunner().invoke(main, ["new", *map(str, arguments)])


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One package of each kind, installed as pip would: its module and its entry points on the path."""
    packages = {}
    for kind, name in KINDS.items():
        packages[kind] = folder = tmp_path_factory.mktemp("new") / kind
        result = new(kind, name, "--out", folder)
        assert result.exit_code == 0, result.output
        project = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
        info = folder / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: 0.1.0\n")
        points = [
            f"[{group}]\n" + "".join(f"{point} = {target}\n" for point, target in entries.items())
            for group, entries in project["entry-points"].items()
        ]
        (info / "entry_points.txt").write_text("".join(points))
    return packages


def run(folder: Path, *command: str, others: Sequence[Path] = ()) -> None:
    path = os.pathsep.join(map(str, (folder, *others, ROOT)))
    done = subprocess.run(
        [sys.executable, "-m", *command],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=170,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
def test_their_own_tests_pass_among_them_those_that_fly_them(written: dict[str, Path]) -> None:
    """All in one process: what they import is the same."""
    folder, *others = written.values()
    ours = [str(each / "tests") for each in written.values()]
    run(folder, "pytest", "-q", "-p", "no:cacheprovider", "--rootdir", str(folder), *ours, others=others)


@pytest.mark.parametrize("kind", KINDS)
def test_it_keeps_to_its_own_rules_of_style(kind: str, written: dict[str, Path]) -> None:
    run(written[kind], "ruff", "check", "--no-cache", ".")
    run(written[kind], "ruff", "format", "--no-cache", "--check", ".")


@pytest.mark.slow
def test_its_types_are_strict(written: dict[str, Path], tmp_path: Path) -> None:
    """All three at once, as one file of settings says it for each."""
    files = [str(file) for folder in written.values() for file in (*folder.glob("*.py"), *folder.glob("tests/*.py"))]
    assert len(files) == 6
    path = os.pathsep.join(map(str, (*written.values(), ROOT)))
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--config-file", ROOT / "pyproject.toml", *files],
        cwd=ROOT,
        env=os.environ | {"MYPYPATH": path},
        capture_output=True,
        text=True,
        timeout=170,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_it_says_what_it_wrote_and_what_comes_next(tmp_path: Path) -> None:
    result = new("policy", "lean", "--out", tmp_path / "lean")
    assert result.exit_code == 0
    lines = result.stdout.splitlines()
    wrote, following = lines[: lines.index("next:")], lines[lines.index("next:") + 1 :]
    files = sorted(path for path in (tmp_path / "lean").rglob("*") if path.is_file())
    assert sorted(wrote) == [f"wrote {file}" for file in files]
    assert [line.strip() for line in following] == [
        f"pip install --editable {tmp_path / 'lean'}",
        f"pytest {tmp_path / 'lean'}",
        "softarm evaluate --policy lean",
    ]


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.md").write_text("mine")
    result = new("policy", "lean", "--out", tmp_path / "mine")
    assert result.exit_code == 1
    assert "mine: is there already, and nothing is overwritten; give another --out" in result.stderr
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["thesis.md"]
    assert new("policy", "lean", "--out", tmp_path / "mine" / "thesis.md").exit_code == 2


@pytest.mark.parametrize(
    ("kind", "name", "text"),
    [
        ("policy", "Lean", "'Lean' cannot name a policy; allowed are small letters, digits and single hyphens"),
        ("policy", "2lean", "allowed are small letters"),
        ("policy", "le--an", "allowed are small letters"),
        ("policy", "../lean", "allowed are small letters"),
        ("policy", "l" * 41, "40 at most"),
        ("policy", "lambda", "'lambda' is a word of Python's; choose another, such as my-lambda"),
        ("policy", "reach-wide", "there is a policy 'reach-wide' already"),
        ("source", "zenoh", "there is a source 'zenoh' already"),
        ("task", "shelf", "there is a task 'shelf' already"),
    ],
)
def test_a_name_that_cannot_be_is_refused(kind: str, name: str, text: str, tmp_path: Path) -> None:
    result = new(kind, name, "--out", tmp_path / "out")
    assert result.exit_code == 1
    assert text in result.stderr
    assert not (tmp_path / "out").exists()


def test_a_module_of_that_name_is_not_hidden(install, tmp_path: Path) -> None:
    install("softarm_lean", "")
    result = new("policy", "lean", "--out", tmp_path / "out")
    assert result.exit_code == 1
    assert "a module softarm_lean is installed already; choose another name" in result.stderr


def test_every_kind_has_its_files() -> None:
    folder = Path(templates.__file__).parent
    for kind in templates.KINDS:
        assert {path.name for path in (folder / kind).iterdir()} == {
            "README.md.in",
            "module.py.in",
            "pyproject.toml.in",
            "test.py.in",
        }
