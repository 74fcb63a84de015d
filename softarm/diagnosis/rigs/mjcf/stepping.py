"""Recordings that a simulation of the model itself has made: how the integrators of MuJoCo move a joint.

Positions of an integrator of first order are those of the leapfrog method, whose forces act around the start of a step
(Hairer, Lubich and Wanner 2006, Geometric Numerical Integration, I.1.4). A command then acts half a step early. Forces
by speed have the speed of half a step before, or, where they are implicit, of half a step after.
"""

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Stepping:
    """Integration of a simulated joint."""

    half_s: float  # half a step; 0 for an integrator of higher order
    damping_s: float  # time by which the speed of the joint's damping is ahead
    loop_s: float  # time by which the speed in a position loop is ahead


def stepping(mujoco: Any, model: Any) -> Stepping:
    """Return the integration of a model; see MuJoCo's documentation, Computation: Numerical integration."""
    integrator, euler = int(model.opt.integrator), int(mujoco.mjtIntegrator.mjINT_EULER)
    if integrator == int(mujoco.mjtIntegrator.mjINT_RK4):
        return Stepping(0.0, 0.0, 0.0)
    half_s = 0.5 * float(model.opt.timestep)
    explicit = bool(model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP))
    if integrator != euler:
        return Stepping(half_s, half_s, half_s)
    return Stepping(half_s, -half_s if explicit else half_s, -half_s)
