"""Regression of the paper ([P] SM-B): torques by inverse dynamics, parameters by least squares."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.identify.bench import PARAMETERS
from softarm.diagnosis.identify.motion import Derivatives
from softarm.schemas.model import Arm


@dataclass(frozen=True, slots=True)
class Regression:
    """Parameters from a regression of the torques."""

    column: Array  # [4 n] in bench.PARAMETERS order
    torque_nm: tuple[Array, ...]  # a trial each, [M, n], by inverse dynamics
    rmse_nm: float  # RMS torque error of the parameters over all joints and samples

    @property
    def range_nm(self) -> tuple[float, float]:
        """Return the smallest and the largest torque, N m."""
        return min(float(t.min()) for t in self.torque_nm), max(float(t.max()) for t in self.torque_nm)


def joint_torques(arm: Arm, motion: Derivatives) -> Array:
    """Return the torques at the joints by inverse dynamics ([P] eq. 2), N m, [M, n], positive towards +y.

    In absolute angles phi, with S and C as in simulator/kernel/, link i takes
    sum_j C_ij (cos(phi_i - phi_j) phi_j'' + sin(phi_i - phi_j) phi_j'^2) + S_i (cos phi_i y'' + g sin phi_i);
    a joint carries all links beyond it.
    """
    length, mass = np.array(arm.link_length_m), np.array(arm.link_mass_kg)
    beyond = np.cumsum(mass[::-1])[::-1] - mass
    moment = length * (mass / 2 + beyond)
    lower = np.tril(np.outer(moment, length), -1)
    coupling = lower + lower.T + np.diag(np.array(arm.link_inertia_kg_m2) + length**2 * (mass / 4 + beyond))
    phi = motion.angles_rad
    apart = phi[:, :, None] - phi[:, None, :]
    force = np.einsum("ij,tij,tj->ti", coupling, np.cos(apart), motion.accelerations_rad_s2)
    force += np.einsum("ij,tij,tj->ti", coupling, np.sin(apart), motion.rates_rad_s**2)
    force += moment * (np.cos(phi) * motion.cart_m_s2[:, None] + arm.gravity_m_s2 * np.sin(phi))
    return np.asarray(np.cumsum(force[:, ::-1], axis=1)[:, ::-1])


def fit(arm: Arm, motions: Sequence[Derivatives]) -> Regression:
    """Fit K, D, b and the offset of every joint by least squares ([P] eq. 3), with K and D not negative."""
    torques = [joint_torques(arm, motion) for motion in motions]
    target = np.concatenate(torques)
    designs = [_design(motion) for motion in motions]
    design = np.concatenate(designs)
    bounds = ([0.0, 0.0, -np.inf, -np.inf], [np.inf] * len(PARAMETERS))
    joints = np.array([lsq_linear(design[:, i], target[:, i], bounds).x for i in range(arm.links)])
    column = joints.T.ravel()
    return Regression(column, tuple(torques), rmse_nm(column, motions, torques))


def rmse_nm(column: Array, motions: Sequence[Derivatives], torques: Sequence[Array]) -> float:
    """Return the RMS difference of torques from those of given parameters, N m; column: [4 n]."""
    errors = [torque - modelled(column, motion) for torque, motion in zip(torques, motions, strict=True)]
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


def modelled(column: Array, motion: Derivatives) -> Array:
    """Return the torques of given parameters ([P] eq. 1), N m, [M, n]; column: [4 n]."""
    return np.asarray(np.einsum("tik,ki->ti", _design(motion), column.reshape(len(PARAMETERS), -1)))


def _design(motion: Derivatives) -> Array:
    """Return the regressors of each joint, [M, n, 4]: -theta, -theta', -p, -1."""
    theta = np.diff(motion.angles_rad, axis=1, prepend=0.0)
    rate = np.diff(motion.rates_rad_s, axis=1, prepend=0.0)
    pressure = np.broadcast_to(motion.pressure_kpa[:, None], theta.shape)
    return -np.stack((theta, rate, pressure, np.ones_like(theta)), axis=2)
