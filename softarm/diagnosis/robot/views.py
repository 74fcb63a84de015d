"""Views of the robot's stages: regulator, rail, arm and mocap, each driven by its measured inputs."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine.view import Array, Point, View
from softarm.diagnosis.robot.play import coasting
from softarm.diagnosis.robot.trial_grid import RATE_HZ, STEP_S, TrialGrid
from softarm.schemas.model import Model
from softarm.simulator.effects import REGISTRY, value
from softarm.simulator.stage_simulator import StageSimulator

# Noise floors, RMS: this simulator and the independent one in MuJoCo, with parameters a few per cent off, differ by
# about this much.
FLOOR_KPA, FLOOR_M_S, FLOOR_MOCAP_M = 0.10, 0.02, 0.0007
FLOOR_LINK_Y_M, FLOOR_LINK_Z_M = 0.0007, 0.0005  # of the first link; y grows with the links, z with half of that
RAIL_HZ, ARM_HZ = 480.0, 240.0
ROBOTS_MAX = 4096
START_NUDGES = (0.02, 0.2)  # rad, rad/s
LEVELS_KPA = (2, 5, 10, 15)
# An encoder on the motor shows neither a wrong feed nor play.
ON_MOTOR = "rail.encoder.on_motor"
# A mocap frame may be rotated about its origin, or about the middle of the rail.
ABOUT_RAIL = "mocap.rotation.about_rail"
_DRAW = ("rail.gain.scale", "rail.backlash.gap")
# Tolerances of single joints, as shares of the joint's own value; for the offset, of the largest joint's.
JOINT_SHARES = {
    "stiffness_nm_rad": 0.03,
    "damping_nm_s_rad": 0.15,
    "muscle_gain_nm_kpa": 0.03,
    "torque_offset_nm": 0.10,
}


def parameters(*effects: str) -> frozenset[str]:
    """Return the keys of a Point that belong to effects."""
    return frozenset(f"{name}.{p.name}" for name in effects for p in REGISTRY[name].parameters)


def value_at(point: Point, path: str, model: Model) -> float:
    """Return a parameter at a point, by default the model's."""
    effect, _, parameter = path.rpartition(".")
    return point.get(path, value(model, effect, parameter))


def _stage(stage: str) -> tuple[str, ...]:
    return tuple(name for name, effect in REGISTRY.items() if effect.stage == stage)


PHYSICS = parameters(*_stage("pressure"), *_stage("rail"), *_stage("arm"))


