import pytest

from softarm.evaluation import runner
from softarm.schemas import flights
from softarm.schemas.config import Config

pytestmark = pytest.mark.slow


@pytest.fixture(params=[6, pytest.param(1, marks=pytest.mark.prove)], ids=["every second target", "every start"])
def starts(request, monkeypatch):
    """Fly every second target from one cart start, or each from every start."""
    flown = flights.grid()[:: request.param]
    monkeypatch.setattr(flights, "grid", lambda: flown)


@pytest.mark.usefixtures("starts")
def test_the_shipped_policy_reaches_the_papers_level_in_the_control_loop():
    """[P]: 94 % in range, 50 % above, 80 % in all."""
    reach = runner.evaluate("reach", Config())
    assert reach["success"]["in_range"] >= 0.94
    assert reach["success"]["above"] >= 0.50
    assert reach["success"]["all"] >= 0.80
    assert reach["max_cart_m"] <= 0.25
    assert set(reach) >= {"policy", "max_tip_z_m", "real_time_factor"}
    assert len(reach["targets"]) == len(flights.grid())
    assert set(reach["targets"][0]) == {"y", "z", "start", "reached", "time_s", "closest_m"}


@pytest.mark.usefixtures("starts")
def test_the_wide_policy_reaches_nine_of_ten():
    success = runner.evaluate("reach-wide", Config())["success"]
    assert success["in_range"] >= 0.97
    assert success["above"] >= 0.75
    assert success["all"] >= 0.90


@pytest.mark.prove
@pytest.mark.usefixtures("starts")
def test_pid_reaches_few_targets():
    """[P] SM-I: 17 %, never above z = 0.56 m."""
    result = runner.evaluate("pid", Config())
    assert 0.05 <= result["success"]["all"] <= 0.25
    assert result["max_tip_z_m"] <= 0.56
