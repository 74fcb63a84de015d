"""Next experiment: the excitation that separates explanations which fit the data equally well.

Each excitation is simulated for each explanation and compared through the diagnosis's own views, with its nuisances
and noise floors. The recorded trials are compared in the same way.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.data.trials import Series, Trial
from softarm.diagnosis.engine import box
from softarm.diagnosis.engine.fits import FitProblem
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.engine.view import Array, Point
from softarm.diagnosis.engine.whitened import Rows, slices
from softarm.diagnosis.robot.candidates import nuisances
from softarm.diagnosis.robot.trial_grid import STEP_S, on_grid
from softarm.diagnosis.robot.views import ARM_HZ, PHYSICS, robot_views
from softarm.schemas.excitation import EXCITATIONS, Excitation
from softarm.schemas.model import Model
from softarm.schemas.robot import CONTROL_PERIOD_S
from softarm.schemas.verdict import NextExperiment
from softarm.simulator.simulator import Simulator

LEAST = 0.5  # smallest useful separation, noise floors
# Smallest useful separation, in multiples of the best recorded trial's, which was not enough.
FURTHER = 1.5
HANG_S = 20.0  # time at rest before a flight
A_TICK = round(CONTROL_PERIOD_S / STEP_S)  # steps of the grid
LONGEST_S = 30.0  # compared part of a flight
NOTHING = "no excitation in the list separates these"


def splitting(
    model: Model, explanations: Mapping[str, Point], recorded: FitProblem, kinds: Sequence[str]
) -> NextExperiment:
    """Return the excitation that separates the closest pair of explanations best.

    Of an excitation that was recorded, only the stages that no trial of it showed count.

    Args:
        model: nominal model.
        explanations: effect -> fitted parameters, two or more.
        recorded: problem of the recorded trials, in units of the noise floors.
        kinds: excitation of each recorded trial.
    """
    names, points = tuple(explanations), tuple(explanations.values())
    grid = on_grid(flights(model, points[0]), model)
    problem = Setup(robot_views(grid, model), nuisances(model), list(EXCITATIONS)).plain()
    known, before = _known(problem, recorded, kinds), float(closest(recorded, points).max())
    far = np.where(known, 0.0, closest(problem, points)).max(axis=1)
    enough = far >= max(LEAST, FURTHER * before)
    short = enough & np.array([plan.duration_s <= LONGEST_S for plan in EXCITATIONS.values()])
    best = int(np.argmax(np.where(short, far, 0.0) if short.any() else far))
    if not enough[best]:
        why = f"{NOTHING}: the best, {list(EXCITATIONS)[best]}, would show {far[best]:.2g} noise floors"
        why += f" where {before:.2g} in the recorded data were not enough" if before else ""
        return NextExperiment(excitation=why, separates=names, expect={})
    expect = _expected(problem, best, known[best], explanations)
    return NextExperiment(excitation=list(EXCITATIONS)[best], separates=names, expect=expect)


def repeated(kind: str) -> NextExperiment:
    """Return an experiment that repeats an excitation, to separate an unknown effect from chance."""
    excitation = kind if kind in EXCITATIONS else "both"
    return NextExperiment(
        excitation=excitation,
        separates=("structure", "chance"),
        expect={
            "structure": "over five repeats the residual stays the same: an effect outside the list",
            "chance": "over five repeats the residual differs: the robot is not repeatable",
        },
    )


def flights(model: Model, point: Point) -> list[Trial]:
    """Return a simulated trial of every excitation, from rest and with exact sensors; mocap's effects are left out."""
    plans = list(EXCITATIONS.values())
    physics = {path: x for path, x in point.items() if path in PHYSICS}
    robots = Simulator(model, len(plans), ARM_HZ, overrides=physics)
    velocity, pressure = np.transpose([plan.at(0.0) for plan in plans])
    robots.step(velocity, pressure, HANG_S)
    base = np.array([0.0, model.arm.base_height_m])
    seen, sent = [], []
    for step in range(1 + round(min(LONGEST_S, max(plan.duration_s for plan in plans)) / STEP_S)):
        t = step * STEP_S
        if step % A_TICK == 0:
            sent.append(np.array([(t, *plan.at(t)) for plan in plans]))
        poses = np.zeros((len(plans), 1 + robots.links, 2))
        poses[:, 0] = base
        poses[:, 0, 0] = robots.cart_position_m
        poses[:, 1:] = robots.link_ends_m()
        axis = robots.pressure_reading_kpa, robots.cart_position_m, robots.cart_velocity_m_s
        seen.append(np.column_stack((np.full(len(plans), t), *axis, poses.reshape(len(plans), -1))))
        robots.step(sent[-1][:, 1], sent[-1][:, 2], STEP_S)
    return [_trial(plan, *(np.array(each)[:, i] for each in (sent, seen))) for i, plan in enumerate(plans)]


