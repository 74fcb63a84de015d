"""A cell with the real processes: the arm is safe, and the cause is right."""

import pytest

from validation.matrix.cells import Cell, faults_of
from validation.matrix.flight import fly_all


# Over 3 s: one cell flies with all processes in real time.
@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.timeout(170)
def test_a_fault_ends_safely_with_the_right_cause():
    ((cell, outcome),) = fly_all([Cell("rail", "read", "garbage")])
    assert faults_of(cell, outcome) == []
    assert outcome.stopped
