"""Findings of the doctor on Python, packages and extras."""

from dataclasses import replace
from pathlib import Path

import pytest

from softarm.common.finding import State
from softarm.daemon.doctor import software, untried
from softarm.daemon.doctor.software import Package, Software

HERE = Software(
    (3, 12, 1),
    "1.0",
    "abc",
    (Package("numpy", "numpy>=2", "2.1", True),),
    {"sim": (Package("numba", "numba", "1", True),)},
)


def found(facts):
    return {each.name: each for each in software.judge(facts)}


@pytest.mark.parametrize(
    ("python", "state"),
    [((3, 10, 9), State.PROBLEM), ((3, 11, 0), State.OK), ((3, 13, 2), State.OK), ((3, 14, 0), State.WARNING)],
)
def test_an_unsupported_python_is_a_problem(python, state):
    assert found(replace(HERE, python=python))["Python"].state is state


def test_the_version_is_shown_once_outside_a_checkout():
    assert found(replace(HERE, revision="unknown, softarm 1.0"))["softarm"].figure == "1.0"
    assert found(HERE)["softarm"].figure == "1.0 (abc)"


def test_a_missing_or_old_package_is_a_problem_in_the_core_only():
    lacking = (Package("numpy", "numpy>=2", "1.26", False), Package("mcap", "mcap>=1", None, False))
    findings = found(replace(HERE, core=lacking, extras={"sim": lacking}))
    assert findings["packages"].state is State.PROBLEM
    assert findings["packages"].figure == "numpy>=2 is 1.26, mcap>=1 is not installed"
    assert findings["extra sim"].state is State.OK
    assert findings["extra sim"].figure == "lacks numpy, mcap"
    assert "pip install 'softarm[sim]'" in findings["extra sim"].advice
    assert found(replace(HERE, core=()))["packages"].state is State.WARNING


def test_the_installed_packages_meet_the_projects_requirements():
    facts = software.look()
    core = {each.name for each in facts.core}
    assert {"numpy", "onnxruntime", "eclipse-zenoh", "click"} <= core
    assert "numba" not in core
    assert {each.name for each in facts.extras["sim"]} == {"numba"}
    names = {each.name for each in facts.extras["train"]}
    assert {"numba", "torch", "gymnasium"} <= names
    assert all(each.fits for each in facts.core)
    assert all(each.fits for each in facts.extras["sim"])


PAGE = Path(__file__).parents[3] / "docs" / "hardware" / "untried.md"


def test_the_page_is_generated_from_the_constants():
    remedy = "stale: run `python -m softarm.daemon.doctor.untried > docs/hardware/untried.md`"
    assert PAGE.read_text(encoding="utf-8") == untried.page(), remedy
