"""Estimator of the joint angles and rates from the tip, the cart and the sent commands.

A cubature Kalman filter (Arasaratnam and Haykin, IEEE Transactions on Automatic Control 54, 2009): one batch
simulates 2 d points around the estimate, and the measurement corrects their mean. It starts from the tip alone: the
links before the last have almost no mass, so the arm has the shape of least elastic energy for its tip and torque.
"""

import numpy as np
from numpy.typing import NDArray

from softarm.schemas.model import Arm, Model
from softarm.schemas.policy import Observation, places
from softarm.schemas.robot import TRAINING_PHYSICS_RATE_HZ

Array = NDArray[np.float64]

ITERATIONS = 12
SOFTNESS = 1e-4  # m^2 rad/(N m), regularises the equations of a straight arm, whose tip cannot move along it


def tip_from_cart_m(arm: Arm, joint_angles_rad: Array) -> Array:
    """Return the tip relative to the cart's hinge: y and height, [..., 2], from angles [..., n]."""
    absolute = np.cumsum(joint_angles_rad, axis=-1)
    lengths = np.array(arm.link_length_m)
    return np.stack((np.sin(absolute) @ lengths, -np.cos(absolute) @ lengths), axis=-1)


def tip_jacobian_m(arm: Arm, joint_angles_rad: Array) -> Array:
    """Return the Jacobian of the tip with respect to the joints, [2, n]."""
    absolute = np.cumsum(joint_angles_rad)
    lengths = np.array(arm.link_length_m)
    moves = np.stack((lengths * np.cos(absolute), lengths * np.sin(absolute)))
    return np.asarray(moves[:, ::-1].cumsum(axis=1)[:, ::-1])


def likely_joints(arm: Arm, tip_m: Array, tip_velocity_m_s: Array, pressure_kpa: float) -> tuple[Array, Array]:
    """Return joint angles (rad) and rates (rad/s), [n] each, of least elastic energy.

    Position and velocity of the tip are y and z, [2], relative to the hinge.
    """
    give = 1.0 / np.maximum(np.array(arm.stiffness_nm_rad), 1e-3)
    torque = np.array(arm.muscle_gain_nm_kpa) * pressure_kpa + np.array(arm.torque_offset_nm)
    free = -give * torque
    angles = 0.5 * free
    for _ in range(ITERATIONS):
        moves = tip_jacobian_m(arm, angles)
        back = give[:, None] * moves.T
        missing = tip_m - tip_from_cart_m(arm, angles) - moves @ (free - angles)
        change = free - angles + back @ np.linalg.solve(moves @ back + SOFTNESS * np.eye(2), missing)
        angles = angles + np.clip(change, -0.3, 0.3)
    moves = tip_jacobian_m(arm, angles)
    back = give[:, None] * moves.T
    rates = back @ np.linalg.solve(moves @ back + SOFTNESS * np.eye(2), tip_velocity_m_s)
    return angles, rates


_TIP, _TIP_VELOCITY = places("tip_y_m", "tip_z_m"), places("tip_vy_m_s", "tip_vz_m_s")
_MEASURED = places("cart_position_m", "tip_y_m", "tip_z_m", "pressure_kpa")  # the velocities are differences of these
# Standard deviations of the initial estimate:
START_ANGLE_RAD, START_RATE_RAD_S = 0.05, 0.6
START_CART_M, START_CART_M_S, START_PRESSURE_KPA = 1e-3, 0.05, 0.1
# Standard deviations of the process noise per tick:
DRIFT_ANGLE_RAD, DRIFT_RATE_RAD_S = 2e-3, 0.15
DRIFT_CART_M, DRIFT_CART_M_S, DRIFT_PRESSURE_KPA = 5e-4, 0.02, 0.1
# Standard deviations of a measurement:
SEEN_M, SEEN_KPA = 1e-3, 0.1


