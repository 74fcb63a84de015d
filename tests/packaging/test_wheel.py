"""The built wheel adds only `softarm` to an environment and works there."""

import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import textwrap
import zipfile
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
DEPENDENCIES = sysconfig.get_path("purelib")

EXAMPLES = sorted(path.parent for path in (ROOT / "examples").glob("*/pyproject.toml"))

# A project of a user with package names that softarm once had, and a policy as in docs/policies/interface.md.
PROJECT = {
    "pyproject.toml": """
        [build-system]
        requires = ["setuptools"]
        build-backend = "setuptools.build_meta"
        [project]
        name = "their-arm"
        version = "1.0"
        [project.entry-points."softarm.policies"]
        left = "policies.left:Left"
        [tool.setuptools]
        packages = ["policies", "training"]
        py-modules = ["cli"]
    """,
    "policies/__init__.py": "",
    "policies/base.py": "THEIRS = True",
    "policies/left.py": """
        import numpy as np
        from policies.base import THEIRS
        from softarm.policies.base import PolicySpec

        class Left:
            spec = PolicySpec("left", "to the left, always")

            def reset(self):
                assert THEIRS

            def step(self, observation, goal):
                return np.array([-1.0, 0.0], np.float32)
    """,
    "training/__init__.py": "THEIRS = True",
    "cli.py": "raise SystemExit('their own cli was run')",
}


def run(*command: str | Path, cwd: Path, seconds: float = 170.0) -> str:
    """Run a command without this checkout on its path, and return its output."""
    clean = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "PYTHONHOME")}
    done = subprocess.run(
        list(map(str, command)), cwd=cwd, env=clean, capture_output=True, text=True, timeout=seconds, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


# `python -m build` without its processes: the sdist of this folder, then the wheel of the sdist.
BUILD = """
import os, sys, tarfile
from setuptools import build_meta
out = sys.argv[1]
sdist = build_meta.build_sdist(out)
with tarfile.open(f"{out}/{sdist}") as packed:
    packed.extractall("unpacked", filter="data")
os.chdir(os.path.join("unpacked", sdist.removesuffix(".tar.gz")))
build_meta.build_wheel(out, {"--build-option": "--compression=stored"})
"""


# Over 3 s: builds the sdist and the wheel, once for all tests.
@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the sdist and the wheel from the files that git lists, and return their folder."""
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("dist")
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()
    for name in listed:
        if (ROOT / name).exists():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, source / name, follow_symlinks=False)
    run(sys.executable, "-c", BUILD, out, cwd=source)
    return out


def install(python: Path, *packages: Path) -> None:
    pip = (sys.executable, "-m", "pip", "--quiet", "--python", python, "install", "--no-deps", "--no-compile")
    run(*pip, "--no-build-isolation", *packages, cwd=python.parent)


# Over 3 s: makes an environment and installs the wheel, once for all tests.
@pytest.fixture(scope="module")
def installed(built: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install softarm into a new environment, and return its Python.

    A .pth file gives it the dependencies of this environment without the editable install.
    """
    home = tmp_path_factory.mktemp("home")
    run(sys.executable, "-m", "venv", "--without-pip", home / "env", cwd=home)
    python = home / "env" / "bin" / "python"
    site = Path(run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=home).strip())
    (site / "dependencies.pth").write_text(DEPENDENCIES + "\n")
    install(python, next(built.glob("*.whl")))
    return python


@pytest.fixture(scope="module")
def extended(installed: Path) -> Path:
    """Install the user's project and the examples beside softarm, and return the folder of the project."""
    home = installed.parents[2]
    for name, text in PROJECT.items():
        (home / "their-arm" / name).parent.mkdir(parents=True, exist_ok=True)
        (home / "their-arm" / name).write_text(textwrap.dedent(text))
    for example in EXAMPLES:
        shutil.copytree(example, home / "examples" / example.name)
    install(installed, home / "their-arm", *(home / "examples").iterdir())
    return home / "their-arm"


