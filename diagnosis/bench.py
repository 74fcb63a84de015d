"""The arm alone, as a batch: driven by what was measured, each robot with parameters of its own.

The regulator is left out (the measured pressure goes in) and the cart moves as it was measured: it is made so
heavy, and its drive so stiff, that the arm cannot pull at it.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from diagnosis.motion import Motion
from schemas.model import Arm, Cart, Effects, Model
from simulator.simulator import Simulator

Array = NDArray[np.float64]

PARAMETERS = ("stiffness_nm_rad", "damping_nm_s_rad", "muscle_gain_nm_kpa", "torque_offset_nm")
PHYSICS_HZ = 240.0
HEAVY_KG = 1e4


def to_columns(arm: Arm) -> Array:
    """An arm's fitted parameters as one column, [4 n] in PARAMETERS order."""
    return np.concatenate([np.asarray(getattr(arm, name), dtype=float) for name in PARAMETERS])


def from_column(arm: Arm, column: Array) -> Arm:
    """An arm with these parameters; the rest stays."""
    parts = np.split(column, len(PARAMETERS))
    return arm.model_copy(
        update={name: tuple(float(v) for v in part) for name, part in zip(PARAMETERS, parts, strict=True)}
    )


def names(links: int) -> tuple[str, ...]:
    """A name for every entry of a column."""
    return tuple(f"{name}[{i}]" for name in PARAMETERS for i in range(1, links + 1))


class Bench(Simulator):
    """Robots whose arms differ, under one measured input."""

    def __init__(self, arm: Arm, columns: Array) -> None:
        """columns: [R, 4 n], one row a robot. Raises ValueError for another shape."""
        if columns.ndim != 2 or columns.shape[1] != len(PARAMETERS) * arm.links:
            raise ValueError(f"columns have shape {columns.shape}; give [robots, {len(PARAMETERS) * arm.links}]")
        # 2 m / dt brings the cart to its set-point within one substep, without ringing (midpoint rule).
        cart = Cart(mass_kg=HEAVY_KG, velocity_gain_n_s_m=2 * HEAVY_KG * PHYSICS_HZ, travel_m=1e3)
        none = Effects.model_validate(dict.fromkeys(f.alias or n for n, f in Effects.model_fields.items()))
        super().__init__(Model(arm=arm, cart=cart, effects=none), len(columns), PHYSICS_HZ)
        self._write(columns)

    def _write(self, columns: Array) -> None:
        """Put each robot's parameters into its lane."""
        block, lane = np.divmod(np.arange(self.robots), len(self._lanes))
        at, n = self._at, self.links
        for first, values in zip(
            (at.stiffness, at.damping, at.muscle, at.offset), np.split(columns, len(PARAMETERS), axis=1), strict=True
        ):
            for i in range(n):
                self._rows[block, first + i, lane] = values[:, i]

    def replay(self, motion: Motion, starts: Array) -> NDArray[np.float32]:
        """Run a measured motion's inputs; what would have been measured at its stamps, [R, N, 3 n] as `Motion.signals`.

        starts: [R, 2 n] or [2 n], absolute link angles (rad) and their rates (rad/s) at the first stamp.
        """
        starts = np.broadcast_to(starts, (self.robots, 2 * self.links))
        angles, rates = np.split(starts, 2, axis=1)
        self.reset(joint_angles_rad=np.diff(angles, axis=1, prepend=0.0), pressure_kpa=motion.pressure_kpa[0])
        self._turn(rates)
        parts, lengths, speeds, pressures = _substeps(motion)
        angles_at = slice(self._at.q + 1, self._at.q + 1 + self.links)
        seen = np.empty((len(motion.t_s), *self._rows[:, angles_at].shape), dtype=self._rows.dtype)
        seen[0] = self._rows[:, angles_at]
        k = 0
        for frame, (count, length) in enumerate(zip(parts, lengths, strict=True), 1):
            # One substep a command: the cart then gains its new speed evenly over the substep.
            for _ in range(count):
                self.step(speeds[k], pressures[k], length)
                k += 1
            seen[frame] = self._rows[:, angles_at]
        return self._signals(seen)

    def _turn(self, rates: Array) -> None:
        """Give the links absolute rates, [R, n]."""
        block, lane = np.divmod(np.arange(self.robots), len(self._lanes))
        for i in range(self.links):
            self._rows[block, self._at.v + 1 + i, lane] = rates[:, i]

    def _signals(self, seen: NDArray[np.floating]) -> NDArray[np.float32]:
        """Link angles as the memory holds them, [N, blocks, n, lanes], to `Motion.signals`, [R, N, 3 n]."""
        angles = seen.transpose(1, 3, 0, 2)
        angles = angles.reshape(-1, *angles.shape[2:])[: self.robots]
        lengths = np.array(self.model.arm.link_length_m, dtype=np.float32)
        y = np.cumsum(lengths * np.sin(angles), axis=2)
        z = -np.cumsum(lengths * np.cos(angles), axis=2)
        return np.concatenate((y, z, angles), axis=2)


def _substeps(motion: Motion) -> tuple[list[int], list[float], list[float], list[float]]:
    """Between frames: how many substeps, how long (s); for each substep the cart's speed at its end, the pressure.

    Lengths are rounded to 10 ns, so that those of evenly spaced frames are equal to the last bit: the simulator
    prepares itself anew for every other length.
    """
    intervals = np.diff(motion.t_s)
    parts = np.maximum(1, np.ceil(intervals * PHYSICS_HZ - 1e-3)).astype(int)
    lengths = np.round(intervals / parts, 8)
    within = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    length = np.repeat(lengths, parts)
    starts = np.repeat(motion.t_s[:-1], parts) + within * length
    speeds = CubicSpline(motion.t_s, motion.cart_m).derivative()(starts + length)
    pressures = motion.pressure_at(starts + length / 2)
    return parts.tolist(), lengths.tolist(), speeds.tolist(), pressures.tolist()
