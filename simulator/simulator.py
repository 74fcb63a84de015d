"""The robot, simulated: a batch of arms on their carts, arrays in and arrays out."""

import functools
import math
import os
from typing import Any

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from schemas.model import Model
from simulator import kernel
from simulator.pack import pack

Array = NDArray[np.floating]

# Lanes of a block: wide for a batch, one SIMD register for few robots. Only the lengths count.
WIDE, NARROW = (0,) * 32, (0,) * 8
# Waking the other cores costs more than fewer blocks would save.
PARALLEL_BLOCKS = 4
# Substeps at lower rates may diverge under hard commands.
RATE_MIN_HZ = 120.0


@functools.cache
def _advance_on_all_cores() -> Any:
    """Return `kernel.advance_parallel`, its threads started such that they sleep between steps.

    GNU OpenMP's threads spin while they wait, unless told otherwise by the time it is loaded. Measured with 4096
    robots on two cores: 20 % faster on an idle machine, 20 times slower beside two busy processes.
    """
    name, before = "OMP_WAIT_POLICY", os.environ.get("OMP_WAIT_POLICY")
    os.environ.setdefault(name, "passive")
    numba.get_num_threads()  # loads the threading layer
    if before is None:
        del os.environ[name]  # other users of OpenMP keep their own ways
    return kernel.advance_parallel


