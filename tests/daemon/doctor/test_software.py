"""Python, packages, extras: facts in, findings out."""

from dataclasses import replace

import pytest

from softarm.daemon.doctor import software
from softarm.daemon.doctor.finding import State
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
def test_the_version_of_python(python, state):
    assert found(replace(HERE, python=python))["Python"].state is state


def test_a_package_that_is_missing_or_too_old_is_a_problem_of_the_core_and_none_of_an_extra():
    lacking = (Package("numpy", "numpy>=2", "1.26", False), Package("mcap", "mcap>=1", None, False))
    told = found(replace(HERE, core=lacking, extras={"sim": lacking}))
    assert told["packages"].state is State.PROBLEM
    assert told["packages"].figure == "numpy>=2 is 1.26, mcap>=1 is not installed"
    assert told["extra sim"].state is State.OK
    assert told["extra sim"].figure == "lacks numpy, mcap"
    assert "pip install 'softarm[sim]'" in told["extra sim"].advice
    assert found(replace(HERE, core=()))["packages"].state is State.WARNING


def test_what_is_installed_here_is_what_the_project_asks_for():
    facts = software.look()
    core = {each.name for each in facts.core}
    assert {"numpy", "onnxruntime", "eclipse-zenoh", "click"} <= core
    assert "numba" not in core
    assert {each.name for each in facts.extras["sim"]} == {"numba"}
    names = {each.name for each in facts.extras["train"]}
    assert {"numba", "torch", "gymnasium"} <= names
    assert all(each.fits for each in facts.core)
    assert all(each.fits for each in facts.extras["sim"])
