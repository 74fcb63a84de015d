"""Models of hanging links: a pendulum, a chain, an arm with motors, a pendulum on a moving cart.

Angles are absolute and zero when hanging down. Lagrange's equations of a planar chain (e.g. Spong, Robot Modeling and
Control, ch. 7) for many lanes at once, integrated by Runge-Kutta of order 4; friction is constant during a step.
"""

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from validation.rigs.laws import GRAVITY_M_S2, Array, Bristles, check_names, worn

# Parameters per joint and per lane; missing ones are neutral.
JOINT_PARAMETERS: Mapping[str, float] = {
    "mass_kg": 1.0,
    "centre_m": 0.5,
    "inertia_kg_m2": 0.08,
    "length_m": 1.0,
    "viscous_nm_s": 0.0,
    "friction_nm": 0.0,
    "bias_rad": 0.0,  # constant error of the encoder
}
LANE_PARAMETERS: Mapping[str, float] = {
    "payload_kg": 0.0,
    "payload_m": 1.0,  # distance from the last joint
    "tilt_rad": 0.0,
    "moment": 0.0,  # relative error of the moment of the weight
    "drag_n_s2_m2": 0.0,  # drag of each link at its centre
    "strength": 0.0,  # relative error of the torques
    "delay_s": 0.0,  # delay of the torques
    "offset_nm": 0.0,  # constant torque on the first joint
    "ripple_nm": 0.0,  # torque that repeats with the angle of the first joint
    "ripple_per_turn": 12.0,
    "kink_nm_rad": 0.0,  # stiffness of a cable that pulls beyond `kink_rad`
    "kink_rad": 0.0,
    "hum_nm": 0.0,  # amplitude of a torque at 1 Hz
    "wear": 0.0,  # share of the friction that is present at first; 0: all
}
Lane = Mapping[str, float | tuple[float, ...]]
# Step, angles [K, n], rates [K, n] -> torques, N m [K, n].
Torques = Callable[[int, Array, Array], Array]


class Links:
    """Chains of all lanes; `state` [2, L, n] has the angles, rad, and rates, rad/s."""

    def __init__(self, lanes: Sequence[Lane], clock_s: Array, dt_s: float, n: int) -> None:
        """Create the chains of n links.

        Raises:
            KeyError: A name is neither in `JOINT_PARAMETERS` nor in `LANE_PARAMETERS`.
        """
        check_names("a chain", lanes, {*JOINT_PARAMETERS, *LANE_PARAMETERS})
        joint = {
            name: np.array([np.broadcast_to(lane.get(name, value), n) for lane in lanes], dtype=float)
            for name, value in JOINT_PARAMETERS.items()
        }
        self.p = {
            name: np.array([lane.get(name, v) for lane in lanes], dtype=float) for name, v in LANE_PARAMETERS.items()
        }
        self._drags = bool(np.any(self.p["drag_n_s2_m2"]))
        self.n, self.dt_s, self.clock_s, self.bias = n, dt_s, clock_s, joint["bias_rad"]
        mass, centre, inertia, length = (joint[k] for k in ("mass_kg", "centre_m", "inertia_kg_m2", "length_m"))
        beyond = np.cumsum(mass[:, ::-1], axis=1)[:, ::-1] - mass + self.p["payload_kg"][:, None]
        beyond[:, -1] = 0.0
        arm = mass * centre + length * beyond
        arm[:, -1] += self.p["payload_kg"] * self.p["payload_m"]
        own = inertia + mass * centre**2 + length**2 * beyond
        own[:, -1] += self.p["payload_kg"] * self.p["payload_m"] ** 2
        self.arm, self.own, self.length, self.centre = arm, own, length, centre
        low, high = np.minimum.outer(range(n), range(n)), np.maximum.outer(range(n), range(n))
        self.coupling = length[:, low] * arm[:, high]
        self.coupling[:, range(n), range(n)] = 0.0
        self.viscous, self.state = joint["viscous_nm_s"], np.zeros((2, len(lanes), n))
        level = joint["friction_nm"] * worn(self.p, clock_s)[:, None]
        self.rub = Bristles(level, level, own, 1e-3, dt_s)

    def step(self, t_s: float, torque: Array, push: tuple[Array, Array, Array]) -> None:
        """Integrate all chains over one step.

        Args:
            torque: Torques of the motors, N m [L, n].
            push: Accelerations of the base at the start, middle and end of the step, m/s^2 [L] each.
        """
        q, v = self.state
        applied = torque * (1 + self.p["strength"][:, None])
        applied[:, 0] += self.p["offset_nm"] + self.p["hum_nm"] * np.sin(2 * np.pi * (self.clock_s + t_s))
        if self.rub.any:
            applied = applied - self.rub.force(v - np.concatenate((np.zeros((len(v), 1)), v[:, :-1]), axis=1))
        h = self.dt_s
        a1 = self.accelerations(q, v, applied, push[0])
        v2 = v + h / 2 * a1
        a2 = self.accelerations(q + h / 2 * v, v2, applied, push[1])
        v3 = v + h / 2 * a2
        a3 = self.accelerations(q + h / 2 * v2, v3, applied, push[1])
        v4 = v + h * a3
        a4 = self.accelerations(q + h * v3, v4, applied, push[2])
        self.state[0] = q + h / 6 * (v + 2 * v2 + 2 * v3 + v4)
        self.state[1] = v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)

    def accelerations(self, q: Array, v: Array, applied: Array, push: Array) -> Array:
        """Return the angular accelerations [L, n] for joint torques, N m [L, n], and base accelerations, m/s^2 [L]."""
        p = self.p
        relative = v.copy()
        relative[:, 1:] -= v[:, :-1]
        joint = applied - self.viscous * relative
        joint[:, 0] += p["ripple_nm"] * np.sin(p["ripple_per_turn"] * q[:, 0])
        joint[:, 0] -= p["kink_nm_rad"] * np.maximum(q[:, 0] - p["kink_rad"], 0.0)
        total = joint.copy()
        total[:, :-1] -= joint[:, 1:]
        weight = GRAVITY_M_S2 * (1 + p["moment"])[:, None] * np.sin(q + p["tilt_rad"][:, None])
        total -= self.arm * (weight + np.cos(q) * push[:, None])
        if self._drags:
            total += self._drag(q, v)
        if self.n == 1:
            return np.asarray(total / self.own)
        apart = q[:, :, None] - q[:, None, :]
        total -= np.einsum("lij,lj->li", self.coupling * np.sin(apart), v * v)
        matrix = self.coupling * np.cos(apart)
        matrix[:, range(self.n), range(self.n)] = self.own
        return np.asarray(np.linalg.solve(matrix, total[:, :, None])[:, :, 0])

    def _drag(self, q: Array, v: Array) -> Array:
        """Return the torques of the links' drag [L, n]."""
        out = np.zeros_like(q)
        c, s = np.cos(q), np.sin(q)
        for i in range(self.n):
            arms = [*(self.length[:, j] for j in range(i)), self.centre[:, i]]
            y = sum(arms[j] * c[:, j] * v[:, j] for j in range(i + 1))
            z = sum(arms[j] * s[:, j] * v[:, j] for j in range(i + 1))
            force = -self.p["drag_n_s2_m2"] * np.hypot(y, z)
            for j in range(i + 1):
                out[:, j] += force * arms[j] * (y * c[:, j] + z * s[:, j])
        return out


