"""Gap of the tip, with the whole chain simulated from commands alone."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine.view import Point
from softarm.diagnosis.robot.trial_grid import STEP_S, TrialGrid
from softarm.diagnosis.robot.views import ABOUT_RAIL, ARM_HZ, PHYSICS, delayed, directions, value_at
from softarm.schemas.model import Model
from softarm.simulator.simulator import Simulator

# Two good simulators of one robot differ by 5.4 to 6.6 mm at the tip, without tolerated deviations
# (`robot/comparison.py`); most of it is drift of the cart.
FLOOR_M = 0.009


def tip_gap(grid: TrialGrid, model: Model, points: Sequence[Point]) -> NDArray[np.float32]:
    """Return measured minus simulated tip (y, z) at each point, m, [P, M, 2]; NaN without tracking.

    The simulation starts from the measured pose at rest and follows the commands alone.
    """
    return _flown(grid, model, points)[0]


def stage_of_tip_gap(grid: TrialGrid, model: Model) -> str:
    """Return the stage in which the nominal model's tip gap arises, `rail` or `arm`."""
    tip, cart = _flown(grid, model, [{}])
    with_cart = np.nanmean(tip[0, :, 0] ** 2)
    return "rail" if np.nanmean((tip[0, :, 0] - cart[0]) ** 2) < 0.5 * with_cart else "arm"


def _flown(grid: TrialGrid, model: Model, points: Sequence[Point]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return measured minus simulated tip [P, M, 2] and cart [P, M] at each point."""
    k = len(grid.trials)
    names = sorted({path for point in points for path in point if path in PHYSICS})
    overrides = {name: np.repeat([value_at(point, name, model) for point in points], k) for name in names}
    simulator = Simulator(model, len(points) * k, ARM_HZ, overrides=overrides)
    joints = np.tile(np.diff(directions(grid), axis=1, prepend=0.0), (len(points), 1))
    first = np.nan_to_num(grid.pressure_kpa[0])
    start = np.tile(grid.hinge_m[0], len(points))
    simulator.reset(cart_position_m=start, joint_angles_rad=joints, pressure_kpa=np.tile(first, len(points)))
    velocity, pressure, late = (
        np.tile(x, (1, len(points))) for x in (grid.cart_velocity_m_s, grid.pressure_command_kpa, grid.late_s)
    )
    held = np.tile(grid.held, len(points))
    flown = np.empty((len(grid.t_s), len(points) * k, 2), np.float32)
    carts = np.empty((len(grid.t_s), len(points) * k), np.float32)
    for t in range(len(grid.t_s)):
        tip = simulator.tip_m()
        tip[:, 0] += np.where(held, start - simulator.cart_position_m, 0.0)
        flown[t] = tip
        carts[t] = np.where(held, start, simulator.cart_position_m)
        simulator.step(np.where(held, 0.0, velocity[t]), pressure[t], STEP_S, late_s=late[t])
    seen = flown.reshape(len(flown), len(points), k, 2)
    for i, point in enumerate(points):
        seen[:, i] = _as_seen(seen[:, i], point, model)
    step, trial = grid.sample
    flat = seen[step, :, trial].transpose(1, 0, 2)
    n = grid.links
    measured = np.stack((grid.links_m[:, :, n - 1] + grid.cart_y_m, grid.links_m[:, :, -1] + grid.cart_z_m), axis=2)
    way = np.asarray(grid.flat(grid.hinge_m)[None] - carts.reshape(len(carts), len(points), k)[step, :, trial].T)
    return np.asarray(grid.flat(measured)[None].astype(np.float32) - flat), way.astype(np.float32)


def _as_seen(tip: NDArray[np.float32], point: Point, model: Model) -> NDArray[np.float32]:
    """Return a true tip [T, K, 2] as mocap measures it: delayed, rotated, scaled and shifted."""
    names = ("rotation.angle", "latency.delay", "offset.y", "offset.z", "scale.scale")
    turn, late, y, z, scale = (value_at(point, f"mocap.{name}", model) for name in names)
    pivot = np.array((0.0, model.arm.base_height_m if point.get(ABOUT_RAIL, 1.0) > 0 else 0.0))
    away = delayed(tip, late) - pivot
    rotation = np.array(((np.cos(turn), np.sin(turn)), (-np.sin(turn), np.cos(turn))))
    return np.asarray((1 + scale) * (away @ rotation) + pivot + np.array((y, z)), dtype=np.float32)
