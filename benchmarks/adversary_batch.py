"""Mean policies against the braking law, many robots at once: random, bang-bang, periodic, and a search for worse.

A world is a robot and what its readings and ticks are like; each of its robots is flown by a policy of its own. The
law that bounds their commands is the safety filter's, told what the filter would be told.
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

LOOK_S = 0.0085  # the cart is looked at so often
PHYSICS_HZ = 480.0
HOLD_S = DryveRail().hold_s
REMEMBERED_S = 0.8
KINDS = ("random", "bang-bang", "periodic", "with the swing", "against the swing")
STOP_FROM_M_S = 0.15  # a stop from less says little of the brake
MEASURED_TICKS, GENERATIONS, FLOWN_TICKS = 150, 4, 200
PARENTS = 0.1  # of a generation
PATCHED = ("braking_m_s2", "surge_m_s2", "latency_s", "drag_m_s")  # of limits.rail, to fit a robot
CAUTION = 0.8  # of the worst stop that was seen: the worst of more is a little worse


@dataclass(frozen=True)
class World:
    """A robot, and what the daemon knows of it how late."""

    ramp_m_s2: float
    latency_s: float
    payload_kg: float
    age_s: float
    skips: float  # share of the ticks after which some are skipped
    skipped_max: int

    @classmethod
    def draw(cls, rng: Rng) -> "World":
        """One of those that the promise is about."""
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
        """The robot."""
        seed = Model()
        effects = {
            **seed.effects,
            "rail.acceleration_limit": {"acceleration": self.ramp_m_s2},
            "rail.delay": {"delay": self.latency_s},
            "arm.payload": {"mass": self.payload_kg},
        }
        return seed.model_copy(update={"effects": effects})


class Genes(NamedTuple):
    """What a periodic policy is made of, each [R]."""

    rate_hz: Array
    pressure_rate: Array  # of it
    phase: Array
    speed: Array
    duty: Array
    pressure_duty: Array

    @classmethod
    def draw(cls, rng: Rng, robots: int) -> "Genes":
        """At random."""
        return cls(
            rng.uniform(0.4, 3.0, robots),
            rng.choice([0.5, 1.0, 1.0, 1.0, 2.0], robots),
            rng.random(robots),
            rng.uniform(0.4, 1.0, robots),
            rng.uniform(0.3, 0.7, robots),
            rng.uniform(0.3, 0.7, robots),
        )

    def bred(self, farthest_m: Array, rng: Rng) -> "Genes":
        """The next generation: near those that came farthest."""
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
    """One policy a robot, of all kinds in turn; with `genes` all of them periodic."""

    def __init__(self, robots: int, rng: Rng, genes: Genes | None = None) -> None:
        self._rng, self._robots = rng, robots
        self.kind = np.full(robots, 2) if genes is not None else np.arange(robots) % len(KINDS)
        self._genes = Genes.draw(rng, robots) if genes is None else genes
        self._turn_at_m = rng.uniform(0.0, 0.24, robots)
        self._fickle = rng.uniform(0.05, 0.5, robots)
        self._velocity, self._pressure = np.ones(robots), np.zeros(robots)
        self._t_s = 0.0

    def act(self, position_m: Array, tip_vy_m_s: Array) -> tuple[Array, Array]:
        """What they want: m/s and kPa, each [R]."""
        rng, robots = self._rng, self._robots
        self._t_s += CONTROL_PERIOD_S
        anew = rng.random(robots) < self._fickle
        drawn = np.where(rng.random(robots) < 0.7, rng.choice([-1.0, 1.0], robots), rng.uniform(-1, 1, robots))
        to_and_fro = np.where(position_m > self._turn_at_m, -1.0, np.sign(self._velocity) + (self._velocity == 0))
        to_and_fro = np.where(position_m < -self._turn_at_m, 1.0, to_and_fro)
        genes = self._genes
        turn = genes.rate_hz * self._t_s
        wave = np.where(turn % 1 < genes.duty, 1.0, -1.0) * genes.speed
        pushed = (genes.pressure_rate * turn + genes.phase) % 1 < genes.pressure_duty
        swing = np.sign(tip_vy_m_s)
        choices = (np.where(anew, drawn, self._velocity), to_and_fro, wave, swing, -swing)
        self._velocity = np.choose(self.kind, choices)
        random_push = np.where(anew, rng.random(robots) < 0.5, self._pressure > 0)
        on = np.choose(self.kind, (random_push, pushed, pushed, swing < 0, swing < 0))
        self._pressure = np.where(on, PRESSURE_MAX_KPA, PRESSURE_MIN_KPA)
        return self._velocity, self._pressure


class Flown(NamedTuple):
    """What came of a batch of flights."""

    farthest_m: Array  # [R]
    clamped: float  # share of the commands
    braking_m_s2: float  # the worst mean over a whole stop
    surge_m_s2: float  # the highest mean over a tick
    drag_m_s: float  # the most that the cart was faster than all that may have acted while that went unseen


def fly(world: World, limits: RailLimits, policies: Policies, ticks: int, rng: Rng) -> Flown:
    """Fly for so many ticks from rest; the readings are `age_s` old, skipped ticks count."""
    return _Batch(world, limits, policies, rng).fly(ticks)


class _Batch:
    def __init__(self, world: World, limits: RailLimits, policies: Policies, rng: Rng) -> None:
        robots = len(policies.kind)
        self._world, self._policies, self._rng = world, policies, rng
        self._law = limits.braking_law(HOLD_S)
        self._simulator = Simulator(world.model, robots=robots, physics_rate_hz=PHYSICS_HZ)
        self._simulator.reset(cart_position_m=rng.uniform(-0.2, 0.2, robots))
        self._t_s = 0.0
        self._seen: deque[tuple[float, Array, Array]] = deque()  # when, where, how fast
        self._sent: deque[tuple[float, Array]] = deque()
        self._farthest = np.zeros(robots)
        self._stops = _Stops(robots)
        self._drags = _Drags(world.latency_s + world.age_s)
        self._look()

    def fly(self, ticks: int) -> Flown:
        clamped, done, times = 0.0, 0, 0
        while done < ticks:
            read_s, position, velocity = self._read()
            told = [(self._t_s - at_s, each) for at_s, each in self._sent]
            wanted, pressure = self._policies.act(position, self._simulator.tip_velocity_m_s()[:, 0].astype(np.float64))
            law: Any = self._law  # of float64 as of float32
            command = law.bound(wanted, position, velocity, self._t_s - read_s, told).velocity_m_s
            clamped += float((command != wanted).mean())
            self._sent.append((self._t_s, command))
            self._stops.tell(command, self._t_s + self._world.latency_s)
            skips = self._rng.random() < self._world.skips
            skipped = int(self._rng.integers(1, self._world.skipped_max + 1)) if skips else 0
            self._hold(command, pressure, (1 + skipped) * CONTROL_PERIOD_S)
            done, times = done + 1 + skipped, times + 1
        return Flown(
            self._farthest, clamped / times, self._stops.braking_m_s2, self._stops.surge_m_s2, self._drags.drag_m_s
        )

    def _read(self) -> tuple[float, Array, Array]:
        """The newest look that is as old as readings are."""
        while len(self._seen) > 1 and self._seen[1][0] <= self._t_s - self._world.age_s + 1e-6:
            self._seen.popleft()
        while self._sent and self._sent[0][0] < self._t_s - REMEMBERED_S:
            self._sent.popleft()
        return self._seen[0]

    def _hold(self, command: Array, pressure: Array, time_s: float) -> None:
        for each, left_s in ((command, min(time_s, HOLD_S)), (np.zeros_like(command), time_s - HOLD_S)):
            if left_s > 1e-9 and each is not command:
                self._stops.tell(each, self._t_s + self._world.latency_s)
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
    """How a robot brakes and speeds up: over whole stops, and over ticks."""

    def __init__(self, robots: int) -> None:
        self._due: deque[tuple[float, Array]] = deque()
        self.acting = np.zeros(robots)
        self._from = np.zeros((2, robots))  # where and how fast each stop began; no speed: there is none
        self._before: deque[tuple[float, Array]] = deque()
        self.braking_m_s2, self.surge_m_s2 = np.inf, 0.0

    def tell(self, command: Array, acts_s: float) -> None:
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
    """How much faster a cart becomes than it was and was told, within so long."""

    def __init__(self, unseen_s: float) -> None:
        self._unseen_s = unseen_s
        self._seen: deque[tuple[float, Array, Array]] = deque()  # when, how fast, told to be how fast
        self.drag_m_s = 0.0

    def look(self, t_s: float, velocity: Array, acting: Array) -> None:
        self._seen.append((t_s, velocity, acting))
        while len(self._seen) > 1 and self._seen[1][0] <= t_s - self._unseen_s + 1e-9:
            self._seen.popleft()
        told, before = np.stack([each for _, _, each in self._seen]), self._seen[0][1]
        highest = np.maximum(np.maximum(told.max(axis=0), before), 0.0)
        lowest = np.minimum(np.minimum(told.min(axis=0), before), 0.0)
        self.drag_m_s = max(self.drag_m_s, float(np.maximum(velocity - highest, lowest - velocity).max()))


def measured(world: World, robots: int, rng: Rng) -> RailLimits:
    """Limits patched to fit: what the robot was seen to do at its worst, flown as the attack will fly it."""
    limits = RailLimits(
        acceleration_max_m_s2=20.0,
        braking_m_s2=0.35 * world.ramp_m_s2,
        surge_m_s2=2.0 * world.ramp_m_s2,
        latency_s=world.latency_s,
    )
    genes = None
    for _ in range(2 + GENERATIONS):
        flown = fly(world, limits, Policies(robots, rng, genes), MEASURED_TICKS, rng)
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
    """Fly all kinds of policies and then a search for a worse one; what came of it, as JSON has it."""
    rng = np.random.default_rng(seed)
    limits = measured(world, robots, rng)
    policies = Policies(robots, rng)
    flown = fly(world, limits, policies, FLOWN_TICKS, rng)
    farthest = {
        name: float(flown.farthest_m[policies.kind == kind].max(initial=0.0)) for kind, name in enumerate(KINDS)
    }
    beyond, clamped = [flown.farthest_m], [flown.clamped]
    genes = Genes.draw(rng, robots)
    for _ in range(GENERATIONS):
        flown = fly(world, limits, Policies(robots, rng, genes), FLOWN_TICKS, rng)
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
