"""Profile of the simulator: the cost of effects, scaling, and the distance from the machine's peak.

Floating-point operations are counted by running the kernel's source with counting numbers on a real robot's state. The
peak is measured with independent, unfused multiplications and additions, since the kernel's are not fused (a robot's
results are equal in any batch on any machine).
"""

import importlib
import statistics
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from math import floor, sqrt
from typing import Any, ClassVar
from unittest.mock import patch

import numba
import numpy as np
from rich.console import Console

from benchmarks import commands
from softarm.common.processes import cores
from softarm.schemas.model import Model
from softarm.schemas.robot import TRAINING_PHYSICS_RATE_HZ
from softarm.simulator.effects import REGISTRY
from softarm.simulator.simd import load, store
from softarm.simulator.simulator import Simulator

ROBOTS, STEPS, SUBSTEPS = 4096, 60, 8
BATCHES = (1, 8, 128, 1024, 4096, 16384)


def all_effects() -> Model:
    """Return the paper's robot with every effect at its exemplar."""
    return Model(effects={e.name: {p.name: p.exemplar for p in e.parameters} for e in REGISTRY.values()})


def measure(rounds: int) -> dict[str, Any]:
    """Return the figures for the benchmark's JSON."""
    seed, full = _Flight(None, ROBOTS), _Flight(all_effects(), ROBOTS)
    pairs = [(seed.speed(), full.speed()) for _ in range(rounds)]
    seed_speed, full_speed = (statistics.median(side) for side in zip(*pairs, strict=True))
    threads = cores()
    counted = count(Model())
    peak = _peak_gflops(threads)
    achieved = seed_speed * SUBSTEPS * counted["flops"] / 1e9
    return {
        "effects": {
            "seed_control_steps_per_s": seed_speed,
            "all_control_steps_per_s": full_speed,
            "all_over_seed": full_speed / seed_speed,
        },
        "scaling": {
            "cores": {str(n): _on(n, seed.speed, rounds) for n in range(1, threads + 1)},
            "batch": {str(n): _Flight(None, n).best(rounds) for n in BATCHES},
        },
        "profile": {
            "flops_per_substep": counted["flops"],
            "divisions_per_substep": counted["divisions"],
            "selects_and_compares_per_substep": counted["selects"],
            "loads_and_stores_per_substep": counted["memory"],
            "gflops": achieved,
            "peak_gflops_unfused": peak,
            "share_of_peak": achieved / peak,
        },
    }


def show(console: Console, result: Mapping[str, Any]) -> None:
    """Print the figures of `measure`."""
    effects, scaling, profile = result["effects"], result["scaling"], result["profile"]
    console.print(
        f"effects   the seed's four {effects['seed_control_steps_per_s']:,.0f}/s, all on "
        f"{effects['all_control_steps_per_s']:,.0f}/s: {effects['all_over_seed']:.2f} of it"
    )
    for name, unit in (("cores", "cores"), ("batch", "robots")):
        figures = ", ".join(f"{n}: {speed:,.0f}/s" for n, speed in scaling[name].items())
        console.print(f"{unit:<9} {figures}")
    console.print(
        f"peak      {profile['gflops']:.0f} of {profile['peak_gflops_unfused']:.0f} Gflop/s "
        f"({profile['share_of_peak']:.0%}); a substep has {profile['flops_per_substep']} flops, "
        f"{profile['divisions_per_substep']} of them divisions, beside {profile['selects_and_compares_per_substep']} "
        f"selects and compares and {profile['loads_and_stores_per_substep']} loads and stores"
    )


class _Flight:
    """Batch of robots in motion, for timing."""

    def __init__(self, model: Model | None, robots: int) -> None:
        self._commands = commands.smooth(robots, seed=3)
        self._simulator = Simulator(model, robots)
        self._robots = robots
        self.speed()

    def speed(self) -> float:
        """Return the control steps per second over one flight."""
        start = time.perf_counter()
        for v, p in zip(*(each[:STEPS] for each in self._commands), strict=True):
            self._simulator.step(v, p)
        return self._robots * STEPS / (time.perf_counter() - start)

    def best(self, rounds: int) -> float:
        """Return the fastest of several flights."""
        return max(self.speed() for _ in range(rounds))


def _on(threads: int, speed: Any, rounds: int) -> float:
    before = numba.get_num_threads()
    numba.set_num_threads(threads)
    try:
        return float(statistics.median(speed() for _ in range(rounds)))
    finally:
        numba.set_num_threads(before)


class _Number:
    """Float that counts its operations; comparisons return bool."""

    counts: ClassVar[Counter[str]] = Counter()

    def __init__(self, value: float) -> None:
        self.value = float(value)

    @staticmethod
    def of(other: Any) -> float:
        return other.value if isinstance(other, _Number) else float(other)


def _operator(name: str, kind: str) -> Any:
    def apply(self: _Number, other: Any) -> Any:
        _Number.counts[kind] += 1
        if name == "__rtruediv__":
            return _Number(_Number.of(other) / self.value)
        value = getattr(self.value, name)(_Number.of(other))
        return value if isinstance(value, bool) else _Number(value)

    return apply


