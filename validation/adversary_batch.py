"""Malicious policies against the braking law, many robots at once: random, bang-bang, periodic, and a search.

A world is a robot together with the age of its readings and the skipped ticks; each robot of a world runs a policy of
its own. The law that bounds the commands is the safety filter's, with the inputs that the filter would have.
"""

from collections import deque
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from softarm.schemas.config import DryveRail, RailLimits
from softarm.schemas.model import Model
from softarm.schemas.robot import CONTROL_PERIOD_S, PRESSURE_MAX_KPA, PRESSURE_MIN_KPA, RAIL_LIMIT_M
from softarm.simulator.simulator import Simulator

Array = NDArray[np.float64]
Rng = np.random.Generator

LOOK_S = 0.0085  # sampling interval of the cart
PHYSICS_HZ = 480.0
HOLD_S = DryveRail().hold_s
REMEMBERED_S = 0.8
KINDS = ("random", "bang-bang", "periodic", "with the swing", "against the swing")
STOP_FROM_M_S = 0.15  # slower stops say little about the brake
MEASURED_TICKS, GENERATIONS, FLOWN_TICKS = 150, 4, 200
PARENTS = 0.1  # share of a generation
PATCHED = ("braking_m_s2", "surge_m_s2", "latency_s", "drag_m_s")  # keys of limits.rail set to the measurements
CAUTION = 0.8  # of the worst measured stop; more stops would show a slightly worse one


@dataclass(frozen=True)
class World:
    """Robot, and the delays with which the daemon observes it."""

    ramp_m_s2: float
    latency_s: float
    payload_kg: float
    age_s: float
    skips: float  # share of ticks followed by skipped ones
    skipped_max: int

    @classmethod
    def draw(cls, rng: Rng) -> "World":
        """Draw a world within the promised range."""
        return cls(
            ramp_m_s2=round(rng.uniform(2.0, 8.0), 2),
            latency_s=round(rng.uniform(0.005, 0.1), 4),
            payload_kg=round(rng.uniform(0.0, 0.1), 3),
            age_s=round(rng.uniform(0.0, 0.15), 4),
            skips=float(rng.choice([0.0, 0.05, 0.2])),
            skipped_max=int(rng.integers(1, 5)),
        )

    @property
    def model(self) -> Model:
        """Return the model of the robot."""
        seed = Model()
        effects = {
            **seed.effects,
            "rail.acceleration_limit": {"acceleration": self.ramp_m_s2},
            "rail.delay": {"delay": self.latency_s},
            "arm.payload": {"mass": self.payload_kg},
        }
        return seed.model_copy(update={"effects": effects})


class Genes(NamedTuple):
    """Parameters of periodic policies, each of shape [R]."""

    rate_hz: Array
    pressure_rate: Array  # of the pressure
    phase: Array
    speed: Array
    duty: Array
    pressure_duty: Array

    @classmethod
    def draw(cls, rng: Rng, robots: int) -> "Genes":
        """Draw parameters at random."""
        return cls(
            rng.uniform(0.4, 3.0, robots),
            rng.choice([0.5, 1.0, 1.0, 1.0, 2.0], robots),
            rng.random(robots),
            rng.uniform(0.4, 1.0, robots),
            rng.uniform(0.3, 0.7, robots),
            rng.uniform(0.3, 0.7, robots),
        )

    def bred(self, farthest_m: Array, rng: Rng) -> "Genes":
        """Return the next generation, drawn near the parents that came farthest."""
        robots = len(farthest_m)
        best = np.argsort(-farthest_m)[: max(1, round(PARENTS * robots))]
        spread = (0.03, 0.0, 0.05, 0.05, 0.03, 0.05)
        chosen = rng.choice(best, robots)
        rate, ratio, phase, speed, duty, pressure_duty = (
            genes[chosen] + width * rng.standard_normal(robots) for genes, width in zip(self, spread, strict=True)
        )
        rate, speed = np.clip(rate, 0.2, 4.0), np.clip(speed, 0.2, 1.0)
        return Genes(rate, ratio, phase, speed, np.clip(duty, 0.1, 0.9), np.clip(pressure_duty, 0.1, 0.9))


