"""A drive that keeps its set-point is stopped when the daemon dies: a small run of the validation."""

import random
from types import SimpleNamespace

import pytest

from softarm.evaluation.software_in_the_loop import SoftwareInTheLoopError
from validation import dead_daemon


# Over 3 s: one case with daemon, rail process and twin in real time.
@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.timeout(170)
@pytest.mark.parametrize(
    "cases",
    [
        pytest.param(["daemon: kill -9"], id="smoke"),
        pytest.param(list(dead_daemon.CASES), id="all", marks=pytest.mark.prove),
    ],
)
def test_the_cart_stops_and_the_valve_opens_when_a_process_ends_or_freezes(cases):
    found = dead_daemon.run(1, cases, lambda share: None)
    assert {name: figures["crashes"] for name, figures in found.items()} == dict.fromkeys(cases, 0)
    stopped_ms = {name: figures["stop_received_ms"]["max"] for name, figures in found.items()}
    assert {
        name: ms for name, ms in stopped_ms.items() if ms > (400 if "SIGSTOP" in name and "rail" in name else 150)
    } == {}
    assert max(figures["vented_ms"]["max"] for figures in found.values()) < 400


@pytest.mark.parametrize(
    ("halted_after_s", "missing"), [(None, "the cart received no stop"), (0.1, "the valve did not open")]
)
def test_a_missing_reaction_is_stated_with_its_case(monkeypatch, halted_after_s, missing):
    state = SimpleNamespace(cart_position_m=0.0, cart_velocity_m_s=1.0, halted_after_s=halted_after_s, vented=False)
    rig = SimpleNamespace(drive=lambda limit_s: None, robot=SimpleNamespace(state=state))
    monkeypatch.setitem(dead_daemon.CASES, "nothing", lambda rig: None)
    monkeypatch.setattr(dead_daemon, "REST_S", 0.0)
    monkeypatch.setattr(dead_daemon, "SWING_S", (0.0, 0.0))
    state.braked_since_ns = None
    with pytest.raises(SoftwareInTheLoopError, match=f"nothing: {missing} within 0 s"):
        dead_daemon._trial(rig, "nothing", random.Random(0))
