"""A stop is answered in time while the API is under attack: a small run over a real daemon."""

import pytest

from validation import stop


# Over 3 s: the crowd of clients takes seconds to connect.
@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.timeout(170)
@pytest.mark.parametrize(
    "attacks",
    [
        pytest.param([f"{stop.CLIENTS} idle clients"], id="smoke"),
        pytest.param(list(stop.ATTACKS), id="all", marks=pytest.mark.prove),
    ],
)
def test_the_stop_port_answers_under_attack(attacks, monkeypatch):
    if len(attacks) == 1:
        monkeypatch.setattr(stop, "WARM_UP_S", 0.5)
    found = stop.run(5, attacks, lambda share: None)
    assert {name: ways["stop"]["unanswered"] for name, ways in found.items()} == dict.fromkeys(attacks, 0)
    late = {name: ways["stop"] for name, ways in found.items() if ways["stop"]["p50"] > 50}
    assert late == {}
