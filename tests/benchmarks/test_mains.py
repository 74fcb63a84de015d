"""Benchmarks start alike: `python -m benchmarks.NAME` with common option names."""

import importlib
from pathlib import Path

import pytest
from click.testing import CliRunner

ROOT = Path(__file__).parents[2]
STARTED = sorted(
    f"{folder}.{file.stem}"
    for folder in ("benchmarks", "tools", "validation")
    for file in (ROOT / folder).glob("*.py")
    if "def main(" in file.read_text(encoding="utf-8")
)


@pytest.mark.parametrize("name", STARTED)
def test_help_shows_an_example_of_itself(name):
    out = CliRunner().invoke(importlib.import_module(name).main, ["--help"])
    assert out.exit_code == 0
    assert f"python -m {name}" in out.output.partition("Example")[2]
