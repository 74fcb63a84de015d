"""Through the wires: a daemon of its own in real time, on the twin or on what the configuration calls its devices."""

import threading
from itertools import pairwise

import httpx
import pytest

from softarm.daemon.config.configuration import load
from softarm.daemon.limits.findings import RailFindings, compared
from softarm.daemon.limits.measured import Bound, Measured, measure
from softarm.daemon.logbook import logs
from softarm.flights.closing import story, wires
from softarm.flights.closing.outcomes import CHAINED, NEW, OLD, REST
from softarm.flights.software_in_the_loop import SoftwareInTheLoop, SoftwareInTheLoopError
from softarm.policies.base import MODELS
from softarm.schemas.config import Config, Goals, Limits, RailLimits, Workspace

BOTH = {OLD: MODELS / "reach.onnx", NEW: MODELS / "reach-robust.onnx"}
LIVE = (pytest.mark.slow, pytest.mark.realtime, pytest.mark.timeout(170))
KEYS = ("latency_s", "braking_m_s2", "surge_m_s2", "drag_m_s")


def live(test):
    for mark in LIVE:
        test = mark(test)
    return test


def findings(config, measured=None):
    measured = measured or measure((), 6.0)
    return RailFindings(config, measured, compared(measured, config))


def test_devices_are_not_moved_by_limits_that_nobody_knows():
    unsaid = wires.refusals(Config(), findings(Config()))
    assert [text.split()[0] for text in unsaid] == [f"limits.rail.{key}" for key in KEYS]
    assert "neither configured nor seen: only 0 set-point steps were seen" in unsaid[0]
    usual = RailLimits()
    said = Config(limits=Limits(rail=RailLimits(**{key: getattr(usual, key) for key in KEYS})))
    assert wires.refusals(said, findings(said)) == []
    bounds = (Bound(value, 0.97, value, 100, 50.0) for value in (0.05, 0.05, 2.6, 8.0, 0.02))
    seen = Measured(*bounds, 6.0, 100, 100, 100, 100, 1, 50.0, ())
    assert wires.refusals(Config(), findings(Config(), seen)) == []
    bounds = (Bound(value, 0.97, value, 100, 50.0) for value in (0.25, 0.25, 2.6, 8.0, 0.02))
    later = Measured(*bounds, 6.0, 100, 100, 100, 100, 1, 50.0, ())
    (beyond,) = wires.refusals(said, findings(said, later))
    assert "no allowed value covers it: see to the drive" in beyond


def test_who_is_asked_reads_what_moves_and_for_how_long():
    text = wires.what_moves(Config(), "softarm.yaml", 18)
    for words in ("The robot of softarm.yaml will move", "between -0.25 and 0.25 m at up to 1 m/s", "up to 20 kPa"):
        assert words in text
    minutes = [int(wires.what_moves(Config(), "a", goals).split("about ")[1].split()[0]) for goals in (18, 36, 72)]
    assert all(later > sooner for sooner, later in pairwise(minutes))


def test_no_target_that_the_configuration_would_refuse_is_flown(tmp_path):
    nowhere = Config(goals=Goals(workspace=Workspace(y_min_m=0.5, y_max_m=0.6)))
    with pytest.raises(ValueError, match="holds none of the 54 test targets"):
        wires.fly(nowhere, BOTH, 1, "the robot", tmp_path, None, lambda text, share: None)


@live
def test_old_and_new_fly_the_same_goals_on_the_twin(tmp_path):
    told, twin = [], wires.Twin("our twin", ("--reality", "--fault", "rail.delay_s=0.05"), True)
    config = Config(limits=Limits(rail=RailLimits(latency_s=0.06)))
    found = wires.fly(config, BOTH, 1, "the robot", tmp_path / "logs", twin, lambda *args: told.append(args))
    assert (found.title, found.is_the_robot, found.ended) == ("our twin", True, None)
    for manner in (REST, CHAINED):
        for name in BOTH:
            assert found.flown[name, manner].reached.shape == (1,)
            assert found.flown[name, manner].stops == (None,)
    assert sum(found.both(name).reached.sum() for name in BOTH) >= 2  # real time on a busy machine
    log = logs.read(found.log)
    assert log.config.limits.rail.latency_s == 0.06
    flown = [outputs.policy for outputs in log.outputs() if outputs.goal.state == "running"]
    assert len(set(flown)) == 2
    assert [share for _, share in told] == [0.0, 0.0, 0.25, 0.5, 0.75]


@pytest.fixture
def robot(tmp_path):
    """Somebody's robot: a configuration, and devices that answer it. That they are a twin the daemon cannot tell."""
    sil = SoftwareInTheLoop(tmp_path / "logs")
    try:
        sil.start_twin()
        yield load(sil.config_file)
    finally:
        sil.__exit__(None, None, None)


@live
def test_somebody_who_stops_the_robot_ends_it_and_the_latch_is_left_to_a_person(robot, tmp_path):
    def tell(text, share):
        if "policy" in text:
            threading.Timer(1.5, httpx.post, (f"http://127.0.0.1:{robot.api.port}/api/stop",)).start()

    found = wires.fly(robot, BOTH, 2, "the robot", tmp_path, None, tell)
    assert "somebody asked for an emergency stop" in found.ended
    assert found.ended_by is None  # no policy's fault
    assert (found.flights, found.won, found.against) == (0, None, ())
    with pytest.raises(SoftwareInTheLoopError, match="an emergency stop is latched"):
        wires.fly(robot, BOTH, 2, "the robot", tmp_path, None, lambda text, share: None)


@live
def test_what_was_flown_before_the_daemon_died_counts(robot, tmp_path, monkeypatch):
    begun = []
    began = wires.Bench.use

    def use(bench, policy):
        begun.append(policy)
        if len(begun) == 3:  # old and new have flown the first goal
            bench.daemon.kill()
        began(bench, policy)

    monkeypatch.setattr(wires.Bench, "use", use)
    found = wires.fly(robot, BOTH, 2, "the robot", tmp_path, None, lambda text, share: None)
    assert found.flights == 1
    assert found.ended is not None
    assert found.ended_by is None
    told = story.sentences_of(found)
    assert told[0].startswith("Through the wires, on the robot: the old policy reaches ")
    assert "ended before all was flown" in told[1]
