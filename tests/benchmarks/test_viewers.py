"""The benchmark with people who watch, for a moment: they see every tick, and what is measured is there."""

import pytest

from softarm.benchmarks import viewers


@pytest.mark.slow
@pytest.mark.realtime
def test_viewers_see_every_tick_and_all_turns_are_measured():
    told = []
    result = viewers.run(seconds=2.0, turns=1, viewers=3, report=told.append)
    assert told == [1.0]
    alone, viewed = result["alone"], result["viewed"]
    assert (alone["stream_hz"], alone["recent_ms"], alone["viewers_cpu"]) == (None, None, 0)
    assert viewed["stream_hz"] == pytest.approx(30.0, rel=0.2)
    assert viewed["recent_bytes"] > 1000
    for part in (alone, viewed):
        assert 30 < part["ticks"] + part["missed_ticks"] < 100
        assert part["policy_ticks"] > 0
        assert 0 < part["daemon_cpu"] < 4
    assert set(result["ratio"]) == {"lateness_p50", "lateness_p99", "lateness_max", "daemon_cpu"}
