"""Dependencies of the core: their size, and wheels for a Raspberry Pi (docs/install.md states the figures)."""

import os
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
# Without compiled files.
CORE_MAX_MB = 260
LARGE_MB = 5
# Packages that may be larger than LARGE_MB.
LARGE = {"onnxruntime", "numpy", "eclipse-zenoh", "zstandard", "pygments", "lz4", "pydantic-core"}


def dependencies(lines: list[str]) -> dict[str, float]:
    """Return all direct and indirect dependencies with their sizes, MB."""
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
    sizes = dependencies(PROJECT["dependencies"])
    assert {name for name, size in sizes.items() if size > LARGE_MB} <= LARGE
    assert sum(sizes.values()) < CORE_MAX_MB, sizes
    assert not {"torch", "scipy", "numba", "matplotlib", "pandas", "sympy"} & set(sizes)


def test_the_supported_python_versions_match_those_of_doctor():
    from softarm.daemon.doctor.software import TRIED

    versions = {
        tuple(map(int, line.rpartition(" ")[2].split("."))) for line in PROJECT["classifiers"] if ":: 3." in line
    }
    assert (min(versions), max(versions)) == TRIED
    assert PROJECT["requires-python"] == ">={}.{}".format(*TRIED[0])


def test_the_blas_kernels_are_the_same_on_cpus_with_and_without_avx512():
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_CORETYPE"}
    code = "import softarm, numpy, threadpoolctl; print(threadpoolctl.threadpool_info()[0]['architecture'])"
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() not in {"SkylakeX", "Cooperlake", "SapphireRapids"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("python", "machine", "extras"),
    [
        ("3.11", "aarch64", ("sim",)),  # Raspberry Pi OS of 2023
        pytest.param("3.13", "aarch64", ("sim", "foxglove"), marks=pytest.mark.prove),  # and of 2025
        pytest.param("3.13", "x86_64", ("sim", "train", "diagnosis", "mujoco", "foxglove"), marks=pytest.mark.prove),
    ],
)
def test_every_dependency_is_available_as_a_wheel(python, machine, extras):
    """Query the package index; skip without it or without uv."""
    uv = shutil.which("uv", path=str(Path(sys.executable).parent)) or shutil.which("uv")
    if uv is None:
        pytest.skip("uv is not installed")
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
        pytest.skip("the package index does not answer")
    assert done.returncode == 0, done.stderr
    assert "onnxruntime==" in done.stdout
