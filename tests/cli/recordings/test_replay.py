"""Tests of `softarm logs replay`."""

import re

import pytest

from softarm.daemon.logbook import logs
from softarm.daemon.logbook.recorder import Recorder
from softarm.daemon.logbook.ticks import TickFile
from softarm.daemon.runtime.offline import Lockstep
from softarm.policies import registry
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal
from tests.cli.invoke import invoke


@pytest.fixture
def log(tmp_path):
    """Return a log with half a minute at rest and a flight."""
    config = Config(recorder={"directory": tmp_path, "around_s": 1.0})
    policy = registry.load("reach")
    recorder = Recorder(config, policy.spec)
    recorder.start()
    daemon = Lockstep(config, policy, record=recorder.tick)
    for _ in range(900):
        daemon.tick()
    daemon.arm()
    daemon.tick(daemon.request("goal", Goal("reach", -0.2, 0.6)))
    for _ in range(20):
        daemon.tick()
    recorder.stop()
    return recorder.path


def replay(path):
    return invoke("logs", "replay", path)


def copy(log, path, keep):
    """Copy a log with only the ticks that `keep` accepts."""
    whole = logs.read(log)
    with path.open("wb") as file:
        live = TickFile(file)
        live.head(whole.config, None, 0, 0)
        for tick in whole:
            if keep(tick[1]):
                live.write(tick)
        live.flush()
    return path


def test_idle_ticks_are_counted_and_the_flight_is_compared(log):
    result = replay(log)
    assert result.exit_code == 0, result.output
    _, missing, unsure, verdict = result.stdout.splitlines()
    ticks, seconds = map(int, re.match(r"not in this log: (\d+) ticks \((\d+) s\)", missing).groups())
    assert ticks > 750
    assert seconds > 25
    assert unsure.startswith("replayed but not compared: ")
    compared = int(verdict.removesuffix(" ticks, every command the same"))
    assert compared + int(unsure.split()[4]) + ticks == list(logs.read(log).ticks())[-1][1].tick


def test_a_log_that_starts_within_a_run_is_reported(log, tmp_path):
    result = replay(copy(log, tmp_path / "later.mcap", lambda outputs: outputs.tick > 905))
    assert result.exit_code == 0, result.output
    assert "the log begins at tick 906 of its run: an earlier file holds the ticks before" in result.stdout


def test_ticks_lost_in_flight_are_reported(log, tmp_path):
    flown = [o.tick for _, o in logs.read(log).ticks() if o.sent.cart_velocity_m_s]
    result = replay(copy(log, tmp_path / "torn.mcap", lambda outputs: outputs.tick != flown[5]))
    assert f"tick {flown[6]}: 1 ticks before it are missing, and the drive was on" in result.stdout