class Estimator:
    """State [2 n + 3]: cart y, joint angles, cart velocity, joint rates, pressure; its mean and covariance.

    Robot 0 of `simulator` is the estimate, the others are the points around it; all have the same delayed commands.
    """

    def __init__(self, model: Model, period_s: float) -> None:
        from softarm.simulator.simulator import Simulator  # imports numba, which only this policy needs

        self._arm = model.arm
        n = model.arm.links
        self._links, self._period_s = n, period_s
        self.size = 2 * n + 3
        self.simulator = Simulator(model, robots=2 * self.size + 1, physics_rate_hz=TRAINING_PHYSICS_RATE_HZ)
        self._drift = self._variances(
            DRIFT_CART_M, DRIFT_ANGLE_RAD, DRIFT_CART_M_S, DRIFT_RATE_RAD_S, DRIFT_PRESSURE_KPA
        )
        self._noise = np.diag(np.square([SEEN_M, SEEN_M, SEEN_M, SEEN_KPA]))
        self.mean: Array = np.zeros(self.size)
        self._covariance: Array = np.eye(self.size)
        self._seen: Array = np.full(4, np.nan)

    def begin(self, observation: Array) -> None:
        """Initialise the estimate from a single observation [8]."""
        seen = Observation(*observation)
        cart, cart_velocity, pressure = seen.cart_position_m, seen.cart_velocity_m_s, seen.pressure_kpa
        hinge = np.array((cart, self._arm.base_height_m))
        angles, rates = likely_joints(
            self._arm, observation[_TIP] - hinge, observation[_TIP_VELOCITY] - (cart_velocity, 0.0), pressure
        )
        self.mean = np.array([cart, *angles, cart_velocity, *rates, pressure])
        self._covariance = self._variances(
            START_CART_M, START_ANGLE_RAD, START_CART_M_S, START_RATE_RAD_S, START_PRESSURE_KPA
        )
        self._seen = np.full(4, np.nan)
        self.simulator.reset(pressure_kpa=pressure)
        # This step only puts the last command into the delay; the robots are placed by the correction.
        self.simulator.step(float(seen.previous_cart_velocity_command_m_s), float(pressure), self._period_s)
        self._correct(observation)

    def follow(self, observation: Array, sent_velocity_m_s: float, sent_pressure_kpa: float) -> None:
        """Simulate the last tick with the sent command and correct the estimate by the new observation [8]."""
        self.simulator.step(sent_velocity_m_s, sent_pressure_kpa, self._period_s)
        simulator, n = self.simulator, self._links
        flown = np.empty((2 * self.size, self.size))
        flown[:, 0] = simulator.cart_position_m[1:]
        flown[:, 1 : n + 1] = simulator.joint_angles_rad[1:]
        flown[:, n + 1] = simulator.cart_velocity_m_s[1:]
        flown[:, n + 2 : -1] = np.diff(simulator.link_rates_rad_s[1:], axis=1, prepend=0.0)
        flown[:, -1] = simulator.pressure_kpa[1:]
        self.mean = flown.mean(axis=0)
        away = flown - self.mean
        self._covariance = away.T @ away / len(flown) + self._drift
        self._correct(observation)

    def distance_m(self, observation: Array) -> float:
        """Return the distance between estimated and observed tip, m."""
        return float(np.linalg.norm(self.tip_m() - observation[_TIP]))

    def tip_m(self) -> Array:
        """Return the estimated tip position y, z, m."""
        return self._look(self.mean)[1:3]

    def _variances(self, cart: float, angle: float, cart_velocity: float, rate: float, pressure: float) -> Array:
        """Return a diagonal covariance from standard deviations."""
        n = self._links
        return np.diag(np.square([cart, *n * [angle], cart_velocity, *n * [rate], pressure]))

    def _look(self, states: Array) -> Array:
        """Return the measurement of states [..., d]: cart y, tip y, tip z and pressure, [..., 4]."""
        cart = states[..., 0]
        tip = tip_from_cart_m(self._arm, states[..., 1 : self._links + 1])
        return np.stack((cart, cart + tip[..., 0], self._arm.base_height_m + tip[..., 1], states[..., -1]), axis=-1)

    def _correct(self, observation: Array) -> None:
        """Correct the estimate by an observation; a repeated observation is an old frame and has no effect."""
        measured = observation[_MEASURED]
        if not np.array_equal(measured, self._seen):
            self._seen = measured
            self._weigh(measured)
        self._put()

    def _weigh(self, measured: Array) -> None:
        states = self._points()
        seen = self._look(states)
        expected = seen.mean(axis=0)
        apart, away = seen - expected, states - self.mean
        innovation = apart.T @ apart / len(states) + self._noise
        gain = np.linalg.solve(innovation, apart.T @ away / len(states)).T
        self.mean = self.mean + gain @ (measured - expected)
        covariance = self._covariance - gain @ innovation @ gain.T
        self._covariance = 0.5 * (covariance + covariance.T)

    def _points(self) -> Array:
        """Return the cubature points [2 d, d]."""
        root = np.sqrt(self.size) * np.linalg.cholesky(self._covariance + 1e-12 * np.eye(self.size)).T
        return np.concatenate((self.mean + root, self.mean - root))

    def _put(self) -> None:
        """Place the simulated robots at the estimate and at the points around it."""
        states = np.concatenate((self.mean[None], self._points()))
        n = self._links
        self.simulator.place(
            states[:, 0],
            states[:, n + 1],
            states[:, 1 : n + 1].cumsum(axis=1),
            states[:, n + 2 : -1].cumsum(axis=1),
            states[:, -1],
        )
