"""A few cells, flown with the real processes: the arm is safe and the right one is blamed."""

import pytest

from softarm.benchmarks.matrix.cells import Cell, Outcome, faults_of
from softarm.benchmarks.matrix.flight import fly_all

FLOWN = [
    Cell("mocap", "read", "replay"),
    Cell("regulator", "write", "time-out"),
    Cell("rail", "read", "garbage"),
    Cell("policy", "step", "raises"),
    Cell("rail", "close", "half frame"),
    Cell("daemon", "process", "kill -9"),
]


@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.timeout(170)
def test_what_goes_wrong_ends_safely_and_with_the_right_name():
    left: dict[str, tuple[Outcome, list[str]]] = {}
    fly_all(FLOWN, lambda cell, outcome: left.update({str(cell): (outcome, faults_of(cell, outcome))}))
    assert {name: wrong for name, (_, wrong) in left.items() if wrong} == {}
    assert all(outcome.stopped for outcome, _ in left.values())
