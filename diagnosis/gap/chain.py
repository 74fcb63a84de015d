"""The whole chain, from commands alone to the tip: how far off nominal and patched simulators are where it counts."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from diagnosis.gap.recordings import STEP_S, Flight
from diagnosis.gap.robot_views import ARM_HZ, ON_MOTOR, _delayed, _directions, _parameters
from diagnosis.gap.view import Array, Point
from schemas.model import Model
from simulator.effects import REGISTRY, value
from simulator.simulator import Simulator

FLOOR_M = 0.004  # what two honest simulators of one robot differ by at the tip, from commands alone
_PHYSICS = _parameters(*(n for n, e in REGISTRY.items() if e.stage in ("pressure", "rail", "arm")))


def tip_gap(flight: Flight, model: Model, points: Sequence[Point]) -> NDArray[np.float32]:
    """Measured minus simulated tip (y, z) at each point, [P, M, 2], m; NaN where mocap saw nothing.

    A trial begins where the robot was seen to hang; everything after follows from the commands.
    """
    k = len(flight.trials)
    names = sorted({path for point in points for path in point if path in _PHYSICS})

    def each(path: str) -> Array:
        effect, _, parameter = path.rpartition(".")
        return np.array([p.get(path, value(model, effect, parameter)) for p in points])

    simulator = Simulator(model, len(points) * k, ARM_HZ, overrides={n: np.repeat(each(n), k) for n in names})
    joints = np.tile(np.diff(_directions(flight), axis=1, prepend=0.0), (len(points), 1))
    first = np.nan_to_num(flight.pressure_kpa[0])
    simulator.reset(
        cart_position_m=np.tile(flight.hinge_m[0], len(points)), joint_angles_rad=joints, pressure_kpa=np.tile(first, len(points))
    )
    velocity, pressure, late = (
        np.tile(x, (1, len(points))) for x in (flight.cart_velocity_m_s, flight.pressure_command_kpa, flight.late_s)
    )
    held = np.tile(flight.held, len(points))
    seen = np.empty((len(flight.t_s), len(points) * k, 2), np.float32)
    start = np.tile(flight.hinge_m[0], len(points))
    for t in range(len(flight.t_s)):
        tip = simulator.tip_m()
        tip[:, 0] += np.where(held, start - simulator.cart_position_m, 0.0)
        seen[t] = tip
        simulator.step(np.where(held, 0.0, velocity[t]), pressure[t], STEP_S, late_s=late[t])
    seen = seen.reshape(len(seen), len(points), k, 2)
    measured = np.stack(
        (flight.links_m[:, :, flight.links - 1] + flight.cart_y_m, flight.links_m[:, :, -1] + flight.cart_z_m), axis=2
    )
    columns = zip(*(each(f"mocap.{n}") for n in ("latency.delay", "rotation.angle", "scale.scale", "offset.y", "offset.z")), strict=True)
    for i, (latency, turn, scale, y, z) in enumerate(columns):
        part = _delayed(seen[:, i], float(latency))
        part = part - (0.0, model.arm.base_height_m) if points[i].get("mocap.rotation.about_rail", 1.0) > 0 else part
        turned = np.stack((np.cos(turn) * part[..., 0] - np.sin(turn) * part[..., 1], np.sin(turn) * part[..., 0] + np.cos(turn) * part[..., 1]), axis=-1)
        back = (0.0, model.arm.base_height_m) if points[i].get("mocap.rotation.about_rail", 1.0) > 0 else (0.0, 0.0)
        seen[:, i] = (1 + scale) * turned + back + np.array((y, z))
    step, trial = flight.sample
    flat = seen[step, :, trial].transpose(1, 0, 2)
    return np.asarray(flight.flat(measured)[None].astype(np.float32) - flat)


__all__ = ["FLOOR_M", "ON_MOTOR", "tip_gap"]
