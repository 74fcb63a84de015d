"""Flights of a policy by the real control loop, in lockstep with a robot in this process.

The validation of training instead flies many robots at once: `training/learn/validation.py`.
"""

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TypedDict

from softarm.daemon.control.records import Inputs, Mode, Outputs, TickTiming
from softarm.daemon.runtime.offline import Lockstep
from softarm.drivers.bodies.simulated import SimulatedBody
from softarm.policies import registry
from softarm.policies.base import Array, Policy, PolicyError
from softarm.reality.parameters import RobotParameters
from softarm.schemas import flights
from softarm.schemas.config import Config
from softarm.schemas.config import Policy as ConfiguredPolicy
from softarm.schemas.flights import Flight, Scenario, Swing
from softarm.schemas.goals import Goal
from softarm.schemas.model import Model

Robot = Model | RobotParameters  # the simulator with a model, or the independent robot
Record = Callable[[Inputs, Outputs, TickTiming], None]
PolicyName = Path | str  # an ONNX file, or a name that the registry knows
NOWHERE = Goal("reach", 0.0, 0.9)  # out of reach


class Recorded(Policy):
    """Policy that records its refusals, which the daemon turns into a fault and a stop."""

    def __init__(self, policy: Policy) -> None:
        self.spec = policy.spec
        self.refusal: str | None = None
        self._policy = policy

    def reset(self) -> None:
        """Reset the recorded policy."""
        self._policy.reset()

    def step(self, observation: Array, goal: Array) -> Array:
        """Return the policy's command and record a refusal."""
        try:
            return self._policy.step(observation, goal)
        except PolicyError as error:
            self.refusal = str(error)
            raise


class Swung(Policy):
    """Policy that swings the arm during its first goal and then follows another policy."""

    def __init__(self, policy: Policy, swing: Swing) -> None:
        self.spec = policy.spec
        self._policy, self._swing = policy, swing
        self._goals = self._tick = 0

    def reset(self) -> None:
        """Count the goals; the first one swings."""
        self._goals += 1
        if self._goals > 1:
            self._policy.reset()

    def step(self, observation: Array, goal: Array) -> Array:
        """Return a sinusoid during the first goal, later the policy's command."""
        if self._goals > 1:
            return self._policy.step(observation, goal)
        self._tick += 1
        return self._swing.command(self._tick - 1)


class Runner:
    """Runner of scenarios, one after another; each starts independently of the one before.

    Raises RuntimeError if the control loop refuses to arm. The independent robot needs the extra `mujoco`.
    """

    def __init__(
        self, policy: Policy, robot: Robot | None = None, config: Config | None = None, record: Record | None = None
    ) -> None:
        """Prepare the robot (default: the seed's simulator) and the configuration (default: its default values).

        `record` receives every tick, also those before a flight.
        """
        self._policy, self._robot, self._config, self._record = policy, robot or Model(), config or Config(), record
        self._recorded = Recorded(policy)
        self._shelved = False
        # Compile and arm now, so that timed flights do not include it.
        self._waiting = (
            None if isinstance(self._robot, RobotParameters) else self._simulated(self._robot, self._recorded)
        )

    def fly(self, scenario: Scenario) -> Flight:
        """Fly to one goal until it is reached or has failed."""
        self._recorded.refusal = None
        with _target_depth(self._policy, scenario):
            flight = self.begin(scenario).pursue(scenario.goal)
        return replace(flight, refusal=self._recorded.refusal)

    def begin(self, scenario: Scenario) -> Lockstep:
        """Return the armed control loop of a robot in the scenario's start state, swinging or at rest."""
        if scenario.swing is None:
            return self._at_rest(scenario, self._recorded)
        daemon = self._at_rest(scenario, Swung(self._recorded, scenario.swing))
        daemon.tick(daemon.request("goal", NOWHERE))
        for _ in range(scenario.swing.ticks):
            daemon.tick()
        return daemon

    def _at_rest(self, scenario: Scenario, policy: Policy) -> Lockstep:
        if isinstance(self._robot, RobotParameters):
            return self._independent(self._robot, policy, scenario)
        if policy is not self._recorded:
            body, daemon = self._simulated(self._robot, policy)
        else:
            body, daemon = self._ready(self._robot, scenario)
        if scenario.shelf_m is not None:
            body.simulator.place_shelf(*scenario.shelf_m)
        daemon.place(scenario.cart_start_m)
        return daemon

    def _ready(self, model: Model, scenario: Scenario) -> tuple[SimulatedBody, Lockstep]:
        """Return the simulated robot of the last scenario if it is still armed, or a new one."""
        shelved, self._shelved = self._shelved, scenario.shelf_m is not None
        if self._waiting is None or not _is_armed(self._waiting[1]) or (shelved and not self._shelved):
            self._waiting = self._simulated(model, self._recorded)
        return self._waiting

    def _simulated(self, model: Model, policy: Policy) -> tuple[SimulatedBody, Lockstep]:
        body = SimulatedBody(model)
        daemon = Lockstep(self._config, policy, record=self._record, body=body)
        daemon.arm()
        return body, daemon

    def _independent(self, parameters: RobotParameters, policy: Policy, scenario: Scenario) -> Lockstep:
        """Return a new independent robot, which starts where the scenario says."""
        from softarm.drivers.bodies.independent import IndependentBody

        start_m, shelf_m = scenario.cart_start_m, scenario.shelf_m
        body = IndependentBody(parameters, scenario.seed, cart_position_m=start_m, shelf_m=shelf_m)
        daemon = Lockstep(self._config, policy, record=self._record, body=body)
        daemon.arm()
        return daemon


