"""The batch clamp that policies train with is the daemon's own, and brakes before the rail's ends."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softarm.daemon.control.safety import CartState, SafetyFilter
from softarm.schemas.config import Limits, RailLimits
from softarm.schemas.messages import Command
from softarm.simulator.simulator import Simulator
from softarm.training.task.rail_guard import RailGuard

PERIOD_S = 1 / 30
states = st.tuples(st.floats(-1.5, 1.5, width=32), st.floats(-0.3125, 0.3125, width=32), st.floats(-1.5, 1.5, width=32))


@settings(max_examples=200, deadline=None)
@given(st.lists(states, min_size=1, max_size=6))
def test_it_sends_what_the_daemons_filter_sends(steps: list[tuple[float, float, float]]) -> None:
    guard = RailGuard(1, PERIOD_S)
    daemon = SafetyFilter(Limits(), PERIOD_S, drive_ramp_m_s2=6.0)
    for wanted, position, velocity in steps:
        sent = guard.apply(*(np.array([x], dtype=np.float32) for x in (wanted, position, velocity)))
        expected = daemon.apply(Command(True, wanted, 0.0), CartState(position, velocity)).command.cart_velocity_m_s
        # A bisection of 2 m/s in 12 halvings may take one comparison differently in float32.
        assert sent[0] == pytest.approx(expected, abs=1e-3)
        guard.sent_m_s[:] = daemon._sent_velocity  # keep the histories the same


def test_hard_swings_stay_on_the_rail_but_for_millimetres() -> None:
    robots = 256
    simulator, guard = Simulator(robots=robots, physics_rate_hz=240), RailGuard(robots, PERIOD_S)
    rng = np.random.default_rng(3)
    farthest = 0.0
    for _ in range(25):
        velocity = rng.choice([-1.0, 1.0], robots).astype(np.float32)
        pressure = rng.choice([-0.7, 20.0], robots)
        for _ in range(6):
            sent = guard.apply(velocity, simulator.cart_position_m, simulator.cart_velocity_m_s)
            simulator.step(sent, pressure)
            farthest = max(farthest, float(np.abs(simulator.cart_position_m).max()))
    # The law counts on the arm pulling with what `RailLimits` says; the worst swings pull a little harder.
    assert 0.2 < farthest < RailLimits().position_max_m + 0.005


def test_a_latency_beyond_a_tick_is_refused() -> None:
    with pytest.raises(ValueError, match="one period"):
        RailGuard(1, PERIOD_S, RailLimits(latency_s=0.05))
