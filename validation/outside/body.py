"""Body of the robot: a cart on a belt and a five-link arm hanging from it, in absolute angles.

The numbers are the robot's (its paper and the configuration released with it), the equations are independent. q = (y,
phi_1 .. phi_5): cart along the rail, angle of each link against the vertical, positive towards +y. One step is linearly
implicit in the stiff terms (hinges, servo, friction, end stops) and explicit in the rest. Units: m, rad, s, N, kPa.
"""

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LINKS = 5
LENGTH_M = 0.0885
BASE_Z_M = 0.965
MASS_KG = np.array([0.005, 0.005, 0.005, 0.005, 0.1])
INERTIA_KG_M2 = np.array([6.89e-6] * 4 + [1.0156e-4])  # about each link's centre
STIFFNESS = np.array([0.8385, 1.5400, 1.5109, 1.2887, 0.4347])  # N m/rad
DAMPING = np.array([0.0178, 0.0304, 0.0528, 0.0367, 0.0223])  # N m s/rad
MUSCLE_PER_PSI = np.array([0.0247, 0.0616, 0.0779, 0.0498, 0.0268])  # N m/psi, towards -y
OFFSET_NM = np.array([0.0007, 0.0062, 0.0402, 0.0160, 0.0133])  # towards -y
PSI_KPA = 6.894757
INFLATE_S, DEFLATE_S = 0.158, 0.221  # time constants of the regulated pressure
CART_KG = 0.4
STOP_M = 0.30  # the mechanical ends of travel, from the middle
STOP_N_M, STOP_NS_M = 2e5, 4e2  # stiff buffer without rebound
GRAVITY = 9.81


_SLIP_M_S = 0.005  # the belt's friction fades below this speed
_EMPTY_KPA = 1e-9


class Body:
    """Arm that starts straight, at rest and vented; only `step` moves it."""

    def __init__(self, friction_n: float = 3.0, cart_m: float = 0.0) -> None:
        arms = np.tril(np.full((LINKS, LINKS), LENGTH_M), -1) + np.eye(LINKS) * LENGTH_M / 2  # lever of phi_j on COM k
        self._first = MASS_KG @ arms
        self._second = arms.T @ (MASS_KG[:, None] * arms)
        self._moving_kg = CART_KG + MASS_KG.sum()
        self._bend = np.eye(LINKS) - np.eye(LINKS, k=-1)  # theta = bend @ phi
        self._spring = self._bend.T @ np.diag(STIFFNESS) @ self._bend
        self._damper = self._bend.T @ np.diag(DAMPING) @ self._bend
        self._muscle = self._bend.T @ MUSCLE_PER_PSI / PSI_KPA
        self._offset = self._bend.T @ OFFSET_NM
        self._friction_n = friction_n
        self.q: Array = np.zeros(1 + LINKS)
        self.q[0] = cart_m
        self.dq: Array = np.zeros(1 + LINKS)
        self.pressure_kpa = 0.0

    @property
    def cart_m(self) -> float:
        """Return the cart position from the middle of the rail, m."""
        return float(self.q[0])

    @property
    def cart_m_s(self) -> float:
        """Return the velocity of the cart, m/s."""
        return float(self.dq[0])

    def step(self, h: float, set_kpa: float, force_n: float, servo_ns_m: float) -> None:
        """Advance `h` seconds under the motor's force, N, and its stiffness against velocity, N s/m."""
        self._follow(h, set_kpa)
        sin, cos = np.sin(self.q[1:]), np.cos(self.q[1:])
        turn, speed = self.dq[1:], float(self.dq[0])
        between = self.q[1:, None] - self.q[None, 1:]
        mass = np.empty((1 + LINKS, 1 + LINKS))
        mass[0, 0] = self._moving_kg
        mass[0, 1:] = mass[1:, 0] = self._first * cos
        mass[1:, 1:] = self._second * np.cos(between) + np.diag(INERTIA_KG_M2)
        force = np.empty(1 + LINKS)
        force[0] = force_n + self._first @ (sin * turn * turn)
        force[1:] = -(self._second * np.sin(between)) @ (turn * turn) - GRAVITY * self._first * sin
        force[1:] -= self._muscle * self.pressure_kpa + self._offset
        # Implicit in the hinges, the servo, friction and the stops.
        force[1:] -= self._spring @ (self.q[1:] + h * turn) + self._damper @ turn
        mass[1:, 1:] += h * self._damper + h * h * self._spring
        slip = np.tanh(speed / _SLIP_M_S)
        force[0] -= self._friction_n * slip
        mass[0, 0] += h * servo_ns_m + h * self._friction_n / _SLIP_M_S * (1 - slip * slip)
        beyond = abs(self.q[0]) - STOP_M
        if beyond > 0:
            force[0] -= STOP_N_M * (np.sign(self.q[0]) * beyond + h * speed) + STOP_NS_M * speed
            mass[0, 0] += h * STOP_NS_M + h * h * STOP_N_M
        self.dq = self.dq + h * np.linalg.solve(mass, force)
        self.q = self.q + h * self.dq

    def _follow(self, h: float, set_kpa: float) -> None:
        lag_s = INFLATE_S if set_kpa > self.pressure_kpa else DEFLATE_S
        self.pressure_kpa += (set_kpa - self.pressure_kpa) * -math.expm1(-h / lag_s)
        if abs(self.pressure_kpa) < _EMPTY_KPA:
            self.pressure_kpa = 0.0

    def poses(self) -> dict[str, tuple[float, float, float]]:
        """Return y, z and angle of the first hinge and of the far end of each link."""
        y = self.q[0] + LENGTH_M * np.cumsum(np.sin(self.q[1:]))
        z = BASE_Z_M - LENGTH_M * np.cumsum(np.cos(self.q[1:]))
        poses = {"cart": (float(self.q[0]), BASE_Z_M, 0.0)}
        for i in range(LINKS):
            poses[f"link{i + 1}"] = (float(y[i]), float(z[i]), float(self.q[1 + i]))
        return poses
