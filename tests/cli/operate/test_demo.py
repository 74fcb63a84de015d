"""Tests of `softarm demo` and its exit code."""

import pytest

from softarm.evaluation.software_in_the_loop import SoftwareInTheLoop, SoftwareInTheLoopError
from tests.cli.invoke import refuse, succeed

pytestmark = pytest.mark.timeout(120)


# Over 3 s: the start of a daemon and a twin, and a flight in real time.
@pytest.mark.slow
@pytest.mark.realtime
def test_a_target_is_reached_and_no_limit_exceeded(tmp_path):
    result = succeed("demo", "--targets", 1, "--logs", tmp_path)
    first, *_, following, other = result.stdout.splitlines()
    assert first.startswith("watch it at http://127.0.0.1:")
    assert "1 of 1 reached, no limit exceeded" in result.output
    (log,) = tmp_path.glob("*.mcap")
    assert following == "next: `softarm run --simulated --open` flies to where you click"
    assert other == f"or:   `softarm logs view {log}` plays this flight"


@pytest.mark.prove
@pytest.mark.realtime
def test_a_refusal_of_the_daemon_fails_the_demo(tmp_path):
    message = "the policy 'hold' does not move to targets"
    refuse(message, "demo", "--targets", 1, "--logs", tmp_path, "--policy", "hold")


def test_the_error_of_a_child_process_is_printed(monkeypatch, tmp_path):
    def without_an_extra(self):
        self.__exit__(None, None, None)
        raise SoftwareInTheLoopError("softarm twin needs the package 'numba': pip install 'softarm[sim]'")

    monkeypatch.setattr(SoftwareInTheLoop, "__enter__", without_an_extra)
    done = refuse("pip install 'softarm[sim]'", "demo", "--logs", tmp_path)
    assert done.stdout.startswith("watch it at http://127.0.0.1:")  # before anything starts
