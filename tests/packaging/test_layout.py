"""Layout of the checkout: one package, four links into it, and what is not installed beside it."""

import subprocess
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
DATA = {"softarm.yaml", "twin.yaml", "systemd", "docs"}  # installed with the package
LINKED = {"daemon", "drivers", "policies", "schemas"}  # the top-level names that the project was asked for with
NOT_INSTALLED = {"benchmarks", "tools", "validation"}


def packages() -> set[str]:
    """Names of the packages inside softarm/."""
    return {path.parent.name for path in (ROOT / "softarm").glob("*/__init__.py")}


def test_git_tracks_exactly_these_symbolic_links() -> None:
    listed = subprocess.run(["git", "ls-files", "-s"], cwd=ROOT, capture_output=True, text=True, check=True)
    modes = {line.split("\t")[1]: line.split()[0] for line in listed.stdout.splitlines()}
    links = {path for path, mode in modes.items() if mode == "120000"}
    assert links == LINKED | {f"softarm/{name}" for name in DATA}


@pytest.mark.parametrize("name", sorted(LINKED))
def test_a_top_level_link_leads_into_the_package(name: str) -> None:
    assert (ROOT / name).readlink() == Path("softarm") / name


def test_importing_a_linked_package_by_its_short_name_is_banned() -> None:
    assert PROJECT["tool"]["ruff"]["lint"]["flake8-tidy-imports"]["banned-api"].keys() == LINKED


@pytest.mark.parametrize("top", ["softarm", *sorted(NOT_INSTALLED)])
def test_every_folder_with_code_is_a_package_and_no_file_exceeds_500_lines(top: str) -> None:
    for file in (ROOT / top).rglob("*.py"):
        assert (file.parent / "__init__.py").is_file(), file
        assert len(file.read_text(encoding="utf-8").splitlines()) <= 500, file


def test_the_layers_contract_names_every_package_once() -> None:
    contracts = PROJECT["tool"]["importlinter"]["contracts"]
    layers = next(contract for contract in contracts if contract.get("containers") == ["softarm"])["layers"]
    named = [package.strip() for layer in layers for package in layer.split("|")]
    assert sorted(named) == sorted(packages())
