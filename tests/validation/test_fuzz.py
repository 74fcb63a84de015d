"""Every parser rejects broken input with its own error: a few cases of the long run."""

import math
import os
import time

import pytest

from validation.fuzz import trials
from validation.fuzz.parsers import PARSERS, Parser
from validation.fuzz.trials import try_case

# What takes milliseconds a case gets fewer; the others CASES.
CASES = 300
FEW = {
    "table.mat": 4,
    "pt.checkpoint": 20,
    "onnx.model": 40,
    "onnx.metadata": 20,
    "onnx.weights": 20,
    "csv.trial": 40,
    "npz.plans": 100,
}
FEW |= {name: 80 for name in PARSERS if name.startswith(("yaml.", "log."))}


@pytest.mark.slow
@pytest.mark.parametrize("name", PARSERS)
@pytest.mark.filterwarnings("ignore:Initializing zero-element tensors", "ignore:Duplicate variable name")
def test_a_parser_keeps_its_promise(name, monkeypatch):
    monkeypatch.setattr(trials, "WORK_MAX", math.inf)  # a first case compiles; time is measured by the long run
    assert [found for case in range(FEW.get(name, CASES)) if (found := try_case(name, case))] == []


def raises(case):
    raise (KeyError, ValueError, ValueError)[case % 3]("" if case % 3 == 1 else "says why")


@pytest.fixture
def planted(monkeypatch):
    """Parsers that are known to break their promise; a case is its own number."""

    def plant(take):
        parser = Parser(lambda random: int(random.random() * 300), take, (ValueError,))
        monkeypatch.setitem(PARSERS, "planted", lambda: parser)
        monkeypatch.setattr(trials, "START", "fork")  # which takes along what is planted
        trials.made.cache_clear()

    yield plant
    trials.made.cache_clear()


def test_another_exception_and_one_without_a_sentence_are_findings(planted):
    planted(raises)
    kinds = {found.what.partition(" at ")[0] for case in range(50) if (found := try_case("planted", case))}
    assert kinds == {"KeyError: 'says why'", "ValueError without a message"}


def test_a_case_that_takes_long_or_much_memory_is_a_finding(planted, monkeypatch):
    monkeypatch.setattr(trials, "WORK_MAX", 1.0)
    planted(lambda case: sum(range(30_000_000)))
    assert "units of processor time, allowed 1" in try_case("planted", 0).what
    monkeypatch.setattr(trials, "WORK_MAX", 1e6)
    monkeypatch.setattr(trials, "MEMORY_MAX_MB", 50.0)
    planted(lambda case: len(b"x" * 100_000_000))
    assert "MB, allowed 50" in try_case("planted", 0).what


def test_a_process_that_hangs_or_dies_is_a_finding_and_the_next_case_is_tried(planted, monkeypatch):
    monkeypatch.setattr(trials, "HANG_S", 0.3)
    before = {0: lambda: time.sleep(60), 1: lambda: os._exit(7)}
    planted(lambda case: before.get(case % 8, lambda: time.sleep(0.001))())
    for found in trials.fuzz("planted", 3.0):
        pass
    assert {finding.what for finding in found.findings} == {"hangs: no answer within 0.3 s", "the process died (7)"}
    assert found.cases > 8


def test_a_case_is_identified_by_its_number():
    assert trials.draw("mocap.payload", 7) == trials.draw("mocap.payload", 7) != trials.draw("mocap.payload", 8)
