"""Controller with readings of a robot at rest, for tests of the control tick."""

import dataclasses

import numpy as np

from softarm.daemon.control.records import Inputs, Mode, Request
from softarm.daemon.tick import Controller
from softarm.policies.base import Policy, PolicySpec
from softarm.policies.runner import InlineRunner
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal
from softarm.schemas.messages import MocapFrame, Pose, PressureReading, RailReading

PERIOD_NS = 33_333_333
# Failsafe settings for a busy machine, which skips ticks: they must neither refuse a request nor stop the arm.
BUSY_MACHINE = {"missed_ticks_max": 30} | dict.fromkeys(("mocap_stale_s", "pressure_stale_s", "rail_stale_s"), 1.0)


STEADY = PolicySpec("steady", "for tests")


class Steady:
    """Policy with a constant action, or error, that records its observations."""

    def __init__(self, action=(0.2, 5.0), spec=STEADY):
        self.spec = spec
        self.action = np.array(action, dtype=np.float32) if isinstance(action, tuple) else action
        self.seen, self.resets = [], 0

    def reset(self):
        self.resets += 1

    def step(self, observation, goal):
        self.seen.append((observation.copy(), goal.copy()))
        if isinstance(self.action, Exception):
            raise self.action
        return self.action


class BangBang(Policy):
    """Policy with the hardest possible commands, which change at random."""

    spec = PolicySpec("bang-bang", "as hard as commands go")

    def __init__(self, seed):
        self._rng, self._action = np.random.default_rng(seed), np.zeros(2, dtype=np.float32)

    def step(self, observation, goal):
        if self._rng.random() < 0.2:
            self._action = np.array((self._rng.choice((-1.0, 1.0)), self._rng.choice((-0.7, 20.0))), dtype=np.float32)
        return self._action


class Rig:
    """Controller with readings of a robot at rest, any of which a test can change."""

    def __init__(self, policy=None, config=None, frames=4):
        self.policy = policy or Steady()
        self.controller = Controller(config or Config(), InlineRunner(self.policy))
        self.frames = frames  # of a tick
        self.now = 0
        self.number = 0
        self.sequence = 0
        self.tip = (0.0, 0.52)
        self.cart = 0.0
        self.tip_tracked = True
        self.ahead_ns = 0  # of the cameras' clock
        self.on = False
        self.outputs = None

    def inputs(self, *kinds, goal=None, **changes):
        """Return the inputs of the next tick; a change that is a mapping changes fields of the fresh reading."""
        self.now += PERIOD_NS
        frames = []
        for ago in reversed(range(self.frames)):
            self.sequence += 1
            noise_m = 1e-5 * (self.sequence % 2)  # of cameras
            tip = Pose(self.tip[0] + noise_m, self.tip[1], 0.0, self.tip_tracked)
            bodies = (Pose(self.cart, 0.965, 0.0), *[Pose(self.cart, 0.7, 0.0)] * 4, tip)
            stamp = self.now - (ago + 1) * 8_000_000 + self.ahead_ns
            frames.append(MocapFrame(self.sequence, stamp, self.now, bodies))
        requests = []
        for kind in kinds:
            self.number += 1
            requests.append(Request(self.number, kind, goal))
        fresh = Inputs(
            t_ns=self.now,
            mocap=tuple(frames),
            pressure=PressureReading(self.now, 0.0, self.on),
            rail=RailReading(self.now, self.cart, 0.0, self.on),
            requests=tuple(requests),
        )
        for name, change in changes.items():
            if isinstance(change, dict):
                changes[name] = dataclasses.replace(getattr(fresh, name), **change)
        return dataclasses.replace(fresh, **changes)

    def tick(self, *kinds, goal=None, runners=None, **changes):
        self.outputs = self.controller.tick(self.inputs(*kinds, goal=goal, **changes), runners)
        self.on = self.outputs.sent.enable
        return self.outputs

    def ticks(self, count, **changes):
        for _ in range(count):
            self.tick(**changes)
        return self

    def armed(self):
        self.ticks(30).tick("arm")
        self.tick()
        assert self.outputs.mode is Mode.ARMED
        return self

    def swinging(self):
        self.armed().tick("goal", goal=Goal("reach", -0.2, 0.6))
        assert self.outputs.action is not None
        return self

    def reasons(self):
        return " ".join(self.outputs.results[-1].reasons)
