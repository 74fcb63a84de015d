"""Twin and daemon as separate processes over pty, TCP and Zenoh: what the person at the bench relies on."""

import itertools
from contextlib import ExitStack

import pytest

from softarm.daemon.logbook import logs
from softarm.evaluation.software_in_the_loop import SoftwareInTheLoop, SoftwareInTheLoopError
from softarm.schemas.goals import Goal
from tests.processes import until

pytestmark = pytest.mark.timeout(120)


@pytest.fixture
def sil(tmp_path):
    with SoftwareInTheLoop(tmp_path / "logs", {"control": {"policy": "reach"}}) as sil:
        yield sil


@pytest.mark.prove
@pytest.mark.realtime
def test_a_goal_set_by_rest_is_reached_and_recorded(sil):
    sil.arm()
    tips = []
    goal = sil.fly(Goal("reach", -0.2, 0.6), lambda *tip: tips.append(tip))
    assert goal["state"] == "reached"
    assert goal["closest_m"] < 0.04
    assert tips
    path = sil.status()["recorder"]["log"]
    sil.post("disarm")
    until(lambda: sil.status()["mode"] == "disarmed", "disarmed")
    log = logs.read(path)
    sequences = [frame.sequence for inputs, _ in log.ticks() for frame in inputs.mocap]
    assert all(later > earlier for earlier, later in itertools.pairwise(sequences))
    assert len(sequences) > 2 * len(list(log.ticks()))  # 120 Hz against 30 Hz, less what a busy twin left out
    assert any(outputs.goal.state == "reached" for _, outputs in log.ticks())


@pytest.mark.slow
def test_a_daemon_that_ends_at_once_is_reported_with_its_output(tmp_path):
    alone = SoftwareInTheLoop(tmp_path / "logs", {"control": {"policy": "raech"}})
    with ExitStack() as end:
        end.push(alone)
        with pytest.raises(SoftwareInTheLoopError, match=r"`softarm run` ended with 1:\n.*no policy 'raech'"):
            alone.start_daemon()
