"""Benchmarks start alike: `python -m benchmarks.NAME` with common option names."""

import importlib
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from softarm.evaluation.software_in_the_loop import SoftwareInTheLoopError
from softarm.policies.base import PolicyError

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


@pytest.mark.parametrize(
    ("name", "work", "error"),
    [
        ("benchmarks.loop", "run", SoftwareInTheLoopError),
        ("validation.api", "SimulatedDaemon", SoftwareInTheLoopError),
        ("validation.chained", "fly", SoftwareInTheLoopError),
        ("validation.dead_daemon", "run", SoftwareInTheLoopError),
        ("validation.faults", "measure", PolicyError),
        ("validation.stop", "run", SoftwareInTheLoopError),
        ("validation.viewers", "run", SoftwareInTheLoopError),
    ],
)
def test_a_measurement_that_cannot_run_states_the_cause(name, work, error, monkeypatch):
    def refuse(*_):
        raise error("the daemon did not start")

    module = importlib.import_module(name)
    monkeypatch.setattr(module, work, refuse)
    out = CliRunner().invoke(module.main, ["--body", "simulated"] if name == "validation.chained" else [])
    assert (out.exit_code, out.stderr.splitlines()[-1]) == (1, "the daemon did not start")
