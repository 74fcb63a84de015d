"""Time and success of `softarm dev plan` beside CasADi with IPOPT on the same problem.

    pip install casadi
    python -m benchmarks.planning --json FILE

CasADi plans by direct transcription: the equations of motion of the arm are constraints at the middle of intervals of
1 / 60 s. The cart is a mass with limits on position, velocity and acceleration, the muscle a first-order lag. Both
planners' commands are flown by the same simulator at 1200 Hz behind the braking clamp.
"""

import time
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from benchmarks import results
from softarm.schemas.flights import TEST_TARGETS
from softarm.schemas.model import Arm, Model
from softarm.schemas.robot import CONTROL_RATE_HZ, PHYSICS_RATE_HZ
from softarm.training.task.reach import ReachTask
from softarm.training.trajectory import planner, problem
from softarm.training.trajectory.problem import Rollouts

Array = NDArray[np.floating]

STEPS = (66, 98)  # control steps of a plan; a plan may wait, so the longer one includes the shorter
DELAYED = 2  # control steps from a command to the velocity that it causes: the rail's delay and the ramp
ITERATIONS = 300


def _torques(arm: Arm, angle: Any, rate: Any, turn: Any, push: Any, pressure: Any) -> Any:
    """Return the torques that do not balance on the absolute link angles, [n], for a cart acceleration `push`."""
    import casadi as ca

    mass, length, n = np.array(arm.link_mass_kg), np.array(arm.link_length_m), arm.links
    beyond = np.cumsum(mass[::-1])[::-1] - mass
    moment = length * (mass / 2 + beyond)
    own = np.array(arm.link_inertia_kg_m2) + length**2 * (mass / 4 + beyond)
    joint = [
        -arm.stiffness_nm_rad[i] * (angle[i] - (angle[i - 1] if i else 0))
        - arm.damping_nm_s_rad[i] * (rate[i] - (rate[i - 1] if i else 0))
        - arm.muscle_gain_nm_kpa[i] * pressure
        - arm.torque_offset_nm[i]
        for i in range(n)
    ]
    rows = []
    for i in range(n):
        total = -arm.gravity_m_s2 * moment[i] * ca.sin(angle[i]) - moment[i] * ca.cos(angle[i]) * push
        total += joint[i] - (joint[i + 1] if i + 1 < n else 0) - own[i] * turn[i]
        for j in (j for j in range(n) if j != i):
            coupling, apart = length[min(i, j)] * moment[max(i, j)], angle[i] - angle[j]
            total -= coupling * (ca.cos(apart) * turn[j] + ca.sin(apart) * rate[j] ** 2)
        rows.append(total)
    return ca.vertcat(*rows)


