"""Benchmarks start alike: `python -m benchmarks.NAME` with common option names."""

import importlib
import json
import subprocess
import sys
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from benchmarks import results

ROOT = Path(__file__).parents[2]
STARTED = sorted(
    f"{folder}.{file.stem}"
    for folder in ("benchmarks", "tools", "validation")
    for file in (ROOT / folder).glob("*.py")
    if "def main(" in file.read_text(encoding="utf-8")
)


@pytest.fixture(params=STARTED)
def main(request) -> click.Command:
    return importlib.import_module(request.param).main


def test_help_shows_an_example_of_itself(main):
    out = CliRunner().invoke(main, ["--help"])
    assert out.exit_code == 0
    name = main.callback.__module__
    assert f"python -m {name}" in out.output.partition("Example")[2], name


def test_figures_are_stored_with_their_origin(tmp_path):
    file = tmp_path / "figures.json"
    program = f"from benchmarks import results; results.write(results.Path({str(file)!r}), {{'speed': 2.5}})"
    subprocess.run([sys.executable, "-c", program, "--seconds", "3"], check=True)
    found = json.loads(file.read_text())
    assert found["speed"] == 2.5
    assert found["about"].keys() == {"revision", "machine", "date", "command"}
    assert found["about"]["revision"] == results.measured()
    assert found["about"]["machine"]["cores"] >= 1
    assert found["about"]["command"].endswith("--seconds 3")