def test_the_sdist_contains_softarm_only(built: Path) -> None:
    with tarfile.open(next(built.glob("*.tar.gz"))) as sdist:
        assert not [member.name for member in sdist if member.issym() or member.islnk()]
        tops = {name.split("/")[1] for name in sdist.getnames() if "/" in name}
    assert {top for top in tops if "." not in top} == {"softarm", "LICENSE", "PKG-INFO"}


def test_the_wheel_contains_softarm_with_all_data_files_and_nothing_else(built: Path) -> None:
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    linked = {path.name for path in (ROOT / "softarm").iterdir() if path.is_symlink()}
    wanted = {f"softarm/{name}" for name in listed if name.split("/")[0] in linked}
    wanted |= {name for name in listed if name.startswith("softarm/") and not (ROOT / name).is_symlink()}
    pages = (".md", ".png", ".csv")
    wanted -= {name for name in wanted if name.startswith("softarm/docs/") and not name.endswith(pages)}
    assert {"softarm/softarm.yaml", "softarm/twin.yaml", "softarm/systemd/softarmd.service"} < wanted
    with zipfile.ZipFile(next(built.glob("*.whl"))) as wheel:
        held = {name for name in wheel.namelist() if not name.split("/")[0].endswith(".dist-info")}
    assert held == wanted


@pytest.mark.prove
def test_packages_of_the_user_and_of_softarm_are_importable_together(installed: Path, extended: Path) -> None:
    said = run(
        installed,
        "-c",
        "import policies.base, training, softarm.policies.base, softarm.training.gym_envs;"
        "import gymnasium;"
        "print(policies.base.THEIRS, training.THEIRS, softarm.__file__);"
        "print(gymnasium.spec('SoftArmReach-v0').id)",
        cwd=extended,
    )
    site = next(installed.parents[1].glob("lib/python*/site-packages"))
    assert said.splitlines() == [f"True True {site}/softarm/__init__.py", "SoftArmReach-v0"]


@pytest.mark.prove
def test_the_wheel_alone_creates_a_configuration_and_a_service(installed: Path, tmp_path: Path) -> None:
    softarm = installed.with_name("softarm")
    run(softarm, "config", "new", cwd=tmp_path)
    assert "softarm.yaml: valid" in run(softarm, "check", "softarm.yaml", cwd=tmp_path)
    run(softarm, "service", "install", "--root", tmp_path / "root", "--config", "softarm.yaml", cwd=tmp_path)
    unit = (tmp_path / "root/etc/systemd/system/softarmd.service").read_text()
    assert f"ExecStart={softarm} run --config /etc/softarm/softarm.yaml" in unit.splitlines()
    page = unit.partition("Documentation=file://")[2].splitlines()[0]
    assert Path(page).is_relative_to(installed.parents[1])
    assert Path(page).is_file()


@pytest.mark.prove
@pytest.mark.timeout(400)
def test_the_demo_runs_from_an_empty_folder(installed: Path, tmp_path: Path) -> None:
    said = run(installed.with_name("softarm"), "demo", "--targets", "1", cwd=tmp_path, seconds=390)
    assert "no limit exceeded" in said
    assert list((tmp_path / "logs").glob("*.mcap"))


@pytest.mark.prove
@pytest.mark.timeout(400)
def test_the_users_plugin_a_shipped_policy_and_the_examples_fly(installed: Path, extended: Path) -> None:
    softarm = installed.with_name("softarm")
    assert "left: 54 targets" in run(softarm, "evaluate", "left", cwd=extended, seconds=390)
    flown = run(softarm, "evaluate", "reach", cwd=extended)
    assert float(flown.partition("│ all         │")[2].partition("%")[0]) > 85.0
    examples = extended.parent / "examples"
    tests = [examples / example.name / "tests" for example in EXAMPLES]
    assert len(tests) == 2
    plain = ("-q", "-p", "no:cacheprovider", "--import-mode=importlib", "--rootdir", examples)
    assert " passed" in run(installed, "-m", "pytest", *plain, *tests, cwd=extended)
