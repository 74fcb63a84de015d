"""Batch simulator of arms on their carts, with arrays for commands and states."""

import functools
import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from softarm.schemas.model import Model
from softarm.schemas.robot import CONTROL_PERIOD_S, TRAINING_PHYSICS_RATE_HZ
from softarm.simulator import kernel
from softarm.simulator.kernel import layout
from softarm.simulator.pack import RATE_MIN_HZ, Effects, needed, pack, rate_needed_hz

Array = NDArray[np.floating]

# Lanes of a block: wide for a batch, one SIMD register for few robots. Only the lengths count.
WIDE, NARROW = (0,) * 32, (0,) * 8
# Waking the other cores costs more than fewer blocks would save: about 0.1 ms, the time of 1000 robots' step.
PARALLEL_BLOCKS = 32
# Where a shelf stands that no arm can reach, m.
NOWHERE_M = -1e3


@functools.cache
def _advance_on_all_cores() -> Any:
    """Return `kernel.advance_parallel`, with threads that sleep between steps.

    GNU OpenMP's threads spin while they wait, unless configured otherwise before it is loaded. Measured with 4096
    robots on two cores: 20 % faster on an idle machine, 20 times slower beside two busy processes.
    """
    name, before = "OMP_WAIT_POLICY", os.environ.get("OMP_WAIT_POLICY")
    os.environ.setdefault(name, "passive")
    numba.get_num_threads()  # loads the threading layer
    if before is None:
        del os.environ[name]  # other users of OpenMP keep their own policy
    return kernel.advance_parallel


def _aligned(rows: int, columns: int, dtype: type[np.floating]) -> Array:
    """Return zeros that begin with a cache line, so that no load of a SIMD register straddles two."""
    spare = 64 // np.dtype(dtype).itemsize
    memory = np.zeros(rows * columns + spare, dtype)
    first = -memory.ctypes.data % 64 // memory.itemsize
    return memory[first : first + rows * columns].reshape(rows, columns)


