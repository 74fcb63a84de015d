"""A few cells with the real processes: the arm is safe, and the cause is right."""

import pytest

from validation.matrix.cells import Cell, Outcome, faults_of
from validation.matrix.flight import fly_all

FLOWN = [
    Cell("mocap", "read", "replay"),
    Cell("regulator", "write", "time-out"),
    Cell("rail", "read", "garbage"),
    Cell("policy", "step", "raises"),
    Cell("rail", "close", "half frame"),
    Cell("daemon", "process", "kill -9"),
]


# Over 3 s: one cell flies with all processes in real time.
@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.timeout(170)
@pytest.mark.parametrize(
    "cells", [pytest.param(FLOWN[2:3], id="smoke"), pytest.param(FLOWN, id="all", marks=pytest.mark.prove)]
)
def test_every_fault_ends_safely_with_the_right_cause(cells):
    found: dict[str, tuple[Outcome, list[str]]] = {}
    fly_all(cells, lambda cell, outcome: found.update({str(cell): (outcome, faults_of(cell, outcome))}))
    assert {name: wrong for name, (_, wrong) in found.items() if wrong} == {}
    assert all(outcome.stopped for outcome, _ in found.values())
