"""What is built and installed is one name in its user's environment, and works there."""

import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from importlib.metadata import distributions
from pathlib import Path

import pytest

from softarm import __version__ as softarm_version

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
DEPENDENCIES = sysconfig.get_path("purelib")

EXAMPLES = sorted(path.parent for path in (ROOT / "examples").glob("*/pyproject.toml"))

# A user's own project: names that were once ours too, and a policy that is published the way docs/policies.md says.
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
    """Output of a command that knows nothing of this checkout. Fails with what it printed."""
    clean = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "PYTHONHOME")}
    done = subprocess.run(
        list(map(str, command)), cwd=cwd, env=clean, capture_output=True, text=True, timeout=seconds, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the sdist and the wheel made from it, of the checkout's files as git knows them."""
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("dist")
    files = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"],
        cwd=ROOT,
        capture_output=True,
        check=True,
    ).stdout
    subprocess.run(
        ["tar", "--create", "--null", "--files-from=-", f"--file={out}/tree.tar", "--ignore-failed-read"],
        cwd=ROOT,
        input=files,
        check=True,
        capture_output=True,
    )
    with tarfile.open(out / "tree.tar") as tree:
        tree.extractall(source, filter="tar")
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", out, source, cwd=source)
    return out


@pytest.fixture(scope="module")
def installed(built: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A user's project, installed beside softarm into a new environment; returns the environment's Python.

    What softarm depends on is borrowed from this one by a path that does not carry the editable install along.
    """
    home = tmp_path_factory.mktemp("home")
    for name, text in PROJECT.items():
        lines = text.strip("\n").splitlines()
        margin = min((len(line) - len(line.lstrip()) for line in lines if line.strip()), default=0)
        (home / "their-arm" / name).parent.mkdir(parents=True, exist_ok=True)
        (home / "their-arm" / name).write_text("\n".join(line[margin:] for line in lines) + "\n")
    run(sys.executable, "-m", "venv", "--without-pip", home / "env", cwd=home)
    python = home / "env" / "bin" / "python"
    site = Path(run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=home).strip())
    (site / "dependencies.pth").write_text(DEPENDENCIES + "\n")
    pip = (sys.executable, "-m", "pip", "--quiet", "--python", python, "install", "--no-deps", "--no-build-isolation")
    for example in EXAMPLES:
        shutil.copytree(example, home / "examples" / example.name)
    run(*pip, next(built.glob("*.whl")), home / "their-arm", *(home / "examples").iterdir(), cwd=home)
    return python


def test_the_wheel_and_the_sdist_hold_softarm_alone(built: Path) -> None:
    with zipfile.ZipFile(next(built.glob("*.whl"))) as wheel:
        tops = {name.split("/")[0] for name in wheel.namelist()}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"softarm"}
    with tarfile.open(next(built.glob("*.tar.gz"))) as sdist:
        assert not [member.name for member in sdist if member.issym() or member.islnk()]
        tops = {name.split("/")[1] for name in sdist.getnames() if "/" in name}
    assert {top for top in tops if "." not in top} == {"softarm", "LICENSE", "PKG-INFO"}


def test_all_that_is_no_code_comes_along_and_nothing_that_is_for_a_checkout(built: Path) -> None:
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    linked = {path.name for path in (ROOT / "softarm").iterdir() if path.is_symlink()} - {"benchmarks"}
    wanted = {f"softarm/{name}" for name in tracked if name.split("/")[0] in linked}
    wanted -= {name for name in wanted if name.startswith("softarm/docs/") and not name.endswith(".md")}  # pictures
    assert {"softarm/softarm.yaml", "softarm/twin.yaml", "softarm/systemd/softarmd.service"} < wanted
    with zipfile.ZipFile(next(built.glob("*.whl"))) as wheel:
        held = {name for name in wheel.namelist() if name.startswith("softarm/")}
    assert held == wanted | {"softarm/__init__.py", "softarm/py.typed"}


def test_only_softarm_is_added_to_the_environment(installed: Path) -> None:
    site = next(installed.parents[1].glob("lib/python*/site-packages"))
    ours = [found for found in distributions(path=[str(site)]) if found.name == "softarm"]
    tops = {str(file).split("/")[0] for found in ours for file in found.files or ()}
    assert {top for top in tops if not top.endswith(".dist-info") and top != ".."} == {"softarm"}


def test_the_users_own_packages_and_ours_are_both_there(installed: Path, tmp_path: Path) -> None:
    said = run(
        installed,
        "-c",
        "import policies.base, training, softarm.policies.base, softarm.training.gym_envs;"
        "import gymnasium;"
        "print(policies.base.THEIRS, training.THEIRS, softarm.__file__);"
        "print(gymnasium.spec('SoftArmReach-v0').id)",
        cwd=installed.parents[2] / "their-arm",
    )
    site = next(installed.parents[1].glob("lib/python*/site-packages"))
    assert said.splitlines() == [f"True True {site}/softarm/__init__.py", "SoftArmReach-v0"]


def test_every_file_of_the_package_that_no_code_imports_is_found_by_it(installed: Path, tmp_path: Path) -> None:
    said = run(
        installed,
        "-c",
        "from softarm.common.revision import ROOT;"
        "from softarm.daemon.config.configuration import read;"
        "print(read(ROOT / 'softarm.yaml').config.api.port, read(ROOT / 'twin.yaml').config.drivers.rail.port);"
        "print((ROOT / 'systemd' / 'softarmd.service').is_file(), (ROOT / 'docs' / 'service.md').is_file())",
        cwd=tmp_path,
    )
    assert said.split() == ["8080", "15020", "True", "True"]


def test_a_configuration_and_a_service_are_made_from_the_wheel_alone(installed: Path, tmp_path: Path) -> None:
    softarm = installed.with_name("softarm")
    run(softarm, "config", "new", "--twin", cwd=tmp_path)
    run(softarm, "config", "new", cwd=tmp_path)
    assert "softarm.yaml: sound" in run(softarm, "check", "softarm.yaml", cwd=tmp_path)
    run(softarm, "service", "install", "--root", tmp_path / "root", "--config", "twin.yaml", cwd=tmp_path)
    unit = (tmp_path / "root/etc/systemd/system/softarmd.service").read_text()
    assert f"ExecStart={softarm} run --config /etc/softarm/softarm.yaml" in unit.splitlines()
    page = unit.partition("Documentation=file://")[2].splitlines()[0]
    assert Path(page).is_relative_to(installed.parents[1])
    assert Path(page).is_file()


@pytest.mark.realtime
@pytest.mark.timeout(400)  # the kernel is compiled anew
def test_the_demo_runs_from_an_empty_folder(installed: Path, tmp_path: Path) -> None:
    said = run(installed.with_name("softarm"), "demo", "--targets", "1", cwd=tmp_path, seconds=390)
    assert "no limit exceeded" in said
    assert list((tmp_path / "logs").glob("*.mcap"))


def test_help_and_the_list_of_policies_from_the_users_project(installed: Path) -> None:
    home = installed.parents[2] / "their-arm"
    softarm = installed.with_name("softarm")
    assert "evaluate" in run(softarm, "--help", cwd=home)
    assert f"version {softarm_version}" in run(installed, "-m", "softarm.cli.main", "--version", cwd=home)


@pytest.mark.timeout(400)  # the kernel is compiled anew
def test_the_users_plugin_is_flown_and_so_are_a_shipped_policy_and_the_examples(installed: Path) -> None:
    home = installed.parents[2] / "their-arm"
    softarm = installed.with_name("softarm")
    assert "left: 54 targets" in run(softarm, "evaluate", "--policy", "left", cwd=home, seconds=390)
    flown = run(softarm, "evaluate", "--policy", "reach", cwd=home)
    assert float(flown.partition("│ all         │")[2].partition("%")[0]) > 85.0
    examples = home.parent / "examples"
    tests = [examples / example.name / "tests" for example in EXAMPLES]
    assert len(tests) == 3
    plain = ("-q", "-p", "no:cacheprovider", "--import-mode=importlib", "--rootdir", examples)
    assert " passed" in run(installed, "-m", "pytest", *plain, *tests, cwd=home)
