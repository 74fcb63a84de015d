"""Every parser rejects broken input with its own error: a few cases of the long run."""

import math

import pytest

from validation.fuzz import trials
from validation.fuzz.parsers import PARSERS, Parser
from validation.fuzz.trials import try_case

# What takes milliseconds a case gets fewer; the others CASES.
CASES = 30
FEW = {"table.mat": 1, "npz.plans": 10, "pt.checkpoint": 2, "api.server": 5}
FEW |= {name: 2 for name in PARSERS if name.startswith(("yaml.", "log.", "csv.", "onnx."))}


@pytest.mark.slow
@pytest.mark.parametrize("name", PARSERS)
@pytest.mark.filterwarnings("ignore:Initializing zero-element tensors", "ignore:Duplicate variable name")
def test_a_parser_keeps_its_promise(name, monkeypatch):
    monkeypatch.setattr(trials, "WORK_MAX", math.inf)  # a first case compiles; time is measured by the long run
    assert [found for case in range(FEW.get(name, CASES)) if (found := try_case(name, case))] == []


def test_a_broken_promise_is_a_finding(monkeypatch):
    monkeypatch.setitem(PARSERS, "planted", lambda: Parser(lambda random: 0, lambda case: {}["missing"], (ValueError,)))
    assert "KeyError: 'missing'" in try_case("planted", 0).what
