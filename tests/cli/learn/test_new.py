"""Tests of `softarm new`: the written packages pass their checks and fly."""

import os
import subprocess
import sys
import tomllib
from collections.abc import Iterable
from pathlib import Path

import pytest

from tests.cli.invoke import refuse, succeed

ROOT = Path(__file__).parents[3]
KINDS = {"policy": "lean-over", "task": "gentle", "source": "my-cameras"}


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return one package of each kind, installed by a metadata folder as pip writes it."""
    packages = {}
    for kind, name in KINDS.items():
        packages[kind] = folder = tmp_path_factory.mktemp("new") / kind
        succeed("new", kind, name, "--out", folder)
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


def run(cwd: Path, *command: str, folders: Iterable[Path] = ()) -> None:
    """Run a module in a process that finds the packages in the folders and this checkout."""
    path = os.pathsep.join(map(str, (*folders, ROOT)))
    environment = os.environ | {"PYTHONPATH": path, "MYPYPATH": path}
    done = subprocess.run(
        [sys.executable, "-m", *command],
        cwd=cwd,
        env=environment,
        capture_output=True,
        text=True,
        timeout=170,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("chosen", ["not training", pytest.param("training", marks=pytest.mark.prove)])
def test_the_tests_of_new_packages_pass(written: dict[str, Path], chosen: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """They run in this process, which saves imports."""
    for folder in written.values():
        monkeypatch.syspath_prepend(str(folder))
    plugins = ("cacheprovider", "faulthandler", "schemathesis", "timeout", "xdist")
    plain = ("-q", "-s", "--import-mode=importlib", *(word for name in plugins for word in ("-p", f"no:{name}")))
    tests = (str(folder / "tests") for folder in written.values())
    assert pytest.main([*plain, "-k", chosen, "--rootdir", str(written["policy"]), *tests]) == 0


def test_new_packages_pass_their_style_checks(written: dict[str, Path]) -> None:
    folders = list(map(str, written.values()))
    run(ROOT, "ruff", "check", "--no-cache", *folders)
    run(ROOT, "ruff", "format", "--no-cache", "--check", *folders)


@pytest.mark.prove
def test_new_packages_pass_strict_type_checks(written: dict[str, Path]) -> None:
    """One run checks all three, which saves time."""
    files = [str(file) for folder in written.values() for file in (*folder.glob("*.py"), *folder.glob("tests/*.py"))]
    assert len(files) == 6
    run(ROOT, "mypy", "--strict", "--config-file", "pyproject.toml", *files, folders=written.values())


def test_the_written_files_and_the_next_commands_are_printed(tmp_path: Path) -> None:
    lines = succeed("new", "policy", "lean", "--out", tmp_path / "lean").stdout.splitlines()
    wrote, following = lines[: lines.index("next:")], lines[lines.index("next:") + 1 :]
    files = sorted(path for path in (tmp_path / "lean").rglob("*") if path.is_file())
    assert sorted(wrote) == [f"wrote {file}" for file in files]
    assert [line.strip() for line in following] == [
        f"pip install --editable {tmp_path / 'lean'}",
        f"pytest {tmp_path / 'lean'}",
        "softarm evaluate lean",
    ]


def test_a_name_of_an_installed_module_is_refused(install, tmp_path: Path) -> None:
    install("softarm_lean", "")
    message = "the module softarm_lean is already installed; choose another name"
    refuse(message, "new", "policy", "lean", "--out", tmp_path / "out")
