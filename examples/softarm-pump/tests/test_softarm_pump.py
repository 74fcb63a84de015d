"""The policy `pump` reaches targets by swinging that no slow command reaches."""

import numpy as np
import pytest
from softarm.daemon.runtime.offline import Lockstep
from softarm.policies import registry
from softarm.policies.base import PolicyError
from softarm.schemas.config import Config
from softarm.schemas.config import Policy as Configured
from softarm.schemas.goals import Goal

TARGETS = [Goal("reach", y, z) for y, z in ((-0.35, 0.6), (-0.2, 0.65), (-0.3, 0.7), (-0.35, 0.8))]


def test_it_reaches_targets_that_the_papers_pid_cannot_reach() -> None:
    reached = {}
    for name in ("pump", "pid"):
        flown = Lockstep(Config(), registry.load(name))
        flights = [flown.fly(target, cart_start_m=0.1) for target in TARGETS]
        assert all(flight.stop is None for flight in flights)
        reached[name] = sum(flight.reached for flight in flights)
    assert reached["pump"] >= 3
    assert reached["pid"] <= 1


def test_it_pushes_against_the_deflection_until_the_swing_is_high_enough() -> None:
    policy, goal = registry.load("pump"), np.array([-0.3, 0.7], np.float32)
    place = np.array([0.06, 0, 0, 0.6, 0, 0, 0, 0], np.float32)
    left, right = place.copy(), place.copy()
    left[2], right[2] = 0.06 - 0.15, 0.06 + 0.15
    assert policy.step(left, goal)[0] > 0.2
    assert policy.step(right, goal)[0] < -0.2
    high = place.copy()
    high[2:4] = 0.06 - 0.4, 0.8
    assert abs(policy.step(high, goal)[0]) < 0.1


def test_an_option_below_zero_is_rejected() -> None:
    odd = {"odd": Configured(plugin="pump", options={"lead_s": -0.1})}
    with pytest.raises(PolicyError, match="lead_s is -0.1; allowed: 0 or more"):
        registry.load("odd", odd)