def fly(
    policy: Policy, robot: Robot | None, scenarios: Iterable[Scenario], config: Config | None = None
) -> list[Flight]:
    """Fly all scenarios in their order. Raises RuntimeError if the control loop refuses to arm."""
    runner = Runner(policy, robot, config)
    return [runner.fly(scenario) for scenario in scenarios]


def load(policy: PolicyName, config: Config | None = None) -> Policy:
    """Load a policy by its ONNX file or by its name, also one of the configuration. Raises PolicyError."""
    if isinstance(policy, str):
        return registry.load(policy, config.policies if config else None)
    return registry.load("flown", {"flown": ConfiguredPolicy(plugin="onnx", options={"model": str(policy)})})


def _is_armed(daemon: Lockstep) -> bool:
    return daemon.outputs is not None and daemon.outputs.mode is Mode.ARMED


@contextmanager
def _target_depth(policy: Policy, scenario: Scenario) -> Iterator[None]:
    """Set the scenario's target depth for this flight, if the policy has one."""
    own = getattr(policy, "target_depth_m", None)
    if own is None or scenario.depth_m is None:
        yield
        return
    policy.target_depth_m = scenario.depth_m  # type: ignore[attr-defined]
    try:
        yield
    finally:
        policy.target_depth_m = own  # type: ignore[attr-defined]


FLIGHTS = len(flights.grid())


class Target(TypedDict):
    """One flight to one target."""

    y: float
    z: float
    start: float
    reached: bool
    time_s: float
    closest_m: float


class Evaluation(TypedDict):
    """The result of one policy, as `softarm evaluate --json` writes it."""

    policy: str
    success: dict[str, float]  # share of flights that reached their target: in_range, above, all
    max_tip_z_m: float
    max_cart_m: float
    real_time_factor: float
    targets: list[Target]


def evaluate(
    name: str,
    config: Config,
    model: Model | None = None,
    on_flight: Callable[[], None] = lambda: None,
    file: Path | None = None,
) -> Evaluation:
    """Fly every target from rest at every cart start.

    Args:
        name: Name of the policy.
        config: Configuration of the control loop.
        model: Model of the simulated robot; None for the seed's.
        on_flight: Called after each flight.
        file: ONNX file of the policy; None for the policy that the registry has under this name.

    Raises:
        PolicyError: The policy cannot be loaded.
        RuntimeError: The control loop refuses to arm.
    """
    policy = load(file or name, config)
    runner, scenarios = Runner(policy, model, config), flights.grid()
    flown: list[Flight] = []
    started = time.perf_counter()
    for scenario in scenarios:
        flown.append(runner.fly(scenario))
        on_flight()
    wall_s = time.perf_counter() - started
    success = flights.shares([flight.reached for flight in flown], flights.heights(scenarios))
    return Evaluation(
        policy=name,
        success=success._asdict(),
        max_tip_z_m=max(flight.max_tip_z_m for flight in flown),
        max_cart_m=max(flight.max_cart_m for flight in flown),
        real_time_factor=sum(flight.ticks for flight in flown) / config.control.rate_hz / wall_s,
        targets=[_target(scenario, flight) for scenario, flight in zip(scenarios, flown, strict=True)],
    )


def _target(scenario: Scenario, flight: Flight) -> Target:
    closest = flight.status.closest_m
    return Target(
        y=scenario.goal.y_m,
        z=scenario.goal.z_m,
        start=scenario.cart_start_m,
        reached=flight.reached,
        time_s=flight.status.time_s,
        closest_m=float("inf") if closest is None else closest,
    )
