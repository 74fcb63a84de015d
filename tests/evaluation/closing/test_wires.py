"""Flights on wires: a separate daemon in real time, with the twin or the devices of a configuration."""

import httpx
import pytest

from softarm.daemon.config.configuration import load
from softarm.daemon.logbook import logs
from softarm.evaluation.closing import wires
from softarm.evaluation.closing.outcomes import NEW, OLD, REST, SWINGING
from softarm.evaluation.software_in_the_loop import SoftwareInTheLoop, SoftwareInTheLoopError
from softarm.policies.base import MODELS
from softarm.schemas.config import Config, Drivers, Goals, Limits, Mocap, RailLimits, Ros, Workspace
from tests.evaluation.closing.cases import findings, seen

BOTH = {OLD: MODELS / "reach.onnx", NEW: MODELS / "reach-robust.onnx"}
KEYS = ("latency_s", "braking_m_s2", "surge_m_s2", "drag_m_s")

pytestmark = pytest.mark.timeout(170)


def test_devices_with_unknown_limits_are_not_moved():
    unsaid = wires.refusals(Config(), findings(Config()))
    assert [text.split()[0] for text in unsaid] == [f"limits.rail.{key}" for key in KEYS]
    assert "neither configured nor measured: only 0 set-point steps recorded" in unsaid[0]
    usual = RailLimits()
    said = Config(limits=Limits(rail=RailLimits(**{key: getattr(usual, key) for key in KEYS})))
    assert wires.refusals(said, findings(said)) == []
    assert wires.refusals(Config(), findings(Config(), seen())) == []
    (beyond,) = wires.refusals(said, findings(said, seen(latency_s=0.25)))
    assert "no allowed value covers it: check the drive" in beyond


def test_a_workspace_without_a_test_target_is_refused(tmp_path):
    nowhere = Config(goals=Goals(workspace=Workspace(y_min_m=0.5, y_max_m=0.6)))
    with pytest.raises(ValueError, match="contains none of the 54 test targets"):
        wires.fly(nowhere, BOTH, 1, "the robot", tmp_path, None, lambda text, share: None)


def test_the_twin_replaces_the_cameras_and_the_ros_router_of_the_configuration(tmp_path):
    cameras = Mocap(driver="cameras", key="lab/mocap", options={"server": "192.168.1.2"})
    config = Config(drivers=Drivers(mocap=cameras), ros=Ros(router="tcp/192.168.1.3:7447"))
    bench = wires.Bench(config, BOTH, tmp_path, wires.Twin("our twin", (), True))
    used = load(bench.config_file)
    bench.__exit__()
    assert used.drivers.mocap == Mocap(endpoint=used.drivers.mocap.endpoint)
    assert used.ros == Ros()


@pytest.mark.prove
@pytest.mark.realtime
def test_old_and_new_fly_the_same_goals_on_the_twin(tmp_path):
    reported, twin = [], wires.Twin("our twin", ("--reality", "--fault", "rail.delay_s=0.05"), True)
    config = Config(limits=Limits(rail=RailLimits(latency_s=0.06)))
    found = wires.fly(config, BOTH, 1, "the robot", tmp_path / "logs", twin, lambda *args: reported.append(args))
    assert (found.title, found.is_the_robot, found.ended) == ("our twin", True, None)
    for manner in (REST, SWINGING):
        for name in BOTH:
            assert found.flown[name, manner].reached.shape == (1,)
            assert found.flown[name, manner].stops == (None,)
    assert sum(found.both(name).reached.sum() for name in BOTH) >= 2  # real time on a busy machine
    log = logs.read(found.log)
    assert log.config.limits.rail.latency_s == 0.06
    flown = [outputs.policy for _, outputs in log.ticks() if outputs.goal.state == "running"]
    assert len(set(flown)) == 2
    assert [share for _, share in reported] == [0.0, 0.0, 0.25, 0.5, 0.75]


@pytest.fixture
def robot(tmp_path):
    """Configuration with devices that answer; the daemon cannot distinguish them from hardware."""
    sil = SoftwareInTheLoop(tmp_path / "logs")
    try:
        sil.start_twin()
        yield load(sil.config_file)
    finally:
        sil.__exit__(None, None, None)


@pytest.fixture
def before_the_second_goal(monkeypatch):
    """Set an action, given the bench, that runs when old and new have flown the first goal."""
    begun, actions = [], []
    began = wires.Bench.use

    def use(bench, policy):
        begun.append(policy)
        if len(begun) == 3:
            actions[0](bench)
        began(bench, policy)

    monkeypatch.setattr(wires.Bench, "use", use)
    return actions.append


@pytest.mark.prove
@pytest.mark.realtime
def test_a_person_ends_the_flights_and_must_acknowledge_the_stop(robot, tmp_path, before_the_second_goal):
    before_the_second_goal(lambda bench: httpx.post(f"http://127.0.0.1:{robot.api.port}/api/stop"))
    found = wires.fly(robot, BOTH, 2, "the robot", tmp_path, None, lambda text, share: None)
    assert found.flights == 1
    assert "an emergency stop was requested" in found.ended
    assert found.ended_by is None  # no policy's fault
    with pytest.raises(SoftwareInTheLoopError, match="an emergency stop is latched"):
        wires.fly(robot, BOTH, 2, "the robot", tmp_path, None, lambda text, share: None)
