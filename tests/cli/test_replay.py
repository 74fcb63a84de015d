"""`softarm replay` says what a log does not hold, before it says that the rest came out the same."""

import re

import pytest
from click.testing import CliRunner

from softarm.cli.main import main
from softarm.daemon.logbook import logs
from softarm.daemon.logbook.recorder import Recorder
from softarm.daemon.logbook.tick_file import TickFile
from softarm.daemon.shell.offline import Lockstep
from softarm.policies import registry
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal


@pytest.fixture
def log(tmp_path):
    """A still arm for half a minute, a flight."""
    config = Config(recorder={"directory": tmp_path, "around_s": 1.0})
    policy = registry.load("reach")
    recorder = Recorder(config, policy.spec)
    recorder.start()
    daemon = Lockstep(config, policy, recorder=recorder)
    for _ in range(900):
        daemon.tick()
    daemon.arm()
    daemon.tick(daemon.request("goal", Goal("reach", -0.2, 0.6)))
    for _ in range(20):
        daemon.tick()
    recorder.stop()
    return recorder.path


def replay(path):
    return CliRunner().invoke(main, ["replay", str(path)])


def copy(log, path, keep):
    """The log with those of its ticks alone that `keep` names."""
    whole = logs.read(log)
    with path.open("wb") as file:
        live = TickFile(file)
        live.head(whole.config, None, 0, 0)
        for tick in whole:
            if keep(tick[1]):
                live.write(tick)
        live.flush()
    return path


def test_a_still_arm_is_counted_and_the_flight_compared(log):
    result = replay(log)
    assert result.exit_code == 0, result.output
    _, missing, unsure, verdict = result.stdout.splitlines()
    ticks, seconds = map(int, re.match(r"not in this log: (\d+) ticks \((\d+) s\)", missing).groups())
    assert ticks > 750
    assert seconds > 25
    assert unsure.startswith("run but not compared: ")
    compared = int(verdict.removesuffix(" ticks, every command the same"))
    assert compared + int(unsure.split()[4]) + ticks == list(logs.read(log).outputs())[-1].tick


def test_a_log_that_begins_in_the_middle_says_so(log, tmp_path):
    result = replay(copy(log, tmp_path / "later.mcap", lambda outputs: outputs.tick > 905))
    assert result.exit_code == 0, result.output
    assert "the log begins at tick 906 of its run: an earlier file holds what was before" in result.stdout


def test_ticks_lost_in_flight_are_not_passed_over(log, tmp_path):
    flown = [o.tick for o in logs.read(log).outputs() if o.sent.cart_velocity_m_s]
    result = replay(copy(log, tmp_path / "torn.mcap", lambda outputs: outputs.tick != flown[5]))
    assert f"tick {flown[6]}: the 1 before it are not in this log, and the drive was on" in result.stdout
