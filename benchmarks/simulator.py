"""Compare control steps per second with MuJoCo's multithreaded `rollout`, at equal accuracy, on all cores.

Both simulate the paper's arm under the same 30 Hz commands. MuJoCo cannot switch control laws inside a rollout, so both
use the cart's velocity tracker only; MuJoCo receives the lagged pressure and the delayed rail command precomputed, at
no cost. Its integrator is the cheapest one for a given error: `implicitfast` (`RK4` is unstable below about 9 kHz on
this arm, `Euler` has three times the error at the same step). Its step is the coarsest whose tip error after 3 s is
about equal; the reference for both errors is MuJoCo's RK4 at 12 kHz.

Speeds per core and second are of processor time and stay right beside other work; the ratio is theirs. Also measured:
the cost of the effects, and the scaling with cores and batch.

    python -m benchmarks.simulator --json FILE
"""

import json
import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import mujoco
import numba
import numpy as np
from mujoco import rollout

from benchmarks import commands, results
from benchmarks.mujoco_arm import IMPLICIT, compiled
from softarm.common.processes import bar, cores
from softarm.schemas.model import Cart, Model, seed_effects
from softarm.schemas.robot import CONTROL_PERIOD_S, TRAINING_PHYSICS_RATE_HZ
from softarm.simulator.effects import REGISTRY
from softarm.simulator.simulator import Simulator

ROBOTS = 4096
ROUNDS = 9
# Repeats of a command: a flight of 16 ms right after MuJoCo's rollout had one core's speed.
FLIGHTS, MUJOCO_STEPS = 6, 1
BATCHES = (1, 8, 128, 1024, 4096, 16384)
REFERENCE_SUBSTEPS = 400
CANDIDATES = (20, 30, 40, 50, 60, 70, 80, 90, 100, 120, 140, 160, 200, 240, 320)
# Errors within this ratio count as equal.
EQUAL = 1.1
# Unlimited travel, since MuJoCo's arm has no end stops.
MODEL = Model(
    cart=Cart(travel_m=100.0),
    effects={name: given for name, given in seed_effects().items() if name != "rail.acceleration_limit"},
)


def run() -> dict[str, Any]:
    """Measure both simulators, the cost of effects and the scaling."""
    threads = cores()
    load_before = os.getloadavg()[0]
    with bar("tip errors", total=None) as shown:
        sets = _command_sets(16)
        reference = _mujoco_tips(*sets, REFERENCE_SUBSTEPS, threads, mujoco.mjtIntegrator.mjINT_RK4)
        ours = _error_mm(_our_tips(*sets), reference)
        for substeps in CANDIDATES:
            theirs = _error_mm(_mujoco_tips(*sets, substeps, threads), reference)
            if theirs["mean"] <= EQUAL * ours["mean"]:
                break
        else:
            raise RuntimeError(
                f"MuJoCo's error stays above {ours['mean']:.3f} mm even at {30 * substeps} Hz; add finer CANDIDATES"
            )
        shown.show(total=ROUNDS, text="speed")
        speeds = []
        race = _Race(substeps, threads)
        for _ in range(ROUNDS):
            speeds.append((race.ours(), race.mujoco()))
            shown.advance()
        shown.show(text="scaling")
        more = _scaling()
    ours_of, mujoco_of = (np.median(side, axis=0).tolist() for side in zip(*speeds, strict=True))
    return {
        "control_steps_per_s": ours_of[0],
        "control_steps_per_core_s": ours_of[1],
        "mujoco_control_steps_per_s": mujoco_of[0],
        "mujoco_control_steps_per_core_s": mujoco_of[1],
        "ratio": ours_of[1] / mujoco_of[1],
        "tip_error_mm": ours,
        "mujoco_tip_error_mm": theirs,
        "step_rate_hz": TRAINING_PHYSICS_RATE_HZ,
        "mujoco_step_rate_hz": 30 * substeps,
        "mujoco_integrator": "implicitfast",
        "mujoco_version": mujoco.__version__,
        "robots": ROBOTS,
        "cores": threads,
        "rounds": ROUNDS,
        **more,
        "load_average": {"before": load_before, "after": os.getloadavg()[0]},
    }


def _command_sets(of_each: int) -> tuple[np.ndarray, np.ndarray]:
    """Return cart velocity and pressure, each [commands.STEPS, 2 of_each], smooth ones first."""
    smooth, switching = commands.smooth(of_each, seed=1), commands.bang_bang(of_each, seed=2)
    return np.hstack((smooth[0], switching[0])), np.hstack((smooth[1], switching[1]))


def _our_tips(velocity: np.ndarray, pressure: np.ndarray) -> np.ndarray:
    simulator = Simulator(MODEL, velocity.shape[1], TRAINING_PHYSICS_RATE_HZ)
    for v, p in zip(velocity, pressure, strict=True):
        simulator.step(v, p, CONTROL_PERIOD_S)
    return simulator.tip_m()


def _mujoco_tips(
    velocity: np.ndarray, pressure: np.ndarray, substeps: int, threads: int, integrator: mujoco.mjtIntegrator = IMPLICIT
) -> np.ndarray:
    model = compiled(MODEL, substeps / CONTROL_PERIOD_S, integrator)
    control = _mujoco_controls(velocity, pressure, substeps)
    workers = [mujoco.MjData(model) for _ in range(threads)]
    with rollout.Rollout(nthread=threads) as pool:
        states, _ = pool.rollout(model, workers, _state_at_rest(model), control)
    position = states[:, -1, 1 : 1 + model.nq]  # the state starts with the time
    angles, length = np.cumsum(position[:, 1:], axis=1), np.array(MODEL.arm.link_length_m)
    y = position[:, 0] + np.sin(angles) @ length
    z = MODEL.arm.base_height_m - np.cos(angles) @ length
    return np.stack((y, z), axis=1)


