"""Twin and daemon as separate processes over pty, TCP and Zenoh: what the person at the bench relies on."""

import itertools
import json
import signal
import time

import pytest
import zenoh

from softarm.daemon.logbook import logs
from softarm.drivers.mocap import zenoh_session
from softarm.evaluation.software_in_the_loop import SoftwareInTheLoop, SoftwareInTheLoopError
from softarm.schemas.goals import Goal

pytestmark = pytest.mark.timeout(120)
DEAD_S = 0.25


@pytest.fixture
def sil(tmp_path):
    with SoftwareInTheLoop(tmp_path / "logs", {"control": {"policy": "reach"}}) as sil:
        yield sil


def wait(condition, what, seconds=10.0):
    deadline = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < deadline, f"{what}: not within {seconds} s"
        time.sleep(0.005)
    return found


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
    wait(lambda: sil.status()["mode"] == "disarmed", "disarmed")
    log = logs.read(path)
    sequences = [frame.sequence for inputs, _ in log.ticks() for frame in inputs.mocap]
    assert all(later > earlier for earlier, later in itertools.pairwise(sequences))
    assert len(sequences) > 2 * len(list(log.ticks()))  # 120 Hz against 30 Hz, less what a busy twin left out
    assert any(outputs.goal.state == "reached" for _, outputs in log.ticks())


def twin_state(endpoint):
    """The twin's own account, once the killed daemon's place on the wire is ours."""
    with zenoh.open(zenoh_session.listener(endpoint)) as session:
        states = session.declare_subscriber("softarm/twin/state", zenoh.handlers.RingChannel(1))
        time.sleep(0.5)  # let some time pass: what has stopped has to stay so
        return json.loads(wait(states.try_recv, "a state of the twin").payload.to_string())


@pytest.mark.prove
@pytest.mark.realtime
def test_a_killed_daemon_leaves_a_vented_muscle_and_a_braked_cart_inside_the_rail(sil):
    """After kill -9 in mid-swing, no process sends a stop."""
    sil.arm()
    path = sil.status()["recorder"]["log"]
    sil.reach(Goal("reach", 0.0, 0.8))

    def swinging():
        status = sil.status()
        return abs(status["rail_velocity_m_s"]) > 0.5 and status["sent"]["pressure_kpa"] > 2

    wait(swinging, "a swing")
    sil.daemon.send_signal(signal.SIGKILL)
    killed_ns = time.monotonic_ns()
    sil.daemon.wait(5.0)
    state = twin_state(sil.settings["drivers"]["mocap"]["endpoint"])
    assert state["vented"]
    assert killed_ns < state["vented_since_ns"] <= killed_ns + DEAD_S * 1e9
    assert killed_ns < state["out_of_operation_since_ns"] <= killed_ns + DEAD_S * 1e9
    assert state["cart_max_abs_m"] < 0.30
    assert state["crashes"] == 0
    log = logs.read(path)
    assert not log.finished
    assert abs(killed_ns - log.t_last_ns) <= 0.2e9


@pytest.mark.slow
def test_a_daemon_that_ends_at_once_is_reported_with_its_output(tmp_path):
    with (
        pytest.raises(SoftwareInTheLoopError, match=r"`softarm run` ended with 1:\n.*no policy 'raech'"),
        SoftwareInTheLoop(tmp_path / "logs", {"control": {"policy": "raech"}}),
    ):
        pass


@pytest.mark.prove
@pytest.mark.realtime
def test_the_next_start_acknowledges_the_stop_of_a_killed_daemon(sil, tmp_path):
    (latch,) = (tmp_path / "logs").glob("stop-*.json")
    sil.post("stop")
    wait(lambda: b"emergency stop was requested" in latch.read_bytes(), "the latch on the disk")
    sil.daemon.kill()
    sil.daemon.wait()
    sil.start_daemon()
    assert sil.status()["estop"] == "clear"
    sil.arm()
    assert "stopped since its last run (an emergency stop was requested" in sil.printed("run")
