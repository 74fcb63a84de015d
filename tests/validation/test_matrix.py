"""Fault matrix: the judgement of cells finds unsafe outcomes and wrong causes, and nothing else."""

import resource
import subprocess
from dataclasses import replace
from types import SimpleNamespace

import pytest

from validation.matrix.cells import SAFE_S, Cell, Outcome, faults_of
from validation.matrix.flight import _wrong, fly_all

SILENT = Cell("rail", "read", "time-out")
SAFE = Outcome(stopped=True, braked_ms=300.0, vented_ms=400.0, farthest_m=0.2, causes=("rail_stale",))


def test_a_timely_stop_with_the_right_cause_passes():
    assert faults_of(SILENT, SAFE) == []


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"crashes": 1}, "unsafe: the cart struck"),
        ({"farthest_m": 0.256}, "unsafe: the cart was at 0.256 m"),
        ({"stopped": False}, "unsafe: the arm was not stopped"),
        ({"braked_ms": None}, "unsafe: the cart braked after never"),
        ({"vented_ms": SAFE_S * 1e3 + 1}, "unsafe: the muscle vented after 1501 ms"),
        ({"causes": ("rail_stale", "mocap_stale")}, "wrong cause: mocap_stale"),
        ({"causes": ("rail_stale", "rail_disagrees")}, "wrong cause: rail_disagrees"),
        ({"causes": ()}, "no cause is named"),
        ({"problems": ["not flown: x"]}, "not flown: x"),
    ],
)
def test_every_violation_is_reported(change, said):
    assert faults_of(SILENT, replace(SAFE, **change))[0].startswith(said)


def test_a_policy_that_stops_the_whole_daemon_may_cost_frames_but_is_named_first():
    freezing = Cell("policy", "step", "holds-the-lock")
    assert faults_of(freezing, replace(SAFE, causes=("policy_fault", "rail_link_lost", "mocap_too_late"))) == []
    assert faults_of(freezing, replace(SAFE, causes=("rail_link_lost", "policy_fault"))) == [
        "wrong cause: rail_link_lost"
    ]


@pytest.mark.parametrize("cell", [Cell("disk", "write", "full"), Cell("daemon", "process", "SIGSTOP")])
def test_a_failure_while_a_fault_lasts_ends_the_fault(tmp_path, cell):
    log = tmp_path / "log"
    log.touch()
    with subprocess.Popen(["sleep", "60"]) as process:
        bench = SimpleNamespace(process=process, status=lambda: {"recorder": {"log": str(log)}})
        before = resource.prlimit(process.pid, resource.RLIMIT_FSIZE)
        with pytest.raises(OSError, match="as it was made to"), _wrong(bench, cell):
            raise OSError("as it was made to")
        assert resource.prlimit(process.pid, resource.RLIMIT_FSIZE) == before
        process.terminate()
        assert process.wait(10) == -15


# Over 3 s: one cell flies with all processes in real time.
@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.timeout(170)
def test_a_fault_ends_safely_with_the_right_cause():
    ((cell, outcome),) = fly_all([Cell("rail", "read", "garbage")])
    assert faults_of(cell, outcome) == []
    assert outcome.stopped