class Policies:
    """One policy per robot, of all kinds in turn; all periodic if `genes` is given."""

    def __init__(self, robots: int, rng: Rng, genes: Genes | None = None) -> None:
        self._rng, self._robots = rng, robots
        self.kind = np.full(robots, 2) if genes is not None else np.arange(robots) % len(KINDS)
        self._genes = Genes.draw(rng, robots) if genes is None else genes
        self._turn_at_m = rng.uniform(0.0, 0.24, robots)
        self._fickle = rng.uniform(0.05, 0.5, robots)
        self._velocity, self._pressure = np.ones(robots), np.zeros(robots)
        self._t_s = 0.0

    def act(self, position_m: Array, tip_vy_m_s: Array) -> tuple[Array, Array]:
        """Return the requested velocities in m/s and pressures in kPa, each of shape [R]."""
        rng, robots = self._rng, self._robots
        self._t_s += CONTROL_PERIOD_S
        renewed = rng.random(robots) < self._fickle
        drawn = np.where(rng.random(robots) < 0.7, rng.choice([-1.0, 1.0], robots), rng.uniform(-1, 1, robots))
        to_and_fro = np.where(position_m > self._turn_at_m, -1.0, np.sign(self._velocity) + (self._velocity == 0))
        to_and_fro = np.where(position_m < -self._turn_at_m, 1.0, to_and_fro)
        genes = self._genes
        turn = genes.rate_hz * self._t_s
        wave = np.where(turn % 1 < genes.duty, 1.0, -1.0) * genes.speed
        pushed = (genes.pressure_rate * turn + genes.phase) % 1 < genes.pressure_duty
        swing = np.sign(tip_vy_m_s)
        choices = (np.where(renewed, drawn, self._velocity), to_and_fro, wave, swing, -swing)
        self._velocity = np.choose(self.kind, choices)
        random_push = np.where(renewed, rng.random(robots) < 0.5, self._pressure > 0)
        on = np.choose(self.kind, (random_push, pushed, pushed, swing < 0, swing < 0))
        self._pressure = np.where(on, PRESSURE_MAX_KPA, PRESSURE_MIN_KPA)
        return self._velocity, self._pressure


class Flown(NamedTuple):
    """Result of a batch of flights."""

    farthest_m: Array  # [R]
    clamped: float  # share of clamped commands
    braking_m_s2: float  # lowest mean over a whole stop
    surge_m_s2: float  # highest mean over a tick
    drag_m_s: float  # largest speed above every command that may have acted unobserved


class Batch:
    """Robots of a world, each with a policy of its own; their readings are `age_s` old."""

    def __init__(self, world: World, limits: RailLimits, policies: Policies, rng: Rng) -> None:
        robots = len(policies.kind)
        self._world, self._policies, self._rng = world, policies, rng
        self._law = limits.braking_law(HOLD_S)
        self._simulator = Simulator(world.model, robots=robots, physics_rate_hz=PHYSICS_HZ)
        self._simulator.reset(cart_position_m=rng.uniform(-0.2, 0.2, robots))
        self._t_s = 0.0
        self._seen: deque[tuple[float, Array, Array]] = deque()  # time, position, velocity
        self._sent: deque[tuple[float, Array]] = deque()
        self._farthest = np.zeros(robots)
        self._stops = _Stops(robots)
        self._drags = _Drags(world.latency_s + world.age_s)
        self._look()

    def fly(self, ticks: int) -> Flown:
        """Simulate ticks from rest; skipped ticks count."""
        clamped, done, times = 0.0, 0, 0
        while done < ticks:
            read_s, position, velocity = self._read()
            commands = [(self._t_s - at_s, each) for at_s, each in self._sent]
            wanted, pressure = self._policies.act(position, self._simulator.tip_velocity_m_s()[:, 0].astype(np.float64))
            law: Any = self._law  # accepts float64 and float32
            command = law.bound(wanted, position, velocity, self._t_s - read_s, commands).velocity_m_s
            clamped += float((command != wanted).mean())
            self._sent.append((self._t_s, command))
            self._stops.command(command, self._t_s + self._world.latency_s)
            skips = self._rng.random() < self._world.skips
            skipped = int(self._rng.integers(1, self._world.skipped_max + 1)) if skips else 0
            self._hold(command, pressure, (1 + skipped) * CONTROL_PERIOD_S)
            done, times = done + 1 + skipped, times + 1
        return Flown(
            self._farthest, clamped / times, self._stops.braking_m_s2, self._stops.surge_m_s2, self._drags.drag_m_s
        )

    def _read(self) -> tuple[float, Array, Array]:
        """Return the newest sample that is as old as the readings are."""
        while len(self._seen) > 1 and self._seen[1][0] <= self._t_s - self._world.age_s + 1e-6:
            self._seen.popleft()
        while self._sent and self._sent[0][0] < self._t_s - REMEMBERED_S:
            self._sent.popleft()
        return self._seen[0]

    def _hold(self, command: Array, pressure: Array, time_s: float) -> None:
        for each, left_s in ((command, min(time_s, HOLD_S)), (np.zeros_like(command), time_s - HOLD_S)):
            if left_s > 1e-9 and each is not command:
                self._stops.command(each, self._t_s + self._world.latency_s)
            while left_s > 1e-9:
                step_s = min(left_s, LOOK_S)
                self._simulator.step(each, pressure, step_s)
                self._t_s, left_s = self._t_s + step_s, left_s - step_s
                self._look()

    def _look(self) -> None:
        position = self._simulator.cart_position_m.astype(np.float64)
        velocity = self._simulator.cart_velocity_m_s.astype(np.float64)
        self._seen.append((self._t_s, position, velocity))
        self._farthest = np.maximum(self._farthest, np.abs(position))
        self._stops.look(self._t_s, position, velocity)
        self._drags.look(self._t_s, velocity, self._stops.acting)


