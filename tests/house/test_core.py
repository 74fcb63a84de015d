"""What the core asks for: how large it is, and whether a Raspberry Pi gets it. docs/install.md tells the figures."""

import shutil
import subprocess
import sys
import tomllib
from importlib.metadata import distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
CORE_MAX_MB = 260  # without compiled .pyc
LARGE_MB = 5
LARGE = {"onnxruntime", "numpy", "eclipse-zenoh", "zstandard", "pygments", "lz4", "pydantic-core"}  # may be


def asked_for(lines: list[str]) -> dict[str, float]:
    """Every package that these lead to, with its size in MB; nothing of ours."""
    found: dict[str, float] = {}
    waiting = [Requirement(line) for line in lines]
    while waiting:
        name = canonicalize_name((wanted := waiting.pop()).name)
        if name in found or (wanted.marker and not wanted.marker.evaluate({"extra": ""})):
            continue
        here = distribution(name)
        places = {Path(str(here.locate_file(file))) for file in here.files or () if file.suffix != ".pyc"}
        found[name] = sum(place.stat().st_size for place in places if place.is_file()) / 1e6
        waiting += [Requirement(line) for line in here.requires or ()]
    return found


def test_the_core_stays_as_small_as_the_packages_that_it_needs():
    sizes = asked_for(PROJECT["dependencies"])
    assert {name for name, size in sizes.items() if size > LARGE_MB} <= LARGE
    assert sum(sizes.values()) < CORE_MAX_MB, sizes
    assert not {"torch", "scipy", "numba", "matplotlib", "pandas", "sympy"} & set(sizes)


def test_the_versions_of_python_that_are_promised_are_those_that_doctor_knows():
    from softarm.daemon.doctor.software import TRIED

    told = {tuple(map(int, line.rpartition(" ")[2].split("."))) for line in PROJECT["classifiers"] if ":: 3." in line}
    assert (min(told), max(told)) == TRIED
    assert PROJECT["requires-python"] == ">={}.{}".format(*TRIED[0])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("python", "machine", "extras"),
    [
        ("3.11", "aarch64", ("sim",)),  # Raspberry Pi OS of 2023
        ("3.13", "aarch64", ("sim", "foxglove")),  # and of 2025
        ("3.13", "x86_64", ("sim", "train", "diagnosis", "mujoco", "foxglove")),
    ],
)
def test_every_package_is_there_as_a_wheel(python, machine, extras):
    """Asks the package index; skipped where it, or uv, is not there."""
    uv = shutil.which("uv", path=str(Path(sys.executable).parent)) or shutil.which("uv")
    if uv is None:
        pytest.skip("uv is not installed: which wheels there are is not looked up")
    options = ["--python-version", python, "--python-platform", f"{machine}-manylinux_2_28", "--only-binary", ":all:"]
    named = [word for extra in extras for word in ("--extra", extra)]
    done = subprocess.run(
        [uv, "pip", "compile", "--quiet", *options, *named, "pyproject.toml"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=150,
    )
    if done.returncode and ("error sending request" in done.stderr or "Failed to fetch" in done.stderr):
        pytest.skip("the package index does not answer: which wheels there are is not looked up")
    assert done.returncode == 0, done.stderr
    assert "onnxruntime==" in done.stdout
