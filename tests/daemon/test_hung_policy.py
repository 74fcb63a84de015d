"""A trusted policy that never returns hangs the control loop: devices, stop port and latch do not need the loop."""

import threading

import httpx
import numpy as np
import pytest
from anyio.from_thread import start_blocking_portal

from softarm.daemon.assembly import Daemon
from softarm.daemon.config.configuration import latch_path, load
from softarm.daemon.control.records import Mode
from softarm.daemon.runtime.devices import real_devices
from softarm.daemon.stop import latch
from softarm.daemon.stop.kept import HUNG
from softarm.drivers.bodies.simulated import SimulatedBody
from softarm.drivers.twin.main import Twin
from softarm.evaluation.software_in_the_loop import SoftwareInTheLoop
from softarm.policies import trusted
from softarm.policies.base import Policy, PolicySpec
from softarm.policies.runner import InlineRunner
from softarm.schemas.goals import Goal
from tests.daemon.rig import BUSY_MACHINE
from tests.processes import until


class Stuck(Policy):
    """Policy that moves the cart and fills the muscle, and then waits like an endless computation in C."""

    spec = PolicySpec("stuck", "hangs while the cart moves", needs_target=False)

    def __init__(self):
        self.steps, self.hangs, self.let_go = 0, threading.Event(), threading.Event()

    def step(self, observation, goal):
        self.steps += 1
        if self.steps == 15:
            self.hangs.set()
            self.let_go.wait()
        return np.array([0.3, 5.0], dtype=np.float32)


@pytest.fixture
def twin(tmp_path):
    """Return a robot behind the wires and the configuration of its daemon."""
    tolerant = BUSY_MACHINE | {"rail_stale_s": 0.5, "arming_frames": 1}
    overrides = {"control": {"realtime_priority": 0}, "failsafe": tolerant}
    sil = SoftwareInTheLoop(tmp_path / "logs", overrides)
    config = load(sil.config_file)
    try:
        with start_blocking_portal() as portal:
            robot = Twin(config, body=SimulatedBody())
            with portal.wrap_async_context_manager(robot):
                yield robot, config
    finally:
        sil.__exit__(None, None, None)


@pytest.mark.slow
def test_while_a_trusted_policy_hangs_the_devices_are_safe_and_a_stop_is_kept(twin, monkeypatch):
    robot, config = twin
    monkeypatch.setattr(trusted, "is_trusted", lambda policy, budget_s: True)
    policy = Stuck()
    with Daemon(config, real_devices(config), policy) as daemon:

        def snapshot():
            until(lambda: daemon.loop.snapshot)
            return daemon.loop.snapshot

        def kept():
            return latch.decoded(latch_path(config).read_bytes()).reason

        assert isinstance(trusted.runner(policy, 0.02), InlineRunner)
        while not policy.hangs.wait(0.2):  # again after a stop that a busy machine has caused
            kind = {Mode.ARMED: "goal", Mode.STOPPED: "acknowledge"}.get(snapshot().mode, "arm")
            if snapshot().goal.state != "running":
                daemon.inbox.post(kind, goal=Goal("run"))
        before = snapshot()
        until(lambda: robot.state.vented and robot.state.braked_since_ns and robot.state.drive != "operation enabled")
        answer = httpx.post(daemon.stop_url)
        assert answer.status_code == 503
        assert "use the emergency-stop button" in answer.text
        until(kept)
        assert kept() == HUNG  # a daemon that the watchdog starts again is stopped
        assert snapshot() is before  # all of this happened without the loop
        policy.let_go.set()
        until(lambda: snapshot().mode is Mode.STOPPED)
        assert not snapshot().sent.enable