def _mujoco_controls(velocity: np.ndarray, pressure: np.ndarray, substeps: int) -> np.ndarray:
    """Return the actuators' inputs: delayed velocity and mean lagged pressure, [robots, steps, 2]."""
    lag, delay_s = MODEL.effects["pressure.lag"], MODEL.effects["rail.delay"]["delay"]
    dt = CONTROL_PERIOD_S / substeps
    late = round(delay_s / dt)
    fine_velocity, fine_pressure = np.repeat(velocity, substeps, axis=0), np.repeat(pressure, substeps, axis=0)
    control = np.zeros((*fine_velocity.shape[::-1], 2))
    control[:, late:, 0] = fine_velocity[: len(fine_velocity) - late].T
    kpa = np.zeros(velocity.shape[1])
    for step, wanted in enumerate(fine_pressure):
        time_constant = np.where(wanted > kpa, lag["inflate"], lag["deflate"])
        after = wanted + (kpa - wanted) * np.exp(-dt / time_constant)
        control[:, step, 1] = (kpa + after) / 2
        kpa = after
    return control


def _state_at_rest(model: mujoco.MjModel) -> np.ndarray:
    return np.zeros((1, mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)))


def _error_mm(tips: np.ndarray, reference: np.ndarray) -> dict[str, float]:
    error = 1e3 * np.linalg.norm(tips - reference, axis=1)
    return {"mean": float(error.mean()), "max": float(error.max())}


def _rate(work: Callable[[], object], steps: int) -> tuple[float, float]:
    """Return control steps per second, and per second of processor time of all threads, of work of so many steps."""
    start, start_cpu = time.perf_counter(), time.process_time()
    work()
    return steps / (time.perf_counter() - start), steps / (time.process_time() - start_cpu)


class _Flight:
    """Batch of robots in motion, compiled."""

    def __init__(self, model: Model | None, robots: int) -> None:
        self._commands = commands.smooth(robots, seed=3)
        self._simulator = Simulator(model, robots, TRAINING_PHYSICS_RATE_HZ)
        self._robots = robots
        self.speed()

    def speed(self) -> tuple[float, float]:
        """Return control steps per second, and per core and second."""
        return _rate(self._fly, self._robots * FLIGHTS * commands.STEPS)

    def _fly(self) -> None:
        for v, p in zip(*self._commands, strict=True):
            for _ in range(FLIGHTS):
                self._simulator.step(v, p, CONTROL_PERIOD_S)

    def median_speed(self) -> float:
        return statistics.median(self.speed()[0] for _ in range(ROUNDS))


def _scaling() -> dict[str, Any]:
    """Return the cost of all effects at their exemplars, and control steps/s by cores and by batch."""
    every = {effect.name: {p.name: p.exemplar for p in effect.parameters} for effect in REGISTRY.values()}
    seed, full = _Flight(None, ROBOTS), _Flight(Model(effects=every), ROBOTS)
    seed_speed, full_speed = (statistics.median(each.speed()[1] for _ in range(ROUNDS)) for each in (seed, full))
    by_cores = {}
    threads = numba.get_num_threads()
    for number in range(1, cores() + 1):
        numba.set_num_threads(number)
        by_cores[str(number)] = seed.median_speed()
    numba.set_num_threads(threads)
    return {
        "effects": {
            "seed_control_steps_per_core_s": seed_speed,
            "all_control_steps_per_core_s": full_speed,
            "all_over_seed": full_speed / seed_speed,
        },
        "scaling": {
            "cores": by_cores,
            "batch": {str(robots): _Flight(None, robots).median_speed() for robots in BATCHES},
        },
    }


class _Race:
    """Both simulators, warmed up; each call simulates ROBOTS robots."""

    def __init__(self, mujoco_substeps: int, threads: int) -> None:
        velocity, pressure = (each[:MUJOCO_STEPS] for each in commands.smooth(ROBOTS, seed=3))
        self.ours = _Flight(MODEL, ROBOTS).speed
        self._model = compiled(MODEL, mujoco_substeps / CONTROL_PERIOD_S)
        self._workers = [mujoco.MjData(self._model) for _ in range(threads)]
        self._pool = rollout.Rollout(nthread=threads)
        self._control = _mujoco_controls(velocity, pressure, mujoco_substeps)
        rest = _state_at_rest(self._model)
        self._rest = np.tile(rest, (ROBOTS, 1))
        self._states = np.zeros((ROBOTS, self._control.shape[1], rest.shape[1]))
        self.mujoco()

    def mujoco(self) -> tuple[float, float]:
        """Return MuJoCo's control steps per second, and per core and second."""
        return _rate(self._roll_out, ROBOTS * MUJOCO_STEPS)

    def _roll_out(self) -> None:
        self._pool.rollout(self._model, self._workers, self._rest, self._control, state=self._states, skip_checks=False)


@click.command()
@results.json_option
def main(json_file: Path | None) -> None:
    """Compare control steps per second with MuJoCo's rollout at equal accuracy, in one run.

    \b
    Example:
      python -m benchmarks.simulator --json simulator.json
    """
    result = run()
    results.report("simulator", result, json_file)
    for name in ("effects", "scaling"):
        click.echo(f"{name}: {json.dumps(result[name])}")


if __name__ == "__main__":
    main()
