"""`softarm demo`: the whole of it in a few seconds, and an end that a script can trust."""

import pytest
from click.testing import CliRunner, Result

from softarm.cli.main import main
from softarm.flights.software_in_the_loop import SoftwareInTheLoop, SoftwareInTheLoopError

pytestmark = [pytest.mark.timeout(120), pytest.mark.realtime]


def demo(logs, *arguments) -> Result:
    return CliRunner().invoke(main, ["demo", "--targets", "1", "--logs", str(logs), *arguments])


@pytest.mark.slow
def test_a_target_is_reached_and_no_limit_exceeded(tmp_path):
    result = demo(tmp_path)
    assert result.exit_code == 0, result.output
    assert "1 of 1 reached, no limit exceeded" in result.output
    assert len(list(tmp_path.glob("*.mcap"))) == 1


@pytest.mark.slow
def test_what_the_daemon_refuses_is_said_and_a_failure(tmp_path):
    result = demo(tmp_path, "--policy", "hold")
    assert result.exit_code == 1
    assert "the policy 'hold' does not move to targets" in result.output


def test_what_a_process_said_is_told_word_for_word(monkeypatch, tmp_path):
    def without_an_extra(self):
        self.__exit__(None, None, None)
        raise SoftwareInTheLoopError("softarm twin needs the package 'numba': pip install 'softarm[sim]'")

    monkeypatch.setattr(SoftwareInTheLoop, "__enter__", without_an_extra)
    done = CliRunner().invoke(main, ["demo", "--logs", str(tmp_path)])
    assert done.exit_code == 1
    assert "pip install 'softarm[sim]'" in done.output