class Simulator:
    """A batch of robots that are stepped together.

    Every array has one row a robot. Physics runs in substeps of at most 1 / physics_rate_hz: 240 Hz serves
    training, 1200 Hz evaluation (docs/simulator.md gives the errors of both). The simulator obeys whatever it
    is told: to keep commands within the robot's limits is the caller's part. A robot that is given NaN turns
    NaN, alone, until it is reset.
    """

    def __init__(
        self,
        model: Model | None = None,
        robots: int = 1,
        physics_rate_hz: float = 240.0,
        *,
        dtype: type[np.floating] = np.float32,
    ) -> None:
        """Place robots of one model (default: the seed's) at rest; float64 is for tests of the scheme.

        Raises ValueError when robots is below 1 or the rate below 120 Hz.
        """
        if robots < 1:
            raise ValueError(f"robots is {robots}; a simulator holds 1 or more")
        if not RATE_MIN_HZ <= physics_rate_hz < math.inf:
            raise ValueError(
                f"physics_rate_hz is {physics_rate_hz}; give {RATE_MIN_HZ:.0f} or more: the step is not stable below"
            )
        self.model = model or Model()
        self.robots = robots
        self.links = self.model.arm.links
        self.physics_rate_hz = physics_rate_hz
        self.time_s = 0.0  # since all robots were reset

        self._lanes = NARROW if robots <= len(NARROW) else WIDE
        self._links = (0,) * self.links
        self._at = kernel.rows.py_func(self.links)
        # The last link's y, and its z one arm's worth of rows later.
        tip, tip_velocity = self._at.end_z - 1, self._at.end_vz - 1
        self._tip = slice(tip, tip + self.links + 1, self.links)
        self._tip_velocity = slice(tip_velocity, tip_velocity + self.links + 1, self.links)
        width = len(self._lanes)
        blocks = -(-robots // width)
        self._real = dtype
        self._memory = np.zeros((blocks, self._at.end * width), dtype)
        self._rows = self._memory.reshape(blocks, self._at.end, width)
        self._rows[:, : self._at.q] = pack(self.model)[:, None]
        self._advance = kernel.advance if blocks < PARALLEL_BLOCKS else _advance_on_all_cores()
        self._substep_s = 0.0
        self._located = False
        self.reset()

    def reset(
        self,
        *,
        robots: ArrayLike | None = None,
        cart_position_m: ArrayLike = 0.0,
        joint_angles_rad: ArrayLike = 0.0,
        pressure_kpa: ArrayLike = 0.0,
    ) -> None:
        """Put robots to rest; their rail commands on the way are replaced by zero velocity.

        robots: bool mask [R] or indices; None means all, and sets the time to zero.
        cart_position_m, pressure_kpa: scalar or [R]. joint_angles_rad: scalar, [n] or [R, n], link against
        link. [R] and [R, n] have one entry a robot of the batch, chosen or not.
        Raises ValueError for other shapes, IndexError for a robot that does not exist.
        """
        everyone = np.arange(self.robots)
        chosen = everyone if robots is None else everyone[np.asarray(robots)]
        cart = np.broadcast_to(np.asarray(cart_position_m), (self.robots,))[chosen]
        angles = np.broadcast_to(np.asarray(joint_angles_rad), (self.robots, self.links))[chosen]
        pressure = np.broadcast_to(np.asarray(pressure_kpa), (self.robots,))[chosen]
        at, (block, lane) = self._at, np.divmod(chosen, len(self._lanes))
        self._rows[block, at.q : at.cart_command, lane] = 0.0
        self._rows[block, at.q, lane] = cart
        self._rows[block, at.q + 1 : at.v, lane] = np.cumsum(angles, axis=1)
        self._rows[block, at.pressure, lane] = pressure
        self._located = False
        if robots is None:
            self.time_s = 0.0

    def step(self, cart_velocity_m_s: ArrayLike, pressure_kpa: ArrayLike, duration_s: float = 1 / 30) -> None:
        """Issue a command now and hold it for duration_s (any length).

        cart_velocity_m_s, pressure_kpa: scalar or [R]. The model's delay and lag act on them; up to 7 changes
        of the rail command may be on their way at once. Raises ValueError for other shapes or a duration that
        is not positive.
        """
        if not 0.0 < duration_s < math.inf:
            raise ValueError(f"duration_s is {duration_s}; give a positive number of seconds")
        self._command(self._at.cart_command, cart_velocity_m_s)
        self._command(self._at.pressure_command, pressure_kpa)
        substeps = max(1, math.ceil(duration_s * self.physics_rate_hz - 1e-3))
        substep_s = duration_s / substeps
        if substep_s != self._substep_s:
            kernel.prepare(self._memory, self._links, self._lanes, self._real(substep_s))
            self._substep_s = substep_s
        self._advance(self._memory, self._links, self._lanes, substeps, self._real(substep_s))
        self._located = False
        self.time_s += duration_s

    @property
    def cart_position_m(self) -> Array:
        """[R]."""
        return self._scalar(self._at.q)

    @property
    def cart_velocity_m_s(self) -> Array:
        """[R]."""
        return self._scalar(self._at.v)

    @property
    def pressure_kpa(self) -> Array:
        """The muscle's pressure [R], after the regulator's lag."""
        return self._scalar(self._at.pressure)

    @property
    def joint_angles_rad(self) -> Array:
        """Link against link, [R, n]."""
        return np.diff(self.link_angles_rad, axis=1, prepend=self._real(0.0))

    @property
    def link_angles_rad(self) -> Array:
        """Absolute, 0 hanging straight down, [R, n]."""
        return self._per_link(self._at.q + 1)

    @property
    def link_rates_rad_s(self) -> Array:
        """Rates of the absolute angles, [R, n]."""
        return self._per_link(self._at.v + 1)

    def link_ends_m(self) -> Array:
        """y, z of each link's far end, [R, n, 2]."""
        self._locate()
        return np.stack((self._per_link(self._at.end_y), self._per_link(self._at.end_z)), axis=2)

    def tip_m(self) -> Array:
        """y, z of the tip, [R, 2]."""
        self._locate()
        return self._vector(self._tip)

    def tip_velocity_m_s(self) -> Array:
        """True velocity of the tip along y, z, [R, 2]."""
        self._locate()
        return self._vector(self._tip_velocity)

    def snapshot(self) -> Array:
        """Everything that moves, parameters included, for `restore`: a copy in this simulator's own layout."""
        return self._memory.copy()

    def restore(self, snapshot: Array) -> None:
        """Go back to a snapshot of a simulator made with the same arguments. Raises ValueError for another shape."""
        if snapshot.shape != self._memory.shape:
            raise ValueError(f"a snapshot has shape {snapshot.shape}; this simulator's are {self._memory.shape}")
        self._memory[:] = snapshot
        self._substep_s, self._located = 0.0, False

    def _locate(self) -> None:
        if not self._located:
            kernel.locate(self._memory, self._links, self._lanes)
            self._located = True

    def _command(self, row: int, values: ArrayLike) -> None:
        if isinstance(values, int | float):
            self._rows[:, row] = values
            return
        values = np.asarray(values)
        if values.shape not in ((), (self.robots,)):
            raise ValueError(
                f"a command has shape {values.shape}; give a scalar or one entry a robot, ({self.robots},)"
            )
        if values.ndim == 0:
            self._rows[:, row] = values
            return
        width = len(self._lanes)
        full = self.robots // width
        self._rows[:full, row] = values[: full * width].reshape(full, width)
        if full < len(self._rows):
            self._rows[full, row, : self.robots - full * width] = values[full * width :]

    def _scalar(self, row: int) -> Array:
        return self._rows[:, row].flatten()[: self.robots]

    def _vector(self, rows: slice) -> Array:
        # `copy` even where `reshape` alone would do it: of a single block that is a view.
        values = self._rows[:, rows].transpose(0, 2, 1).copy()
        return values.reshape(-1, values.shape[2])[: self.robots]

    def _per_link(self, row: int) -> Array:
        return self._vector(slice(row, row + self.links))