class _Stops:
    """Braking and acceleration of the robots, over whole stops and over ticks."""

    def __init__(self, robots: int) -> None:
        self._due: deque[tuple[float, Array]] = deque()
        self.acting = np.zeros(robots)
        self._from = np.zeros((2, robots))  # position and velocity at the start of each stop; zero velocity: no stop
        self._before: deque[tuple[float, Array]] = deque()
        self.braking_m_s2, self.surge_m_s2 = np.inf, 0.0

    def command(self, command: Array, acts_s: float) -> None:
        self._due.append((acts_s, command))

    def look(self, t_s: float, position: Array, velocity: Array) -> None:
        while self._due and self._due[0][0] <= t_s + 1e-9:
            self.acting = self._due.popleft()[1]
        against = self.acting * velocity <= 0.0
        place, speed = self._from
        over = (speed != 0.0) & (velocity * speed <= 0.0)
        if over.any():
            way = np.abs(position - place)[over]
            self.braking_m_s2 = min(self.braking_m_s2, float((speed[over] ** 2 / (2 * np.maximum(way, 1e-6))).min()))
        goes_on = (speed != 0.0) & against & ~over
        begins = against & ~goes_on & (np.abs(velocity) > STOP_FROM_M_S)
        place = np.where(begins, position, place)
        self._from = np.stack((place, np.where(begins, velocity, np.where(goes_on, speed, 0.0))))
        self._before.append((t_s, velocity))
        if t_s - self._before[0][0] >= CONTROL_PERIOD_S:
            then_s, then = self._before.popleft()
            faster = (np.abs(velocity) - np.abs(then))[velocity * then > 0]
            self.surge_m_s2 = max(self.surge_m_s2, float(faster.max(initial=0.0)) / (t_s - then_s))


class _Drags:
    """Speed that a cart gains beyond its commands within the latency."""

    def __init__(self, unseen_s: float) -> None:
        self._unseen_s = unseen_s
        self._seen: deque[tuple[float, Array, Array]] = deque()  # time, velocity, commanded velocity
        self.drag_m_s = 0.0

    def look(self, t_s: float, velocity: Array, commanded: Array) -> None:
        self._seen.append((t_s, velocity, commanded))
        while len(self._seen) > 1 and self._seen[1][0] <= t_s - self._unseen_s + 1e-9:
            self._seen.popleft()
        commanded, before = np.stack([each for _, _, each in self._seen]), self._seen[0][1]
        highest = np.maximum(np.maximum(commanded.max(axis=0), before), 0.0)
        lowest = np.minimum(np.minimum(commanded.min(axis=0), before), 0.0)
        self.drag_m_s = max(self.drag_m_s, float(np.maximum(velocity - highest, lowest - velocity).max()))


def measured(world: World, robots: int, rng: Rng) -> RailLimits:
    """Return limits set to a robot's worst measured behaviour, under the conditions of the attack."""
    limits = RailLimits(
        acceleration_max_m_s2=20.0,
        braking_m_s2=0.35 * world.ramp_m_s2,
        surge_m_s2=2.0 * world.ramp_m_s2,
        latency_s=world.latency_s,
    )
    genes = None
    for _ in range(2 + GENERATIONS):
        flown = Batch(world, limits, Policies(robots, rng, genes), rng).fly(MEASURED_TICKS)
        genes = Genes.draw(rng, robots) if genes is None else genes.bred(flown.farthest_m, rng)
        limits = limits.model_copy(
            update={
                "braking_m_s2": max(0.1, min(limits.braking_m_s2, CAUTION * flown.braking_m_s2)),
                "surge_m_s2": min(40.0, max(limits.surge_m_s2, float(flown.surge_m_s2))),
                "drag_m_s": min(1.0, max(limits.drag_m_s, flown.drag_m_s)),
            }
        )
    return limits


def attack(world: World, robots: int, seed: int) -> dict[str, Any]:
    """Run all kinds of policies and a search for worse ones; return the figures as JSON."""
    rng = np.random.default_rng(seed)
    limits = measured(world, robots, rng)
    policies = Policies(robots, rng)
    flown = Batch(world, limits, policies, rng).fly(FLOWN_TICKS)
    farthest = {
        name: float(flown.farthest_m[policies.kind == kind].max(initial=0.0)) for kind, name in enumerate(KINDS)
    }
    beyond, clamped = [flown.farthest_m], [flown.clamped]
    genes = Genes.draw(rng, robots)
    for _ in range(GENERATIONS):
        flown = Batch(world, limits, Policies(robots, rng, genes), rng).fly(FLOWN_TICKS)
        genes = genes.bred(flown.farthest_m, rng)
        beyond.append(flown.farthest_m)
        clamped.append(flown.clamped)
    everything = np.concatenate(beyond)
    return {
        "world": asdict(world),
        "limits": {key: round(getattr(limits, key), 3) for key in PATCHED},
        "seed": seed,
        "robot_ticks": (1 + GENERATIONS) * FLOWN_TICKS * robots,
        "farthest_m": {**farthest, "search": float(max(each.max() for each in beyond[1:]))},
        "beyond_m": float(everything.max() - RAIL_LIMIT_M),
        "flights": len(everything),
        "clamped": float(np.mean(clamped)),
    }
