"""Script of the soak test: an operator's requests, and stops with and without a fault as cause."""

import json

import pytest

from softarm.daemon.control.failsafe import TABLE
from softarm.drivers.twin.faults import Faults
from validation.soak.clients import AFTERMATH_S, FAULTS, REQUEST_S, Script

NEVER = 1e9


def status(mode="armed", goal="none", number=1, stop=None, estop="clear", refusals=()):
    return {
        "mode": mode,
        "estop": estop,
        "goal": {"state": goal, "number": number},
        "last_stop": stop,
        "arming_refusals": list(refusals),
        "recorder": {"log": "logs/one.mcap"},
    }


@pytest.fixture
def calm():
    """Run a script without faults and changes."""
    return Script(0, fault_every_s=NEVER, change_every_s=NEVER)


def stop(name):
    return f"{TABLE[name].meaning} (7 ms): {TABLE[name].remedy}"


@pytest.mark.parametrize(
    ("seen", "path"),
    [
        (status("disarmed"), "/api/arm"),
        (status("disarmed", refusals=["the drive reports a fault"]), "/api/acknowledge"),
        (status("stopped", estop="latched"), "/api/acknowledge"),
        (status("stopped", estop="engaged"), "/api/acknowledge"),
        (status("armed"), "/api/goal"),
        (status("armed", "failed"), "/api/goal"),
    ],
)
def test_the_script_sends_the_next_request_and_waits_for_its_effect(calm, seen, path):
    assert [act.path for act in calm.acts(seen, 1.0)] == [path]
    assert calm.acts(seen, 1.1) == []
    assert [act.path for act in calm.acts(seen, 1.1 + REQUEST_S)] == [path]


def test_a_stop_without_a_fault_is_unexpected_and_its_log_is_named(calm):
    calm.acts(status("armed", "running"), 1.0)
    calm.acts(status("disarmed", stop=stop("ticks_missed")), 1.1)
    (one,) = calm.unexpected
    assert (one.time_s, one.log) == (1.1, "logs/one.mcap")
    assert one.what.startswith("stopped: the control loop fell behind")
    assert calm.counts["stop: ticks_missed"] == 1


@pytest.mark.parametrize(
    ("event", "after_s", "expected"),
    [
        ("mocap_stale", 0.5, True),
        ("mocap_stale", 3.0 + AFTERMATH_S, False),
        ("rail_fault", 0.5, False),
        ("internal_error", 0.5, False),
        ("arming_timeout", 0.5, True),
    ],
)
def test_a_fault_explains_stops_of_its_own_device_for_a_while(calm, monkeypatch, event, after_s, expected):
    monkeypatch.setattr(calm, "_due_s", {"fault": 1.0, "change": NEVER})
    monkeypatch.setattr(calm._chance, "choice", lambda among: "mocap_freeze" if "mocap_freeze" in among else among[0])
    (act,) = calm.acts(status("armed", "running"), 1.0)
    assert act.kind == "fault"
    assert json.loads(act.path)["fault"] == "mocap_freeze"
    calm.acts(status("stopping", stop=stop(event)), 1.0 + after_s)
    assert (calm.unexpected == []) is expected


def test_the_twin_has_every_fault_of_the_script():
    faults = Faults(lambda: 0)
    script = Script(3, fault_every_s=0.1, change_every_s=NEVER)
    given = [act.path for n in range(300) for act in script.acts(status(), 0.1 * n) if act.kind == "fault"]
    for fault in given:
        faults.apply(fault.encode())
    assert {json.loads(fault)["fault"] for fault in given} == FAULTS.keys()


def test_faults_name_existing_events():
    for _, _, beginnings in FAULTS.values():
        assert all(any(name.startswith(begins) for name in TABLE) for begins in beginnings)


def test_requested_stops_and_disarms_are_expected():
    script = Script(0, fault_every_s=NEVER, change_every_s=1.0)
    armed, asked = status("armed", "running"), []
    for tick in range(700):
        acts = script.acts(armed, 0.1 * tick)
        asked += [act.path for act in acts]
        if acts and acts[0].path in ("/api/stop", "/api/disarm"):
            script.acts(status("stopped", stop=stop("stop_requested")), 0.1 * tick + 0.05)
            script.acts(armed, 0.1 * tick + 0.06)
    assert {"/api/stop", "/api/disarm", "/api/policy"} <= set(asked)
    assert script.unexpected == []
