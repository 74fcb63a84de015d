"""A drive that keeps its set-point is stopped when the daemon dies: a small run of the validation."""

import pytest

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