class Simulator:
    """Batch of robots that are stepped together.

    Every array has one row a robot. Physics runs in substeps of at most 1 / physics_rate_hz: 240 Hz serves
    training, 1200 Hz evaluation (docs/training/simulator.md gives the errors of both). The simulator executes any
    command: the caller keeps commands within the robot's limits. NaN in a command makes the state of that robot
    NaN until it is reset; other robots are not affected.
    """

    def __init__(
        self,
        model: Model | Sequence[Model] | None = None,
        robots: int | None = None,
        physics_rate_hz: float = TRAINING_PHYSICS_RATE_HZ,
        *,
        overrides: Mapping[str, ArrayLike] | None = None,
        fixed_base: bool = False,
        dtype: type[np.floating] = np.float32,
    ) -> None:
        """Place robots at rest.

        Args:
            model: one model for all robots (default: the seed's), or one a robot, all with the same number of links.
            robots: number of robots R; default: the number of models.
            physics_rate_hz: lowest rate of the substeps, at least 120 Hz; a batch with a stiff, nearly undamped arm
                takes more.
            overrides: values of effects, 'stage.effect.parameter' -> scalar or [R].
            fixed_base: True keeps the cart at rest.
            dtype: float32; float64 is for tests of the integration scheme.

        Raises:
            ValueError: for another number of robots than models, a rate below 120 Hz, or different numbers of links.
            EffectError: a ValueError, for effects that the registry refuses.
        """
        models = (model or Model(),) if model is None or isinstance(model, Model) else tuple(model)
        robots = len(models) if robots is None else robots
        if robots < 1:
            raise ValueError(f"robots is {robots}; a simulator holds 1 or more")
        if len(models) not in (1, robots):
            raise ValueError(f"{len(models)} models for {robots} robots; give one model, or one a robot")
        if len({each.arm.links for each in models}) > 1:
            raise ValueError("the models differ in their number of links; simulate them apart")
        if not RATE_MIN_HZ <= physics_rate_hz < math.inf:
            raise ValueError(
                f"physics_rate_hz is {physics_rate_hz}; give {RATE_MIN_HZ:.0f} or more: the step is not stable below"
            )
        self.models, self.model = models, models[0]
        self.robots = robots
        self.links = self.model.arm.links
        self.physics_rate_hz = physics_rate_hz
        self.time_s = 0.0  # since all robots were reset

        self._lanes = NARROW if robots <= len(NARROW) else WIDE
        self._links = (0,) * self.links
        self._at = kernel.rows(self._links)
        # The last link's y, and its z one arm's worth of rows later.
        tip, tip_velocity = self._at.end_z - 1, self._at.end_vz - 1
        self._tip = slice(tip, tip + self.links + 1, self.links)
        self._tip_velocity = slice(tip_velocity, tip_velocity + self.links + 1, self.links)
        width = len(self._lanes)
        blocks = -(-robots // width)
        self._real = dtype
        self._memory = _aligned(blocks, self._at.end * width, dtype)
        self._rows = self._memory.reshape(blocks, self._at.end, width)
        self._rows[:, self._at.shelf_y] = NOWHERE_M
        self._advance = kernel.advance if blocks < PARALLEL_BLOCKS else _advance_on_all_cores()
        self._given = layout.CART_GIVEN if fixed_base else 0
        self._needed = 0
        self._overrides: dict[str, ArrayLike] = {}
        self.override(overrides or {})
        self.reset()

    def override(self, values: Mapping[str, ArrayLike]) -> None:
        """Replace values of effects without changing the motion; earlier overrides stay in force.

        Args:
            values: 'stage.effect.parameter' -> scalar or [R].

        Raises:
            EffectError: for effects or values that the registry refuses.
            ValueError: for other shapes.
        """
        before = self._needed | self._given
        self._overrides |= values
        self.effects = Effects(self.models, self._overrides, self.robots)
        packed = pack(self.models, self.effects).astype(self._real)
        width = len(self._lanes)
        everyone = np.resize(np.arange(len(packed)), self.robots)
        # Lanes without a robot copy the first one.
        lanes = np.concatenate((everyone, np.zeros(len(self._rows) * width - self.robots, dtype=np.int64)))
        self._rows[:, : self._at.shelf_y] = packed[lanes].reshape(-1, width, packed.shape[1]).transpose(0, 2, 1)
        self._pressure_bias = self.effects.value("pressure.sensor_bias", "bias").astype(self._real)
        self._examine(packed)
        self._begin(self._needed & ~before)
        self._located = False

    def place_shelf(self, edge_y_m: ArrayLike, board_z_m: ArrayLike, robots: ArrayLike | None = None) -> None:
        """Place a shelf, open towards +y, in front of robots; `reset` keeps it.

        Args:
            edge_y_m: y of its front edge, scalar or [R] (one entry for every robot of the batch).
            board_z_m: z of the top of its lower board, likewise.
            robots: bool mask [R] or indices; None means all.
        """
        chosen = self._chosen(robots)
        block, lane = np.divmod(chosen, len(self._lanes))
        for row, values in ((self._at.shelf_y, edge_y_m), (self._at.shelf_z, board_z_m)):
            self._rows[block, row, lane] = np.broadcast_to(np.asarray(values), (self.robots,))[chosen]
        self._given |= layout.SHELF

    def reset(
        self,
        *,
        robots: ArrayLike | None = None,
        cart_position_m: ArrayLike = 0.0,
        joint_angles_rad: ArrayLike = 0.0,
        link_rates_rad_s: ArrayLike = 0.0,
        pressure_kpa: ArrayLike = 0.0,
    ) -> None:
        """Set the state of robots and replace pending commands by zero velocity and the given pressure.

        [R] and [R, n] have one entry for every robot of the batch, selected or not.

        Args:
            robots: bool mask [R] or indices; None means all, and sets the time to zero.
            cart_position_m: scalar or [R].
            joint_angles_rad: link against link; scalar, [n] or [R, n].
            link_rates_rad_s: rates of the absolute angles; scalar, [n] or [R, n].
            pressure_kpa: scalar or [R].

        Raises:
            ValueError: for other shapes.
            IndexError: for a robot that does not exist.
        """
        chosen = self._chosen(robots)
        cart = np.broadcast_to(np.asarray(cart_position_m), (self.robots,))[chosen]
        angles = np.broadcast_to(np.asarray(joint_angles_rad), (self.robots, self.links))[chosen]
        rates = np.broadcast_to(np.asarray(link_rates_rad_s), (self.robots, self.links))[chosen]
        pressure = np.broadcast_to(np.asarray(pressure_kpa), (self.robots,))[chosen]
        at, (block, lane) = self._at, np.divmod(chosen, len(self._lanes))
        self._rows[block, at.q : at.cart_command, lane] = 0.0
        self._rows[block, at.q, lane] = cart
        self._rows[block, at.q + 1 : at.v, lane] = np.cumsum(angles, axis=1)
        self._rows[block, at.v + 1 : at.v + 1 + self.links, lane] = rates
        self._rows[block, at.pressure, lane] = pressure
        self._rows[block, at.pressure_command, lane] = pressure
        self._rows[block, at.pressure_history : at.pressure_age, lane] = pressure[:, None]
        self._rows[block, at.pressure_acting, lane] = pressure
        self._located = False
        if robots is None:
            self.time_s = 0.0

    def step(
        self,
        cart_velocity_m_s: ArrayLike,
        pressure_kpa: ArrayLike,
        duration_s: float = CONTROL_PERIOD_S,
        *,
        late_s: ArrayLike | None = None,
    ) -> None:
        """Issue a command now and hold it for duration_s (any length).

        The models' effects act on the command. Up to 15 changes of each command may be pending at once.

        Args:
            cart_velocity_m_s: scalar or [R].
            pressure_kpa: scalar or [R].
            duration_s: length of the step, s.
            late_s: delay from now until each robot's loop issues its command (clock.jitter); scalar or [R].

        Raises:
            ValueError: for other shapes or a duration that is not positive.
        """
        if late_s is not None:
            self._begin(layout.PRESSURE & ~(self._needed | self._given))
            self._command(self._at.late, late_s)
            self._given |= layout.PRESSURE  # keeps the history of pressure commands
        self._command(self._at.cart_command, cart_velocity_m_s)
        self._command(self._at.pressure_command, pressure_kpa)
        self._run(self._advance, duration_s)
        if late_s is not None:
            self._rows[:, self._at.late] = 0.0

    def fly(self, cart_velocity_m_s: Array, pressure_kpa: Array, step_s: float = CONTROL_PERIOD_S) -> Array:
        """Run commands [T, R] of step_s each on this thread, with the same bits as T calls of `step`.

        Planners use it to simulate thousands of plans.

        Returns:
            The cart's y and velocity and the tip's y and z at the end of every step, [T, 4, R].

        Raises:
            ValueError: for other shapes.
        """
        return self._fly(kernel.fly, 0, step_s, cart_velocity_m_s, pressure_kpa, rows=(4,), threads=1)

    def take_over(self, other: "Simulator", robot: int = 0) -> None:
        """Copy the state and the pending commands of one robot of another simulator to every robot.

        Parameters stay this simulator's own. Raises ValueError for another number of links or an unknown robot.
        """
        if not 0 <= robot < other.robots:
            raise ValueError(f"robot is {robot}; the other simulator has 0 to {other.robots - 1}")
        if other.links != self.links:
            raise ValueError(
                f"the other simulator's arms have {other.links} links, these have {self.links}: simulate the same arm"
            )
        block, lane = divmod(robot, len(other._lanes))
        moving = slice(self._at.q, self._at.cart_command)
        self._rows[:, moving] = other._rows[block, moving, lane][:, None]
        self._located = False

    def place(
        self,
        cart_position_m: Array,
        cart_velocity_m_s: Array,
        link_angles_rad: Array,
        link_rates_rad_s: Array,
        pressure_kpa: Array,
    ) -> None:
        """Set the state of every robot and, unlike `reset`, keep pending commands.

        Link angles are absolute. Angles and rates of links are [R, n], the other arguments [R].
        """
        at = self._at
        for row, values in ((at.q, cart_position_m), (at.v, cart_velocity_m_s), (at.pressure, pressure_kpa)):
            self._command(row, values)
        for first, turns in ((at.q + 1, link_angles_rad), (at.v + 1, link_rates_rad_s)):
            for link in range(self.links):
                self._command(first + link, turns[:, link])
        self._located = False

    @property
    def cart_position_m(self) -> Array:
        """Return the carts' positions, [R]."""
        return self._scalar(self._at.q)

    @property
    def cart_velocity_m_s(self) -> Array:
        """Return the carts' velocities, [R]."""
        return self._scalar(self._at.v)

    @property
    def pressure_kpa(self) -> Array:
        """Return the true pressure of the muscles, [R]."""
        return self._scalar(self._at.pressure)

    @property
    def pressure_reading_kpa(self) -> Array:
        """Return the readings of the regulators' sensors, [R]."""
        return self.pressure_kpa + self._pressure_bias

    @property
    def joint_angles_rad(self) -> Array:
        """Return the angles of each link against the one before, [R, n]."""
        return np.diff(self.link_angles_rad, axis=1, prepend=self._real(0.0))

    @property
    def link_angles_rad(self) -> Array:
        """Return the absolute angles of the links, 0 hanging straight down, [R, n]."""
        return self._per_link(self._at.q + 1)

    @property
    def link_rates_rad_s(self) -> Array:
        """Return the rates of the absolute angles, [R, n]."""
        return self._per_link(self._at.v + 1)

    def link_ends_m(self) -> Array:
        """Return y, z of each link's far end, [R, n, 2]."""
        self._locate()
        return np.stack((self._per_link(self._at.end_y), self._per_link(self._at.end_z)), axis=2)

    def link_end_velocities_m_s(self) -> Array:
        """Return the true velocities of each link's far end along y, z, [R, n, 2]."""
        self._locate()
        return np.stack((self._per_link(self._at.end_vy), self._per_link(self._at.end_vz)), axis=2)

    def tip_m(self) -> Array:
        """Return y, z of the tip, [R, 2]."""
        self._locate()
        return self._vector(self._tip)

    def tip_velocity_m_s(self) -> Array:
        """Return the true velocity of the tip along y, z, [R, 2]."""
        self._locate()
        return self._vector(self._tip_velocity)

    def snapshot(self) -> Array:
        """Return a copy of states and parameters for `restore`, in this simulator's own layout."""
        return self._memory.copy()

    def restore(self, snapshot: Array) -> None:
        """Restore a snapshot of a simulator made with the same arguments. Raises ValueError for another shape."""
        if snapshot.shape != self._memory.shape:
            raise ValueError(f"a snapshot has shape {snapshot.shape}; this simulator's are {self._memory.shape}")
        self._memory[:] = snapshot
        packed = self._rows[:, : self._at.shelf_y].transpose(0, 2, 1).reshape(-1, self._at.shelf_y)
        self._examine(packed)
        if (self._rows[:, self._at.shelf_y] != NOWHERE_M).any():
            self._given |= layout.SHELF
        self._located = False

    def _begin(self, parts: int) -> None:
        """Set the state of parts that the kernel did not need before, so that the motion continues."""
        at, rows = self._at, self._rows
        if parts & layout.PRESSURE:
            rows[:, at.pressure_history : at.pressure_age] = rows[:, at.pressure_command, None]
            rows[:, at.pressure_acting] = rows[:, at.pressure_command]
        if parts & layout.RAIL:
            rows[:, at.lagged] = rows[:, at.rail_acting] * rows[:, at.rail_gain]
            rows[:, at.ramped] = rows[:, at.reference] = rows[:, at.v]

    def _examine(self, packed: Array) -> None:
        """Find the kernel's parts and the rate that parameters [R, parameter] need."""
        self._needed = needed(packed, self.links)
        self._rate_hz = max(self.physics_rate_hz, rate_needed_hz(packed, self.links))
        self._substep_s = 0.0

    def _chosen(self, robots: ArrayLike | None) -> NDArray[np.int64]:
        everyone = np.arange(self.robots)
        return everyone if robots is None else everyone[np.asarray(robots)]

    def prepare(self, duration_s: float) -> tuple[Array, int, int, float]:
        """Prepare the memory for steps of a duration, s.

        Returns:
            The memory [blocks, rows, lanes] itself, the bits of the kernel's needed parts, the number of substeps and
            their length, s.

        Raises:
            ValueError: for a duration that is not positive.
        """
        if not 0.0 < duration_s < math.inf:
            raise ValueError(f"duration_s is {duration_s}; give a positive number of seconds")
        substeps = max(1, math.ceil(duration_s * self._rate_hz - 1e-3))
        substep_s = duration_s / substeps
        if substep_s != self._substep_s:
            kernel.prepare(self._memory, self._links, self._lanes, self._real(substep_s))
            self._substep_s = substep_s
        return self._rows, self._needed | self._given, substeps, substep_s

    def _run(self, entry: Callable[..., None], duration_s: float, given: int = 0) -> None:
        """Advance by an entry point of the kernel; `given` are the bits of externally given motion."""
        _, active, substeps, substep_s = self.prepare(duration_s)
        active |= given
        parts = (0,) if active else ()
        dt = self._real(substep_s)
        entry(self._memory, self._links, self._lanes, parts, active, substeps, dt)
        self._located = False
        self.time_s += duration_s

    def _fly(
        self,
        function: Callable[..., None],
        given: int,
        step_s: float,
        *inputs: Array,
        further: tuple[float, ...] = (),
        rows: tuple[int, ...] = (),
        threads: int | None = None,
    ) -> Array:
        """Run a function of the kernel through inputs [T, R] and return its path, [T, *rows, R].

        Each thread (default: one a core) has blocks of its own.
        """
        steps, width = len(inputs[0]), len(self._lanes)
        if any(each.shape != (steps, self.robots) for each in inputs):
            raise ValueError(f"the inputs have shapes {[each.shape for each in inputs]}; give [steps, {self.robots}]")
        path = np.empty((steps, *rows, self.robots), self._real)
        arrays = [np.ascontiguousarray(each, dtype=self._real) for each in inputs]
        threads = threads or min(numba.get_num_threads(), len(self._rows))
        edges = np.linspace(0, len(self._rows), threads + 1).astype(int).tolist()

        def entry(memory: Array, *arguments: Any) -> None:
            def part(i: int) -> None:
                a, b = edges[i : i + 2]
                function(memory[a:b], *arguments, a * width, *arrays, *further, path)

            if threads == 1:
                part(0)
                return
            with ThreadPoolExecutor(threads) as pool:
                list(pool.map(part, range(threads)))

        self._run(entry, step_s, given)
        self.time_s += (steps - 1) * step_s
        return path

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
        # For a single block `reshape` alone would return a view.
        values = self._rows[:, rows].transpose(0, 2, 1).copy()
        return values.reshape(-1, values.shape[2])[: self.robots]

    def _per_link(self, row: int) -> Array:
        return self._vector(slice(row, row + self.links))
