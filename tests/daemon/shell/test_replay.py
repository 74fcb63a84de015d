"""A log replayed through the tick gives the same commands, bit for bit."""

import dataclasses

import pytest

from softarm.daemon.logbook import logs
from softarm.daemon.logbook.recorder import Recorder
from softarm.daemon.shell.offline import Lockstep
from softarm.daemon.shell.replay import replay
from softarm.policies import registry
from softarm.schemas.config import Config
from softarm.schemas.config import Recorder as RecorderConfig
from softarm.schemas.goals import Goal

POLICY = "reach"


@pytest.fixture
def log(tmp_path):
    """Two goals, a new one in mid-swing, an emergency stop and its acknowledgement."""
    config = Config(recorder=RecorderConfig(directory=tmp_path))
    policy = registry.load(POLICY)
    recorder = Recorder(config, policy.spec)
    recorder.start()
    daemon = Lockstep(config, policy, recorder=recorder)
    daemon.arm()
    for goal in (Goal("reach", -0.3, 0.6), Goal("reach", -0.1, 0.65)):
        daemon.tick(daemon.request("goal", goal))
        for _ in range(20):
            daemon.tick()
    for kind in ("stop", "acknowledge", "arm"):
        daemon.tick(daemon.request(kind))
        daemon.tick()
    recorder.stop()
    return logs.read(recorder.path)


def test_every_tick_comes_out_as_recorded(log):
    ticks, differences = replay(log.ticks(), log.config, registry.load)
    assert ticks == len(list(log.ticks())) > 70
    assert differences == []


def test_a_changed_command_is_found(log):
    """The comparison can fail: one recorded command is off by one part in ten million."""
    ticks = list(log.ticks())
    moving = next(i for i, (_, outputs) in enumerate(ticks) if outputs.sent.cart_velocity_m_s)
    inputs, outputs = ticks[moving]
    sent = outputs.sent._replace(cart_velocity_m_s=outputs.sent.cart_velocity_m_s * (1 + 1e-7))
    ticks[moving] = (inputs, dataclasses.replace(outputs, sent=sent))
    _, differences = replay(ticks, log.config, registry.load)
    assert [d.field for d in differences] == ["sent"]
