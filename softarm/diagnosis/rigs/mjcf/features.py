"""Features of a joint's motion, from which a flexible model explains its residual."""

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.grid import time_since_change
from softarm.diagnosis.rigs.mjcf.torques import load
from softarm.diagnosis.rigs.motion import STILL, Motion, summed_twice


def features(
    motion: Motion, edges: NDArray[np.int64], terms: Array, sent: Array | None, speed: float
) -> dict[str, Array]:
    """Return the features of a trial's samples by name, [T] each.

    Args:
        motion: motion of the joint.
        edges: first samples of the windows, and the end.
        terms: rigid-body terms, [ROWS, T].
        sent: command at each sample, [T], or None without an actuator.
        speed: large speed of the joint, rad/s or m/s.
    """
    t, v = motion.grid.t_s, motion.speed
    direction = np.sign(np.where(np.abs(v) > STILL * speed, v, 0.0))
    found = {
        "torque": load(terms, motion.position, v),
        "speed": v,
        "direction": direction,
        "position": motion.position,
        "time since reversal": time_since_change(t, np.sign(v)),
        "time in the window": t - t[np.repeat(edges[:-1], np.diff(edges))],
    }
    if sent is not None:
        found["command"] = sent
    for name, values in {"direction": direction, "speed": v, "drag": v * np.abs(v)}.items():
        found[f"{name}, summed"] = summed_twice(values, edges, motion.grid.step_s)
    return found
