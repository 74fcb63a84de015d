"""A policy flown by the daemon's own tick, in lockstep with a robot in this process: one way for all that is flown.

Training's validation flies many at once on the batch simulator: `training/run/validation.py`.
"""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace

from softarm.daemon.control.records import Mode
from softarm.daemon.shell.offline import Lockstep
from softarm.drivers.bodies.simulated import SimulatedBody
from softarm.policies.base import Array, Policy, PolicyError
from softarm.reality.parameters import RobotParameters
from softarm.schemas.config import Config
from softarm.schemas.flights import Flight, Scenario, Swing
from softarm.schemas.goals import Goal
from softarm.schemas.model import Model

Robot = Model | RobotParameters  # the simulator with a model, or the independent robot
NOWHERE = Goal("reach", 0.0, 0.9)  # which no arm reaches


class Heard(Policy):
    """A policy whose refusals are kept: the daemon makes them a fault and stops the arm."""

    def __init__(self, policy: Policy) -> None:
        self.spec = policy.spec
        self.refusal: str | None = None
        self._policy = policy

    def reset(self) -> None:
        """See Policy."""
        self._policy.reset()

    def step(self, observation: Array, goal: Array) -> Array:
        """What the policy wants. Raises what it raises."""
        try:
            return self._policy.step(observation, goal)
        except PolicyError as error:
            self.refusal = str(error)
            raise


class Swung(Policy):
    """A policy that is swung about first: until its second goal, smooth commands stand for it."""

    def __init__(self, policy: Policy, swing: Swing) -> None:
        self.spec = policy.spec
        self._policy, self._swing = policy, swing
        self._goals = self._tick = 0

    def reset(self) -> None:
        """Before each goal: the first one swings."""
        self._goals += 1
        if self._goals > 1:
            self._policy.reset()

    def step(self, observation: Array, goal: Array) -> Array:
        """Sinusoids, or what the policy wants."""
        if self._goals > 1:
            return self._policy.step(observation, goal)
        self._tick += 1
        return self._swing.command(self._tick - 1)


class Runner:
    """Flies scenarios one after another, each robot where its scenario wants it, whatever became of the last.

    Raises RuntimeError when the daemon would not arm. The independent robot needs the extra `mujoco`.
    """

    def __init__(self, policy: Policy, robot: Robot | None = None, config: Config | None = None) -> None:
        """robot: the seed's simulator without one. config: the daemon's; its default values without one."""
        self._policy, self._robot, self._config = policy, robot or Model(), config or Config()
        self._heard = Heard(policy)
        self._shelved = False
        # Compiled and armed before anybody looks at a clock.
        self._waiting = None if isinstance(self._robot, RobotParameters) else self._simulated(self._robot, self._heard)

    def fly(self, scenario: Scenario) -> Flight:
        """One goal, until it is reached or has failed."""
        self._heard.refusal = None
        with _told_depth(self._policy, scenario):
            flight = self.begin(scenario).pursue(scenario.goal)
        return replace(flight, refusal=self._heard.refusal)

    def begin(self, scenario: Scenario) -> Lockstep:
        """The armed daemon of a robot that is where the goal is to find it, swinging or at rest."""
        if scenario.swing is None:
            return self._at_rest(scenario, self._heard)
        daemon = self._at_rest(scenario, Swung(self._heard, scenario.swing))
        daemon.tick(daemon.request("goal", NOWHERE))
        for _ in range(scenario.swing.ticks):
            daemon.tick()
        return daemon

    def _at_rest(self, scenario: Scenario, policy: Policy) -> Lockstep:
        if isinstance(self._robot, RobotParameters):
            return self._independent(self._robot, policy, scenario)
        if policy is not self._heard:
            body, daemon = self._simulated(self._robot, policy)
        else:
            body, daemon = self._ready(self._robot, scenario)
        if scenario.shelf_m is not None:
            body.simulator.place_shelf(*scenario.shelf_m)
        daemon.place(scenario.cart_start_m)
        return daemon

    def _ready(self, model: Model, scenario: Scenario) -> tuple[SimulatedBody, Lockstep]:
        """The simulated robot that flew the last scenario, if it still can; a new one takes no seconds either."""
        shelved, self._shelved = self._shelved, scenario.shelf_m is not None
        if self._waiting is None or not _is_armed(self._waiting[1]) or (shelved and not self._shelved):
            self._waiting = self._simulated(model, self._heard)
        return self._waiting

    def _simulated(self, model: Model, policy: Policy) -> tuple[SimulatedBody, Lockstep]:
        body = SimulatedBody(model)
        daemon = Lockstep(self._config, policy, body=body)
        daemon.arm()
        return body, daemon

    def _independent(self, parameters: RobotParameters, policy: Policy, scenario: Scenario) -> Lockstep:
        """A new one for each scenario: it starts where it is made."""
        from softarm.drivers.bodies.independent import IndependentBody

        start_m, shelf_m = scenario.cart_start_m, scenario.shelf_m
        body = IndependentBody(parameters, scenario.seed, cart_position_m=start_m, shelf_m=shelf_m)
        daemon = Lockstep(self._config, policy, body=body)
        daemon.arm()
        return daemon


def fly(
    policy: Policy, robot: Robot | None, scenarios: Iterable[Scenario], config: Config | None = None
) -> list[Flight]:
    """All scenarios in their order. Raises what a Runner raises."""
    runner = Runner(policy, robot, config)
    return [runner.fly(scenario) for scenario in scenarios]


def _is_armed(daemon: Lockstep) -> bool:
    return daemon.outputs is not None and daemon.outputs.mode is Mode.ARMED


@contextmanager
def _told_depth(policy: Policy, scenario: Scenario) -> Iterator[None]:
    """A policy that asks how deep in its shelf a target lies is told, for this flight."""
    own = getattr(policy, "target_depth_m", None)
    if own is None or scenario.depth_m is None:
        yield
        return
    policy.target_depth_m = scenario.depth_m  # type: ignore[attr-defined]
    try:
        yield
    finally:
        policy.target_depth_m = own  # type: ignore[attr-defined]
