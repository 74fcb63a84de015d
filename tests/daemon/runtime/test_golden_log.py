"""Replay of the recorded flight `tests/data/flight.mcap`, bit for bit.

In it: arming, a goal reached, a goal in mid-swing, a refusal, a cancelled goal, the safety filter at the rail's end, a
stop and its acknowledgement, a change of policy. `tests/data/record_flight.py` says how it was made, and when to make a
new one.
"""

from pathlib import Path

import numpy as np
import pytest

from softarm.daemon.logbook import logs
from softarm.daemon.runtime.replay import replay
from softarm.policies import registry
from softarm.policies.base import Policy

FLIGHT = Path(__file__).parents[2] / "data" / "flight.mcap"
ROUNDING = 1e-5  # of m/s and kPa: what another processor's order of summing costs a float32 network


@pytest.fixture(scope="module")
def log():
    return logs.read(FLIGHT)


class AsRecorded(Policy):
    """Policy that repeats recorded actions; another test covers its arithmetic."""

    def __init__(self, policy, actions):
        self.spec, self._actions = policy.spec, actions

    def step(self, observation, goal):
        return np.array(next(self._actions), dtype=np.float32)


def test_every_tick_comes_out_as_recorded_bit_for_bit(log):
    actions = (outputs.action for _, outputs in log.ticks() if outputs.action is not None)
    replayed = replay(log.ticks(), log.config, lambda name: AsRecorded(registry.load(name), actions))
    assert replayed.compared == replayed.ticks == len(list(log.ticks())) > 300
    assert replayed.differences == []
    assert next(actions, None) is None


def test_the_shipped_policies_still_fly_it(log):
    for difference in replay(log.ticks(), log.config, registry.load).differences:
        assert difference.field in ("action", "sent", "observed")
        assert numbers(difference.replayed) == pytest.approx(numbers(difference.recorded), abs=ROUNDING)


def numbers(record):
    return list(record if isinstance(record, tuple) else record.values)


def test_the_recorded_flight_covers_its_cases(log):
    assert FLIGHT.stat().st_size < 1_000_000
    assert [policy["name"] for policy in log.policies] == ["reach", "pid"]
    outputs = [made for _, made in log.ticks()]
    assert sum("rail_position_max" in tick.clamps for tick in outputs) > 20
    assert {tick.goal.state for tick in outputs} == {"none", "running", "reached", "failed"}
    assert {tick.mode for tick in outputs} == {"disarmed", "arming", "armed", "stopping", "stopped"}
