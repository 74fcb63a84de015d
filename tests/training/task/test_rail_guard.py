"""The batch clamp that policies train with is the daemon's own, and brakes before the rail's ends."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softarm.daemon.control.safety import SafetyFilter
from softarm.schemas.config import DryveRail, Limits, RailLimits
from softarm.schemas.messages import Command, RailReading
from softarm.simulator.simulator import Simulator
from softarm.training.task.rail_guard import RailGuard
from softarm.training.task.reach import ReachTask

PERIOD_S = 1 / 30
# On a grid: a cart that is dragged by a hair less than 0.1 m/s counts as dragged, one by 0.1 m/s does not, and float32
# knows no such hairs.
STEP = 1 / 1024
velocities, positions = (st.integers(-end, end).map(lambda n: n * STEP) for end in (1536, 320))
states = st.tuples(velocities, positions, velocities)


@settings(max_examples=100)
@given(st.lists(states, min_size=1, max_size=6), st.sampled_from([0.0, 0.02, PERIOD_S, 0.05, 0.1]))
def test_the_guard_sends_the_commands_of_the_daemons_filter(
    steps: list[tuple[float, float, float]], latency_s: float
) -> None:
    """Whatever the latency: the commands of as many ticks are remembered."""
    limits = RailLimits(latency_s=latency_s)
    guard = RailGuard(1, PERIOD_S, limits)
    daemon = SafetyFilter(Limits(rail=limits), PERIOD_S, DryveRail().hold_s)
    for tick, (wanted, position, velocity) in enumerate(steps):
        sent = guard.apply(*(np.array([x], dtype=np.float32) for x in (wanted, position, velocity)))
        t_ns = round(tick * 1e9 / 30)
        passed = daemon.apply(Command(True, wanted, 0.0), RailReading(t_ns, position, velocity, True), t_ns)
        expected = passed.command.cart_velocity_m_s
        # A bisection of 2 m/s in 12 halvings may take one comparison differently in float32.
        assert sent[0] == pytest.approx(expected, abs=1e-3)
        guard.replace(np.array([expected], dtype=np.float32))  # keep the histories the same


def test_hard_swings_stay_on_the_rail_within_millimetres() -> None:
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


def test_a_restarted_robot_has_zero_as_earlier_command() -> None:
    def sent(position: float) -> list[float]:
        at = np.full(2, position, dtype=np.float32)
        return guard.apply(np.ones(2, dtype=np.float32), at, np.zeros(2, dtype=np.float32)).tolist()

    guard = RailGuard(2, PERIOD_S, RailLimits(latency_s=0.1))
    for _ in range(6):
        sent(-0.2)
    guard.reset(np.array([True, False]))
    new, old = sent(0.1)
    assert new == RailGuard(1, PERIOD_S, RailLimits(latency_s=0.1)).apply(*np.float32([[1.0], [0.1], [0.0]]))[0]
    assert old < new


def test_a_task_keeps_every_rail_limit_of_the_clamp() -> None:
    limits = RailLimits(
        position_min_m=-0.1,
        position_max_m=0.15,
        velocity_max_m_s=0.5,
        surge_m_s2=9.0,
        braking_m_s2=3.0,
        latency_s=0.05,
        drag_m_s=0.1,
        margin_m=0.03,
    )
    assert ReachTask().under(limits).rail_limits == limits
    assert ReachTask().rail_limits == RailLimits()