def _trial(plan: Excitation, sent: Array, seen: Array) -> Trial:
    """Return a trial of sent rows (stamp, cart velocity, pressure) and measured rows (stamp, readings, poses)."""
    lasts = min(plan.duration_s, LONGEST_S) + 1e-9
    sent, seen = sent[sent[:, 0] <= lasts], seen[seen[:, 0] <= lasts]
    bodies = ("cart", *(f"link{i}" for i in range(1, (seen.shape[1] - 4) // 2)))
    names = [f"{body}_{part}" for body in bodies for part in ("y", "z")]
    readings = {
        "command": _series(sent, ("cart_velocity", "pressure")),
        "pressure": _series(seen[:, :2], ("pressure",)),
        "rail": _series(seen[:, [0, 2, 3]], ("position", "velocity")),
        "mocap": _series(np.delete(seen, (1, 2, 3), axis=1), names),
    }
    return Trial(plan.name, plan.name, Path(plan.name), readings)


def _series(rows: Array, names: Sequence[str]) -> Series:
    return Series(rows[:, 0].copy(), {name: rows[:, i].copy() for i, name in enumerate(names, 1)})


def closest(problem: FitProblem, points: Sequence[Point]) -> Array:
    """Return the separation of the closest two explanations by trial and view, RMS in noise floors, [K, V].

    Nuisances may reduce the separation. It is 0 if a trial does not show a view.
    """
    pairs = [_apart(problem, *each) for one, other in combinations(points, 2) for each in ((one, other), (other, one))]
    least = np.argmin(np.max(pairs, axis=2), axis=0)
    return np.asarray(np.array(pairs)[least, np.arange(len(least))])


def _apart(problem: FitProblem, true: Point, other: Point) -> Array:
    """Return the residual of one explanation if another is true, [K, V], with fitted nuisances."""
    free = np.array([not (path in true and path in other) for path in problem.nuisance_paths])
    low, high = problem.nuisance_low * free, problem.nuisance_high * free
    parts: dict[int, list[tuple[int, Rows, Rows, int]]] = {}  # trial -> view, rows, nuisances' columns, samples
    for v, residual in enumerate(problem.whitened):
        view, (a, b) = residual.gaps.view, residual.moments([true, other])
        width = view.measured.shape[1]
        for part in slices(view.trial):
            if kept := int(np.isfinite(view.measured[part]).sum()):
                at = slice(part.start * width, part.stop * width)
                each = v, (b.rows - a.rows)[at], residual.columns[:, at], kept
                parts.setdefault(int(view.trial[part.start]), []).append(each)
    found = np.zeros((1 + max(parts), len(problem.whitened)))
    for k, seen in parts.items():
        normal = sum((columns @ columns.T).astype(np.float64) for _, _, columns, _ in seen)
        slope = sum((columns @ rows).astype(np.float64) for _, rows, columns, _ in seen)
        taken = box.solve(np.ascontiguousarray(normal), -np.asarray(slope), low, high).astype(np.float32)
        for v, rows, columns, kept in seen:
            found[k, v] = np.sqrt(np.sum((rows + taken @ columns) ** 2) / kept)
    return found


def _known(problem: FitProblem, recorded: FitProblem, kinds: Sequence[str]) -> NDArray[np.bool_]:
    """Return which excitations the recorded trials show in which views, [excitations, V]."""
    shown = set()
    for residual in recorded.whitened:
        view = residual.gaps.view
        seen = view.trial[np.isfinite(view.measured).any(axis=1)]
        shown |= {(kinds[k], view.stage) for k in np.unique(seen)}
    stages = [residual.gaps.view.stage for residual in problem.whitened]
    return np.array([[(name, stage) in shown for stage in stages] for name in EXCITATIONS])


def _expected(
    problem: FitProblem, flight: int, known: NDArray[np.bool_], explanations: Mapping[str, Point]
) -> dict[str, str]:
    """Return the expected result of each explanation where they differ most, in a stage not recorded."""
    best: tuple[float, dict[str, str]] = (-1.0, {})
    for residual, seen in zip(problem.whitened, known, strict=True):
        view = residual.gaps.view
        mine = np.flatnonzero((view.trial == flight) & np.isfinite(view.measured).all(axis=1))
        if seen or not len(mine):
            continue
        gaps = residual.gaps.fetch([{}, *explanations.values()])
        change = np.stack([gaps[()] - gaps[residual.gaps.key(p)] for p in explanations.values()])[:, mine]
        spread = np.ptp(change, axis=0) / view.floor
        t, c = np.unravel_index(int(np.argmax(spread)), spread.shape)
        when = view.t_s[mine[t]]
        expected = {
            name: f"{view.stage}, {view.channels[c]}: {x:+.3g} {view.unit} relative to nominal at {when:.1f} s"
            for name, x in zip(explanations, change[:, t, c], strict=True)
        }
        best = max(best, (float(spread[t, c]), expected), key=lambda each: each[0])
    return best[1]
