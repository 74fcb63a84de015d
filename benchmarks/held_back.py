"""A policy on the independent robot of `reality/`, which no simulator of ours was made from.

The robots in CHANGED differ from what every policy but a robust one was trained for.
"""

from dataclasses import replace

from daemon.evaluation import LIMIT_M
from daemon.records import Inputs, Mode, Outputs, Request
from daemon.tick import Controller
from policies.base import Policy
from policies.runner import InlineRunner
from reality.parameters import Arm, Parameters, Rail, Regulator
from reality.robot import Robot
from schemas.config import Config
from schemas.goals import Goal
from schemas.messages import PressureReading, RailReading
from simulator.effects import exemplars

ARMING_TICKS = 60
# As strong as the registry's examples: 50 g at the tip, a regulator that takes half as long again, a drive that hears
# half a tick later.
_STRONG = exemplars()
PAYLOAD = Arm(payload_kg=_STRONG["arm.payload"]["mass"])
SLOW = Regulator(inflate_s=_STRONG["pressure.lag"]["inflate"], deflate_s=_STRONG["pressure.lag"]["deflate"])
LATE = Rail(delay_s=_STRONG["rail.delay"]["delay"])
CHANGED = {
    "nominal": Parameters(),
    "payload": Parameters(arm=PAYLOAD),
    "slow": Parameters(regulator=SLOW),
    "late": Parameters(rail=LATE),
    "changed": Parameters(arm=PAYLOAD, regulator=SLOW, rail=LATE),
}


class Flight:
    """The daemon's controller on one independent robot, for one goal."""

    def __init__(self, policy: Policy, robot: Robot) -> None:
        config = Config()
        self.robot = robot
        self.farthest_cart_m = 0.0
        self._controller = Controller(config, InlineRunner(policy))
        self._rate_hz = config.control.rate_hz
        self._ticks = 0
        self._pressure: PressureReading | None = None
        self._rail: RailReading | None = None
        self._armed = False

    def reach(self, goal: Goal) -> bool:
        """Arm, take up the goal, fly to its end; True when it was reached within the rail's limit."""
        for _ in range(ARMING_TICKS):
            outputs = self._tick()
        outputs = self._tick(Request(1, "arm"))
        while outputs.mode is not Mode.ARMED:
            if self._ticks > 3 * ARMING_TICKS:
                raise RuntimeError(f"did not arm: {outputs.results}")
            outputs = self._tick()
        self.farthest_cart_m = 0.0
        outputs = self._tick(Request(2, "goal", goal))
        while outputs.goal.state == "running":
            outputs = self._tick()
        return outputs.goal.state == "reached" and self.farthest_cart_m <= LIMIT_M

    def _tick(self, *requests: Request) -> Outputs:
        self._ticks += 1
        now_s = self._ticks / self._rate_hz
        self.robot.advance(now_s)
        for reading in self.robot.pressure():
            self._pressure = replace(reading, armed=self._armed)
        for position in self.robot.rail():
            self._rail = replace(position, enabled=self._armed)
        frames = tuple(self.robot.mocap())
        outputs = self._controller.tick(
            Inputs(round(now_s * 1e9), mocap=frames, pressure=self._pressure, rail=self._rail, requests=requests)
        )
        self.farthest_cart_m = max(self.farthest_cart_m, abs(self.robot.truth.cart_position_m))
        sent, self._armed = outputs.sent, outputs.sent.enable
        velocity, pressure = (sent.cart_velocity_m_s, sent.pressure_kpa) if sent.enable else (0.0, 0.0)
        self.robot.command(now_s, velocity, pressure)
        return outputs