class RobotView(View):
    """Base of the robot's views."""

    own_nuisances: Mapping[str, float] = {}
    _floor = 0.0
    _echoed: frozenset[str] = frozenset()

    def __init__(self, grid: TrialGrid, model: Model) -> None:
        self.grid, self.model = grid, model
        self.t_s: Array = np.asarray(grid.flat(grid.t_s))
        self.trial = grid.sample[1]
        self.measured: Array = np.asarray(grid.flat(self._seen()))
        self.floor: Array = np.full(len(self.channels), self._floor)
        self.noise: Array = np.zeros(len(self.channels))

    @property
    def regimes(self) -> Mapping[str, NDArray[np.bool_]]:
        """Return masks [M] of parts of the data by name."""
        flat = {name: np.asarray(self.grid.flat(values)) for name, values in self._signals().items()}
        return _regimes(flat)

    @property
    def features(self) -> Mapping[str, Array]:
        """Return inputs and measured states [M] by name."""
        since = self.grid.t_s - self.grid.t_s[0]
        signals = {**self._signals(), "time since the start": since}
        return {name: np.asarray(self.grid.flat(values)) for name, values in signals.items()}

    @property
    def echoes(self) -> frozenset[str]:
        """Return the features that contain the view's own measurement."""
        return frozenset(name for name in self.features if name in self._echoed or name.startswith(("link ", "tip ")))

    def gap(self, points: Sequence[Point]) -> NDArray[np.float32]:
        """Return measured minus predicted at each point, [P, M, S]."""
        most = max(1, ROBOTS_MAX // len(self.grid.trials))
        parts = [self._gap(points[i : i + most]) for i in range(0, len(points), most)]
        return np.concatenate(parts)

    def _gap(self, points: Sequence[Point]) -> NDArray[np.float32]:
        return self._less(self._predict(points))

    def _less(self, predicted: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return measured minus predicted samples, [P, M, S], of predicted steps, [T, P, K, S]."""
        step, trial = self.grid.sample
        flat = predicted[step, :, trial].transpose(1, 0, 2)
        return np.asarray(self.measured.astype(np.float32)[None] - flat)

    def _seen(self) -> Array:
        raise NotImplementedError

    def _predict(self, points: Sequence[Point]) -> NDArray[np.float32]:
        raise NotImplementedError

    def _value(self, points: Sequence[Point], path: str) -> Array:
        """Return a parameter at each point, [P]."""
        return np.array([value_at(point, path, self.model) for point in points])

    def _robots(self, values: Array) -> Array:
        """Return one value per robot from one per point; a robot is one trial at one point."""
        return np.repeat(values, len(self.grid.trials))

    def _overrides(self, points: Sequence[Point], effects: frozenset[str]) -> dict[str, Array]:
        named = sorted({path for point in points for path in point if path in effects})
        return {path: self._robots(self._value(points, path)) for path in named}

    def _tiled(self, values: Array, points: Sequence[Point]) -> Array:
        """Return values [T, K] repeated for each point, [T, P K]."""
        return np.tile(values, (1, len(points)))

    def _signals(self) -> dict[str, Array]:
        """Return inputs and measured states, [T, K], for regimes and features."""
        f = self.grid
        return {
            "pressure command": f.pressure_command_kpa,
            "pressure": np.nan_to_num(f.pressure_kpa),
            "pressure rate": _rate(np.nan_to_num(f.pressure_kpa)),
            "cart command": f.cart_velocity_m_s,
            "cart position": f.hinge_m,
            "cart velocity": f.hinge_m_s,
            "cart acceleration": _rate(f.hinge_m_s),
        }


class PressureView(RobotView):
    """View from the pressure command to the regulator's reading."""

    stage, unit, channels, _floor = "pressure", "kPa", ("pressure",), FLOOR_KPA
    _echoed = frozenset({"pressure", "pressure rate"})
    acts = parameters(*_stage("pressure"))

    def _seen(self) -> Array:
        return self.grid.pressure_kpa[:, :, None]

    @property
    def regimes(self) -> Mapping[str, NDArray[np.bool_]]:
        """Return the regimes, with levels of the pressure that show a sticking valve or a bent map."""
        pressure = np.asarray(self.grid.flat(np.nan_to_num(self.grid.pressure_kpa)))
        levels = {f"from {a} to {b} kPa": (pressure >= a) & (pressure < b) for a, b in pairwise(LEVELS_KPA)}
        return {**super().regimes, **levels}

    def _predict(self, points: Sequence[Point]) -> NDArray[np.float32]:
        f, robots = self.grid, len(points) * len(self.grid.trials)
        simulator = StageSimulator(self.model, robots, ARM_HZ, overrides=self._overrides(points, self.acts))
        bias = self._robots(self._value(points, "pressure.sensor_bias.bias"))
        first = np.nan_to_num(f.pressure_kpa[0])
        simulator.reset(pressure_kpa=np.tile(first, len(points)) - bias)
        command, late = self._tiled(f.pressure_command_kpa, points), self._tiled(f.late_s, points)
        seen = simulator.fly_pressure(command, late, STEP_S)
        return (seen + bias.astype(np.float32)).reshape(len(seen), len(points), -1, 1)


class RailView(RobotView):
    """View from the velocity command to the axis's read-back, with the arm's measured force."""

    stage, unit, channels, _floor = "rail", "m/s", ("velocity",), FLOOR_M_S
    _echoed = frozenset({"cart position", "cart velocity", "cart acceleration"})
    acts = parameters(*_stage("rail"), "arm.payload", "arm.tilt", "arm.drag", "mocap.latency") | {ON_MOTOR}

    def _seen(self) -> Array:
        seen = self.grid.axis_m_s.copy()
        seen[:, self.grid.held] = np.nan
        return seen[:, :, None]

    @property
    def regimes(self) -> Mapping[str, NDArray[np.bool_]]:
        """Return the regimes, with place, direction, and time after the start."""
        f = self.grid
        place, speed = (np.asarray(f.flat(x)) for x in (f.hinge_m, f.hinge_m_s))
        since = np.asarray(f.flat(f.t_s - f.t_s[0]))
        further = {
            "cart beyond 0.1 m at the +y end": place > 0.1,
            "cart beyond 0.1 m at the -y end": place < -0.1,
            "cart going to +y": speed > 0.02,
            "cart going to -y": speed < -0.02,
            "in the first 4 s": since < 4.0,
            "after 12 s": since > 12.0,
        }
        return {**super().regimes, **further}

    def _predict(self, points: Sequence[Point]) -> NDArray[np.float32]:
        f, robots = self.grid, len(points) * len(self.grid.trials)
        overrides = self._overrides(points, parameters(*_stage("rail")))
        on_motor = np.array([point.get(ON_MOTOR, 0.0) > 0 for point in points])
        for path in _DRAW:  # invisible to an encoder on the motor
            if path in overrides:
                overrides[path] = np.where(self._robots(on_motor.astype(float)) > 0, 0.0, overrides[path])
        simulator = StageSimulator(self.model, robots, RAIL_HZ, overrides=overrides)
        simulator.reset(cart_position_m=np.tile(f.hinge_m[0], len(points)))
        push = self._push(points)
        command, late = self._tiled(f.cart_velocity_m_s, points), self._tiled(f.late_s, points)
        seen = simulator.fly_cart(command, push, late, STEP_S)
        return seen.reshape(len(seen), len(points), -1, 1)

    def _push(self, points: Sequence[Point]) -> Array:
        """Return the force on the cart from the arm, payload, drag and a tilted rail, N, [T, P K]."""
        f, arm = self.grid, self.model.arm
        names = ("arm.payload.mass", "arm.tilt.angle", "arm.drag.coefficient")
        payload, tilt, drag = (self._robots(self._value(points, name)) for name in names)
        weight = (self.model.cart.mass_kg + sum(arm.link_mass_kg) + payload) * arm.gravity_m_s2
        moved = payload * self._tiled(f.tip_m_s2, points) + drag * self._tiled(f.air_m2_s2, points)
        return self._seen_push(points) - moved - weight * np.sin(tilt)

    def _seen_push(self, points: Sequence[Point]) -> Array:
        """Return the arm's force, N, [T, P K], with the delay of mocap removed."""
        f = self.grid
        latency = self._value(points, "mocap.latency.delay")
        ahead = [delayed(f.push_links_n[::-1], float(late))[::-1] - f.push_links_n for late in latency]
        return np.asarray(self._tiled(f.push_n, points) + np.concatenate(ahead, axis=1))


class ArmView(RobotView):
    """View from measured pressure and cart to the link ends relative to the cart, as mocap measures them."""

    stage, unit = "arm", "m"
    acts = parameters(
        *_stage("arm"), "pressure.sensor_bias", "mocap.latency", "mocap.rotation", "mocap.scale", "rail.gain"
    ) | {ON_MOTOR}

    def __init__(self, grid: TrialGrid, model: Model) -> None:
        link = np.arange(1, grid.links + 1)
        self.channels = tuple(f"link {i} {part}" for part in ("y", "z") for i in link)
        super().__init__(grid, model)
        self.floor = np.concatenate((FLOOR_LINK_Y_M * link, FLOOR_LINK_Z_M * (1 + link) / 2))
        self.noise = np.full(2 * grid.links, np.sqrt(2) * grid.noise_m)  # of a link end relative to the cart
        self.own_nuisances = {f"arm.{name}[{i}]": share for name, share in JOINT_SHARES.items() for i in link}

    def _seen(self) -> Array:
        seen = self.grid.links_m.copy()
        seen[np.isnan(self.grid.pressure_kpa)] = np.nan
        return seen

    def _predict(self, points: Sequence[Point]) -> NDArray[np.float32]:
        robots = len(points) * len(self.grid.trials)
        overrides = self._overrides(points, parameters(*_stage("arm")))
        return self._fly(StageSimulator(self.model, robots, ARM_HZ, overrides=overrides), points)

    def start_directions(self) -> NDArray[np.float32]:
        """Return the changes of the gap with initial angles, then rates, [2 n, M, S]."""
        n = self.grid.links
        changes = np.diag(np.repeat(START_NUDGES, n)).reshape(2 * n, 2, n)
        simulator = StageSimulator(self.model, 2 * n * len(self.grid.trials), ARM_HZ)
        moved = self._fly(simulator, [{}] * (2 * n), (changes[:, 0], changes[:, 1]))
        return self._less(moved) - self._gap([{}])

    def own_directions(self) -> NDArray[np.float32]:
        """Return the changes of the gap with the view's own nuisances, [q, M, S]."""
        changed = [with_joints(self.model, {path: share}) for path, share in self.own_nuisances.items()]
        models = [model for model in changed for _ in self.grid.trials]
        moved = self._fly(StageSimulator(models, physics_rate_hz=ARM_HZ), [{}] * len(changed))
        return self._less(moved) - self._gap([{}])

    def _fly(
        self, simulator: StageSimulator, points: Sequence[Point], changes: tuple[Array, Array] | None = None
    ) -> NDArray[np.float32]:
        """Simulate every trial at every point, [T, P, K, 2 n]; changes: of initial angles and rates, [P, n] each."""
        f, k = self.grid, len(self.grid.trials)
        angles, rates = np.tile(directions(f), (len(points), 1)), np.zeros((len(points) * k, f.links))
        if changes is not None:
            angles, rates = angles + np.repeat(changes[0], k, axis=0), np.repeat(changes[1], k, axis=0)
        cart, speed = self._cart(points)
        bias = self._robots(self._value(points, "pressure.sensor_bias.bias"))
        pressure = self._tiled(np.nan_to_num(f.pressure_kpa), points) - bias
        joints = np.diff(angles, axis=1, prepend=0.0)
        simulator.reset(
            joint_angles_rad=joints, link_rates_rad_s=rates, cart_position_m=cart[0], pressure_kpa=pressure[0]
        )
        seen = simulator.fly_arm(cart, speed, pressure, STEP_S)
        y, z = seen[:, : f.links], seen[:, f.links :]
        np.subtract(y, cart[:, None], out=y, casting="same_kind")
        np.subtract(z, np.float64(self.model.arm.base_height_m), out=z, casting="same_kind")
        ends = np.ascontiguousarray(seen.transpose(0, 2, 1))
        return self._as_seen(ends.reshape(len(seen), len(points), k, -1), points)

    def _cart(self, points: Sequence[Point]) -> tuple[Array, Array]:
        """Return position and velocity of the cart, [T, P K], scaled if an encoder on the motor hides a wrong feed."""
        f = self.grid
        scale = np.array([p.get("rail.gain.scale", 0.0) if p.get(ON_MOTOR, 0.0) > 0 else 0.0 for p in points])
        stretch = 1 + self._robots(scale) * np.tile(f.axis_true, len(points))
        return self._tiled(f.hinge_m, points) * stretch, self._tiled(f.hinge_m_s, points) * stretch

    def _as_seen(self, ends: NDArray[np.float32], points: Sequence[Point]) -> NDArray[np.float32]:
        """Return true link ends [T, P, K, 2 n] as mocap measures them: delayed, rotated and scaled."""
        n = self.grid.links
        latency = self._value(points, "mocap.latency.delay")
        turn, scale = (self._value(points, f"mocap.{name}") for name in ("rotation.angle", "scale.scale"))
        for i in np.flatnonzero(latency):
            ends[:, i] = delayed(ends[:, i], float(latency[i]))
        for i in np.flatnonzero((turn != 0) | (scale != 0)):
            c, s = ((1 + scale[i]) * np.array((np.cos(turn[i]), np.sin(turn[i])))).astype(np.float32)
            y, z = ends[:, i, :, :n].copy(), ends[:, i, :, n:].copy()
            ends[:, i, :, :n], ends[:, i, :, n:] = c * y - s * z, s * y + c * z
        return ends

    def _signals(self) -> dict[str, Array]:
        signals = super()._signals()
        links = np.nan_to_num(self.grid.links_m)
        for i in range(self.grid.links):
            signals[f"link {i + 1} y"] = links[:, :, i]
        signals["tip z"] = links[:, :, -1]
        signals["tip velocity"] = _rate(links[:, :, self.grid.links - 1])
        return signals


class MocapView(RobotView):
    """View from the axis's read-back to the cart in mocap."""

    stage, unit, channels, _floor = "mocap", "m", ("cart y", "cart z"), FLOOR_MOCAP_M
    acts = parameters("mocap.latency", "mocap.rotation", "mocap.scale", "mocap.offset") | {
        *_DRAW,
        ON_MOTOR,
        ABOUT_RAIL,
    }

    def __init__(self, grid: TrialGrid, model: Model) -> None:
        super().__init__(grid, model)
        self.noise = np.full(2, grid.noise_m)

    def _seen(self) -> Array:
        f = self.grid
        seen = np.stack((f.cart_y_m, f.cart_z_m), axis=2)
        seen[np.isnan(f.axis_m)] = np.nan  # without a read-back there is no comparison
        return seen

    def _predict(self, points: Sequence[Point]) -> NDArray[np.float32]:
        f = self.grid
        axis = np.where(f.held, f.hinge_m, f.axis_m)
        base = self.model.arm.base_height_m
        names = ("latency.delay", "rotation.angle", "scale.scale", "offset.y", "offset.z")
        columns = zip(*(self._value(points, f"mocap.{name}") for name in names), strict=True)
        seen = np.empty((len(f.t_s), len(points), len(f.trials), 2), np.float32)
        for i, (point, (latency, turn, scale, y, z)) in enumerate(zip(points, columns, strict=True)):
            way = delayed(self._cart_of(axis, point), latency)
            height = base if point.get(ABOUT_RAIL, 1.0) <= 0 else 0.0
            seen[:, i, :, 0] = (1 + scale) * (np.cos(turn) * way - np.sin(turn) * height) + y
            rise = np.sin(turn) * way + (np.cos(turn) - 1) * height
            seen[:, i, :, 1] = base + scale * height + (1 + scale) * rise + z
        return seen

    def _cart_of(self, axis: Array, point: Point) -> Array:
        """Return the cart's position from the axis's read-back."""
        if point.get(ON_MOTOR, 0.0) <= 0:
            return axis
        way = axis * (1 + point.get("rail.gain.scale", 0.0))
        half = point.get("rail.backlash.gap", 0.0) / 2
        if half <= 0:
            return way
        way, pushed_n = np.nan_to_num(way), np.where(self.grid.held, 0.0, self.grid.push_n)
        return np.asarray(coasting(way, _rate(way), half, pushed_n / self.model.cart.mass_kg, STEP_S))


def with_joints(model: Model, nuisances: Mapping[str, float]) -> Model:
    """Return the model with its single joints changed by the fitted nuisances, `arm.NAME[JOINT]`."""
    changed: dict[str, tuple[float, ...]] = {}
    for name in JOINT_SHARES:
        values = getattr(model.arm, name)
        largest = max(map(abs, values))
        shares = [nuisances.get(f"arm.{name}[{i}]", 0.0) for i in range(1, len(values) + 1)]
        of = [largest if name == "torque_offset_nm" else value for value in values]
        changed[name] = tuple(value + share * size for value, share, size in zip(values, shares, of, strict=True))
    return model.model_copy(update={"arm": model.arm.model_copy(update=changed)})


def _rate(values: Array) -> Array:
    return np.asarray(np.gradient(values, STEP_S, axis=0))


def delayed(values: Any, delay_s: float) -> Any:
    """Return values delayed along axis 0, with linear interpolation and the first value before the start."""
    if not delay_s:
        return values
    back = delay_s * RATE_HZ
    whole, part = int(np.floor(back)), back - np.floor(back)
    steps = np.arange(len(values))
    one, other = values[np.maximum(steps - whole, 0)], values[np.maximum(steps - whole - 1, 0)]
    return one + part * (other - one)


def directions(grid: TrialGrid) -> Array:
    """Return the absolute angles of the links at the start of every trial, rad, [K, n]."""
    n = grid.links
    seen = np.isfinite(first := grid.links_m[:6])
    if not seen.any():
        return np.zeros((len(grid.trials), n))
    ends = np.where(seen, first, 0.0).sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
    steps = np.diff(ends.reshape(-1, 2, n), axis=2, prepend=0.0)
    return np.asarray(np.arctan2(steps[:, 0], -steps[:, 1]))


def _regimes(signals: Mapping[str, Array]) -> dict[str, NDArray[np.bool_]]:
    """Return masks of the parts of the data in which causes differ."""
    rate, pressure = signals["pressure rate"], signals["pressure"]
    speed, position = signals["cart velocity"], signals["cart position"]
    moving = np.abs(speed) > 0.02
    return {
        "inflating": rate > 3.0,
        "deflating": rate < -3.0,
        "pressure steady": np.abs(rate) <= 3.0,
        "above 10 kPa": pressure > 10.0,
        "below 2 kPa": pressure < 2.0,
        "cart moving": moving,
        "cart still": ~moving,
        "cart reversing": (np.abs(speed) < 0.05) & (np.abs(signals["cart acceleration"]) > 1.0),
        "cart beyond 0.1 m": np.abs(position) > 0.1,
    }


VIEWS = (PressureView, RailView, MocapView, ArmView)


def robot_views(grid: TrialGrid, model: Model) -> tuple[RobotView, ...]:
    """Return the views of the stages that these trials show."""
    views = [view(grid, model) for view in VIEWS]
    return tuple(view for view in views if np.isfinite(view.measured).any())