for _name in ("add", "radd", "sub", "rsub", "mul", "rmul"):
    setattr(_Number, f"__{_name}__", _operator(f"__{_name}__", "flops"))
for _name in ("truediv", "rtruediv"):
    setattr(_Number, f"__{_name}__", _operator(f"__{_name}__", "divisions"))
for _name in ("lt", "gt", "ge", "ne"):
    setattr(_Number, f"__{_name}__", _operator(f"__{_name}__", "selects"))


def count(model: Model) -> dict[str, int]:
    """Count the operations of a substep of one moving robot by running the kernel's source."""
    simulator = Simulator(model)
    for v, p in zip(*(each[:20, 0] for each in commands.smooth(1, seed=3)), strict=True):
        simulator.step(v, p)
    m = [_Number(x) for x in simulator._rows[0, :, 0]]
    w = [_Number(0.0) for _ in range(simulator._at.scratch_end)]
    links, dt = (0,) * simulator.links, 1 / TRAINING_PHYSICS_RATE_HZ
    _Number.counts = Counter()
    with _interpreted():
        run = importlib.import_module("softarm.simulator.kernel.run")
        run._advance_block(m, w, links, (0,), (0,), simulator._needed, SUBSTEPS, dt)
    counts = {kind: round(number / SUBSTEPS) for kind, number in _Number.counts.items()}
    counts["flops"] += counts["divisions"]
    return counts


@contextmanager
def _interpreted() -> Iterator[None]:
    """Run the kernel's functions as plain Python while the context lasts."""

    def memory(value: Any) -> Any:
        _Number.counts["memory"] += 1
        return value

    def select(condition: bool, yes: Any, no: Any) -> _Number:
        _Number.counts["selects"] += 1
        return _Number(_Number.of(yes if condition else no))

    def unary(function: Any) -> Any:
        def apply(x: _Number) -> _Number:
            _Number.counts["flops"] += 1
            return _Number(function(x.value))

        return apply

    def put(memory_: list[_Number], row: int, lanes: object, value: Any) -> None:
        memory_[row] = memory(_Number(_Number.of(value)))

    vectors = {
        "load": lambda memory_, row, lanes: memory(memory_[row]),
        "store": put,
        "select": select,
        "fill": lambda like, value: _Number(value),
        "some": lambda condition: bool(condition),
        "floor": unary(floor),
        "root": unary(sqrt),
        "magnitude": unary(abs),
    }
    names = ("numerics", "pressure", "rail", "arm", "joints", "contact", "run")
    modules = [importlib.import_module(f"softarm.simulator.kernel.{name}") for name in names]
    patches = []
    for module in modules:
        for name, thing in list(vars(module).items()):
            if name in vectors:
                patches.append(patch.object(module, name, vectors[name]))
            elif hasattr(thing, "py_func"):
                patches.append(patch.object(module, name, thing.py_func))
    for each in patches:
        each.start()
    try:
        yield
    finally:
        for each in patches:
            each.stop()


@numba.njit(parallel=True)
def _multiply_and_add(memory, lanes, repeats):  # type: ignore[no-untyped-def]
    """Run twelve independent chains per thread, each in one register: 24 operations per lane and repeat."""
    for thread in numba.prange(memory.shape[0]):
        m = memory[thread]
        x, y = load(m, 12, lanes), load(m, 13, lanes)
        a, b, c, d = load(m, 0, lanes), load(m, 1, lanes), load(m, 2, lanes), load(m, 3, lanes)
        e, f, g, h = load(m, 4, lanes), load(m, 5, lanes), load(m, 6, lanes), load(m, 7, lanes)
        i, j, k, n = load(m, 8, lanes), load(m, 9, lanes), load(m, 10, lanes), load(m, 11, lanes)
        for _ in range(repeats):
            a, b, c, d = a * x + y, b * x + y, c * x + y, d * x + y
            e, f, g, h = e * x + y, f * x + y, g * x + y, h * x + y
            i, j, k, n = i * x + y, j * x + y, k * x + y, n * x + y
        store(m, 0, lanes, a + b + c + d + e + f + g + h + i + j + k + n)


def _peak_gflops(threads: int, repeats: int = 4_000_000) -> float:
    """Return the highest rate of unfused multiplications and additions on all cores, 1e9/s, with lanes of 16."""
    lanes = (0,) * 16
    memory = np.zeros((threads, 14 * len(lanes)), np.float32)
    memory[:, 12 * len(lanes) : 13 * len(lanes)] = 0.5
    memory[:, 13 * len(lanes) :] = 1.0
    _multiply_and_add(memory, lanes, 1)
    best = 0.0
    for _ in range(5):
        start = time.perf_counter()
        _multiply_and_add(memory, lanes, repeats)
        best = max(best, threads * len(lanes) * 24 * repeats / (time.perf_counter() - start))
    return best / 1e9
