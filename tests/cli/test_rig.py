"""Twin and daemon as separate processes over pty, TCP and Zenoh: what the person at the bench relies on."""

import itertools
import json
import signal
import time

import httpx
import pytest
import zenoh

from softarm.cli.rig import Rig
from softarm.daemon.logbook import logs
from softarm.drivers.mocap import zenoh_session
from softarm.schemas.goals import Goal

pytestmark = pytest.mark.timeout(120)
DEAD_S = 0.25


@pytest.fixture
def rig(tmp_path):
    with Rig(tmp_path / "logs", {"control": {"policy": "reach"}}) as rig:
        yield rig


def wait(condition, what, seconds=10.0):
    deadline = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < deadline, f"{what}: not within {seconds} s"
        time.sleep(0.005)
    return found


def test_a_goal_over_rest_is_reached_over_the_wires_and_recorded(rig):
    rig.arm()
    rig.reach(Goal("reach", -0.2, 0.6))
    goal = wait(lambda: (g := rig.client.get("/api/goal").json())["state"] != "running" and g, "the goal's end")
    assert goal["state"] == "reached"
    assert goal["closest_m"] < 0.04
    path = rig.status()["recorder"]["log"]
    rig.post("disarm")
    wait(lambda: rig.status()["mode"] == "disarmed", "disarmed")
    log = logs.read(path)
    sequences = [frame.sequence for frame in log.frames()]
    assert all(later > earlier for earlier, later in itertools.pairwise(sequences))
    assert len(sequences) > 2 * len(list(log.ticks()))  # 120 Hz against 30 Hz, less what a busy twin left out
    assert any(outputs.goal.state == "reached" for outputs in log.outputs())


def twin_state(endpoint):
    """The twin's own account, once the killed daemon's place on the wire is ours."""
    with zenoh.open(zenoh_session.listener(endpoint)) as session:
        states = session.declare_subscriber("softarm/twin/state", zenoh.handlers.RingChannel(1))
        time.sleep(0.5)  # let some time pass: what has stopped has to stay so
        return json.loads(wait(states.try_recv, "a state of the twin").payload.to_string())


def test_a_killed_daemon_leaves_a_vented_muscle_and_a_braked_cart_inside_the_rail(rig):
    """kill -9 in mid-swing: nobody is left to say stop."""
    rig.arm()
    path = rig.status()["recorder"]["log"]
    rig.reach(Goal("reach", 0.0, 0.8))

    def swinging():
        status = rig.status()
        return abs(status["rail_velocity_m_s"]) > 0.5 and status["sent"]["pressure_kpa"] > 2

    wait(swinging, "a swing")
    rig.daemon.send_signal(signal.SIGKILL)
    killed_ns = time.monotonic_ns()
    rig.daemon.wait(5.0)
    state = twin_state(rig.settings["drivers"]["mocap"]["endpoint"])
    assert state["vented"]
    assert killed_ns < state["vented_since_ns"] <= killed_ns + DEAD_S * 1e9
    assert killed_ns < state["out_of_operation_since_ns"] <= killed_ns + DEAD_S * 1e9
    assert state["cart_max_abs_m"] < 0.30
    assert state["crashes"] == 0
    log = logs.read(path)
    assert not log.finished
    assert abs(killed_ns - log.t_last_ns) <= 0.2e9


def test_a_stopped_daemon_leaves_no_process_and_a_finished_log(rig):
    path = rig.status()["recorder"]["log"]
    rig.daemon.send_signal(signal.SIGTERM)
    assert rig.daemon.wait(5.0) == 0
    assert logs.read(path).finished
    with pytest.raises(httpx.TransportError):
        rig.client.get("/api/status")