def swing(
    start: Array,
    lanes: Sequence[Lane],
    clock_s: Array,
    dt_s: float,
    steps: int,
    trials: int,
    base: Array | None = None,
    torques: Torques | None = None,
    window_s: float = math.inf,
) -> Array:
    """Return the angles of lanes that start at rest, rad [N, L, n]; the lanes are variants of K trials (see `cart`).

    Args:
        start: Start angles of each trial, rad [K, n].
        base: Accelerations of the base at half steps, m/s^2 [2 N + 1, K].
        torques: Controller, called at every step with the angles and rates of the recorded lanes.
        window_s: Period after which all variants are reset to the state of the recorded lanes.
    """
    n, copies = start.shape[1], len(lanes) // trials
    chain = Links(lanes, clock_s, dt_s, n)
    chain.state[0] = np.tile(start, (copies, 1))
    out = np.empty((steps, len(lanes), n))
    window = max(round(window_s / dt_s), 1) if math.isfinite(window_s) else steps + 1
    none, still = np.zeros((len(lanes), n)), np.zeros(len(lanes))
    late = np.round(chain.p["delay_s"] / dt_s).astype(int)
    delayed = bool(late.any())
    asked: list[Array] = []
    of = np.tile(np.arange(trials), copies)
    for i in range(steps):
        if i % window == 0 and i > 0:
            for state in (chain.state[0], chain.state[1], chain.rub.bend):
                state.reshape(copies, trials, n)[:] = state[:trials]
        out[i] = chain.state[0]
        torque: Array = none
        if torques is not None:
            asked.append(torques(i, chain.state[0, :trials], chain.state[1, :trials]))
            torque = _late(asked, i, late, of) if delayed else asked[i][of]
        push = (still,) * 3 if base is None else tuple(base[2 * i + k][of] for k in range(3))
        chain.step(i * dt_s, torque, (push[0], push[1], push[2]))
    return np.asarray(out + chain.bias)


def _late(asked: list[Array], i: int, late: NDArray[np.int64], of: NDArray[np.int64]) -> Array:
    """Return the delayed torques [L, n]."""
    return np.stack([asked[max(i - int(d), 0)][k] for d, k in zip(late, of, strict=True)])
