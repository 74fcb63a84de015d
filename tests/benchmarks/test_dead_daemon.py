"""Whatever happens to the daemon, a drive that keeps its set-point is told to stop: the benchmark in small."""

import pytest

from softarm.benchmarks import dead_daemon


@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.timeout(170)
def test_the_cart_is_told_to_stop_and_the_valve_is_opened_whichever_process_ends_or_freezes():
    found = dead_daemon.run(1, list(dead_daemon.CASES), lambda share: None)
    assert {name: figures["crashes"] for name, figures in found.items()} == dict.fromkeys(dead_daemon.CASES, 0)
    told_ms = {name: figures["told_to_stop_ms"]["max"] for name, figures in found.items()}
    assert {
        name: ms for name, ms in told_ms.items() if ms > (400 if "SIGSTOP" in name and "rail" in name else 150)
    } == {}
    assert max(figures["vented_ms"]["max"] for figures in found.values()) < 400
