"""Lockstep of the control tick with a robot in this process, faster than real time."""

from collections.abc import Callable
from itertools import count

from softarm.daemon.control.records import Inputs, Mode, Outputs, Request, RequestKind, TickTiming
from softarm.daemon.tick import Controller
from softarm.drivers.bodies.base import Body
from softarm.drivers.bodies.in_process import InProcessRobot
from softarm.drivers.bodies.simulated import SimulatedBody
from softarm.policies.base import Policy
from softarm.policies.runner import InlineRunner
from softarm.schemas.config import Config
from softarm.schemas.flights import Flight
from softarm.schemas.goals import Goal
from softarm.schemas.model import Model

SETTLED_NS = 1_000_000_000  # jump in time when the robot is placed; no difference is taken across it


class Lockstep:
    """A controller and a robot that share a virtual time."""

    def __init__(
        self,
        config: Config,
        policy: Policy,
        model: Model | None = None,
        record: Callable[[Inputs, Outputs, TickTiming], None] | None = None,
        body: Body | None = None,
    ) -> None:
        self.config = config
        self.robot = InProcessRobot(body or SimulatedBody(model), hold_s=config.drivers.rail.hold_s)
        self.controller = Controller(config, InlineRunner(policy))
        self.outputs: Outputs | None = None
        self._record = record
        self._rate_hz = config.control.rate_hz
        self._begun_ns = self.robot.now_ns  # the ticks count from here
        self._ticks = self._skipped = 0
        self._numbers = count(1)

    def request(self, kind: RequestKind, goal: Goal | None = None) -> Request:
        """Return a request with the next number, as from the inbox."""
        return Request(next(self._numbers), kind, goal)

    def tick(self, *requests: Request) -> Outputs:
        """Advance by one period and run one tick."""
        self._ticks += 1
        now_ns, robot = self._instant_ns(self._ticks), self.robot
        inputs = Inputs(
            t_ns=now_ns,
            mocap=robot.mocap.read(now_ns),
            pressure=robot.regulator.read(),
            rail=robot.rail.read(),
            requests=requests,
            missed=self._skipped,
        )
        self._skipped = 0
        outputs = self.controller.tick(inputs)
        robot.rail.write(outputs.sent.enable, outputs.sent.cart_velocity_m_s)
        robot.regulator.write(outputs.sent.enable, outputs.sent.pressure_kpa)
        if self._record is not None:
            self._record(inputs, outputs, TickTiming(0, 0, 0, 0))
        self.outputs = outputs
        return outputs

    def skip(self, ticks: int) -> None:
        """Skip ticks before the next one, like a delayed loop."""
        self._ticks += ticks
        self._skipped += ticks

    def arm(self) -> Outputs:
        """Wait for the sensors, arm, and wait until the robot is armed; raise RuntimeError with the refusals."""
        for _ in range(self.config.failsafe.arming_frames):
            self.tick()
        outputs = self.tick(self.request("arm"))
        ticks = round(self.config.failsafe.arming_timeout_s * self.config.control.rate_hz)
        for _ in range(ticks):
            if outputs.mode is Mode.ARMED:
                return outputs
            outputs = self.tick()
        reasons = [reason for result in outputs.results for reason in result.reasons]
        raise RuntimeError("did not arm: " + "; ".join(reasons))

    def place(self, cart_position_m: float) -> None:
        """Place the armed robot with its arm straight and at rest; raise PlacementError if its body cannot move."""
        self.robot.body.place(cart_position_m)
        self._begun_ns += SETTLED_NS
        self.robot.regulator.write(True, 0.0)
        self.robot.rail.write(True, 0.0)
        # The next tick sees this instant: nothing moves before the goal starts.
        self.robot.now_ns = self._instant_ns(self._ticks + 1)

    def fly(self, goal: Goal, cart_start_m: float) -> Flight:
        """Run one goal from rest until it is reached or has failed."""
        if self.outputs is None or self.outputs.mode is not Mode.ARMED:
            self.arm()
        self.place(cart_start_m)
        return self.pursue(goal)

    def pursue(self, goal: Goal) -> Flight:
        """Run one goal from the current state of the armed robot until it is reached or has failed."""
        outputs = self.tick(self.request("goal", goal))
        top = farthest = 0.0
        ticks = 1
        while True:
            farthest = max(farthest, abs(self.robot.body.truth.cart_position_m))
            if outputs.observed is not None:
                top = max(top, outputs.observed.values.tip_z_m)
            if outputs.goal.state != "running":
                stop = None if outputs.mode is Mode.ARMED else outputs.last_stop
                return Flight(outputs.goal, top, farthest, ticks, stop=stop)
            outputs = self.tick()
            ticks += 1

    def _instant_ns(self, tick: int) -> int:
        """Return the time of a tick, computed from its number so that rounding does not accumulate."""
        return self._begun_ns + round(tick * 1e9 / self._rate_hz)