class Ipopt:
    """Planner of one target by direct transcription over a number of control steps.

    A node has cart (m), link angles (rad), their rates and the pressure (kPa). Inputs of an interval are the cart's
    acceleration (m/s^2) and the slope of the pressure (kPa/s).
    """

    def __init__(self, model: Model, steps: int) -> None:
        import casadi as ca

        self._arm, self._lag = model.arm, model.effects["pressure.lag"]
        self._steps, self._count, self._size = steps, 2 * steps, 2 * model.arm.links + 3
        n = model.arm.links
        state, control = ca.MX.sym("state", self._size, self._count + 1), ca.MX.sym("control", 2, self._count)
        target, last = ca.MX.sym("target", 2), state[1 : n + 1, -1]
        length = ca.DM(np.array(model.arm.link_length_m))
        tip_y = state[0, -1] + ca.dot(length, ca.sin(last))
        tip_z = model.arm.base_height_m - ca.dot(length, ca.cos(last))
        rows = self._interval().map(self._count)(state[:, :-1], state[:, 1:], control)
        cost = problem.POSITION_WEIGHT * ca.sumsqr(state[: n + 1, :])
        cost += problem.RATE_WEIGHT * ca.sumsqr(state[n + 1 : -1, :])
        cost += problem.FORCE_WEIGHT * problem.MOVED_MASS_KG**2 * ca.sumsqr(control[0, :])
        cost += problem.PRESSURE_WEIGHT * ca.sumsqr(state[-1, :] / 10)
        program = {
            "x": ca.vertcat(ca.vec(state), ca.vec(control)),
            "p": target,
            "f": 5e-4 * cost,
            "g": ca.vertcat(ca.vec(rows), state[:, 0], ca.vertcat(tip_y, tip_z) - target),
        }
        options = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.max_iter": ITERATIONS}
        self._solver = ca.nlpsol("plan", "ipopt", program, options | {"ipopt.tol": 1e-4})
        self._bounds = self._bounded()

    def _interval(self) -> Any:
        """Return the equations of an interval, which are zero, and the quantities with limits at its end."""
        import casadi as ca

        n, h = self._arm.links, 0.5 / CONTROL_RATE_HZ
        before, after, inputs = ca.SX.sym("before", self._size), ca.SX.sym("after", self._size), ca.SX.sym("inputs", 2)
        middle, slope = (before + after) / 2, (after - before) / h
        torques = _torques(self._arm, middle[1 : n + 1], middle[n + 2 : -1], slope[n + 2 : -1], inputs[0], middle[-1])
        rates = slope[: n + 1] - middle[n + 1 : -1]
        stop = after[0] + after[n + 1] * ca.fabs(after[n + 1]) / (2 * problem.BRAKING_M_S2)
        venting = inputs[1] + after[-1] / self._lag["deflate"]
        filling = inputs[1] + (after[-1] - problem.PRESSURE_MAX_KPA) / self._lag["inflate"]
        zero = (rates, slope[n + 1] - inputs[0], 100 * torques, slope[-1] - inputs[1])
        return ca.Function("interval", [before, after, inputs], [ca.vertcat(*zero, stop, venting, filling)])

    def _bounded(self) -> dict[str, Array]:
        n, most, free = self._arm.links, problem.RAIL_MAX_M, np.inf
        high = np.array([most, *n * [free], problem.VELOCITY_MAX_M_S, *n * [free], problem.PRESSURE_MAX_KPA])
        low = np.array([*-high[:-1], 0.0])
        inputs = np.tile([problem.ACCELERATION_MAX_M_S2, free], self._count)
        zero, ends = [0.0] * self._size, np.zeros(self._size + 2)
        return {
            "lbx": np.concatenate((np.tile(low, self._count + 1), -inputs)),
            "ubx": np.concatenate((np.tile(high, self._count + 1), inputs)),
            "lbg": np.concatenate((np.tile([*zero, -most, 0.0, -free], self._count), ends)),
            "ubg": np.concatenate((np.tile([*zero, most, free, 0.0], self._count), ends)),
        }

    def solve(self, target_m: Array) -> Array:
        """Return commands [steps, 2], m/s and kPa, for a target [2]; the first guess is an arm at rest."""
        found = np.array(self._solver(x0=0.0, p=target_m, **self._bounds)["x"]).ravel()
        nodes = (self._count + 1) * self._size
        states = found[:nodes].reshape(-1, self._size)
        slopes = found[nodes:].reshape(self._steps, 2, 2)[:, :, 1].mean(axis=1)
        velocity = states[::2, self._arm.links + 1][np.minimum(np.arange(self._steps) + DELAYED, self._steps)]
        time_s = np.where(slopes > 0, self._lag["inflate"], self._lag["deflate"])
        pressure = states[:-1, -1].reshape(self._steps, 2).mean(axis=1) + time_s * slopes
        return np.column_stack((velocity, np.clip(pressure, 0.0, problem.PRESSURE_MAX_KPA)))


def closest_m(commands: Array, target_m: Array) -> float:
    """Return the smallest distance of the tip from a target [2], flown at 1200 Hz behind the braking clamp."""
    task = ReachTask()
    held = np.concatenate((commands, commands[-1:].repeat(task.episode_steps - len(commands), axis=0)))
    flown = Rollouts(physics_rate_hz=PHYSICS_RATE_HZ).fly(
        held[:, None].astype(np.float32), np.zeros(1, dtype=np.float32), guarded=True
    )
    return float(flown.distance_m(target_m[None], task.rail_limit_m).min())


@click.command()
@results.json_option
def main(json_file: Path | None) -> None:
    """Plan from the middle of the rail with both, fly the plans, and print processor time and success.

    \b
    Example:
      python -m benchmarks.planning --json planning.json
    """
    targets = np.array([(goal.y_m, goal.z_m) for goal in TEST_TARGETS], dtype=np.float32)
    planner.plan(targets[:1])  # compiles
    start = time.process_time()
    ours = planner.plan(targets)
    ours_s = time.process_time() - start
    solvers = [Ipopt(Model(), steps) for steps in STEPS]
    start, reached, tries = time.process_time(), 0, 0
    for number, target_m in enumerate(targets):
        for solver in solvers:
            tries += 1
            if closest_m(solver.solve(target_m), target_m) < ReachTask().success_radius_m:
                reached += 1
                break
        click.echo(f"{number + 1} of {len(targets)}: {reached} reached, {time.process_time() - start:.1f} s", err=True)
    ipopt_s = time.process_time() - start
    rows = {
        "softarm": {"cpu_s": ours_s, "reached": int(np.isfinite(ours.reached_s).sum())},
        "ipopt": {"cpu_s": ipopt_s, "reached": reached, "solved": tries},
    }
    results.write(json_file, {"targets": len(targets), **rows})
    for name, row in rows.items():
        click.echo(f"{name}: {row['reached']} of {len(targets)} reached in {row['cpu_s']:.1f} s of processor time")


if __name__ == "__main__":
    main()
