"""Simulated motion capture, velocity estimates and tick timing of a batch of robots.

Everything runs in numpy once a control step; each robot has the effects of its own model or override.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softarm.simulator.simulator import Array, Simulator

# Number of poses that are kept at least, for interpolation.
_KEPT = 2


@dataclass(frozen=True)
class MocapReadings:
    """Motion-capture readings of a control step, one row a robot."""

    positions_m: NDArray[np.float64]  # [R, n + 1, 2]: y, z of the cart and of each link's end
    angles_rad: NDArray[np.float64]  # [R, n + 1]: 0 for the cart, then the links' absolute angles
    velocities_m_s: NDArray[np.float64]  # [R, n + 1, 2]
    fresh: NDArray[np.bool_]  # [R], False where the frame was dropped and the last one is repeated
    stamps_s: NDArray[np.float64]  # [R], of capture, by the cameras' clock; it agreed with the loop's at time 0


class Sensors:
    """Simulated motion capture of a simulator's robots.

    The order is latency (linear interpolation between control steps), rotation about the origin, scale, offset, noise,
    dropout. With observation.finite_difference, velocities are differences of the shown positions by the cameras'
    stamps, which clock.drift stretches. Without it they are the true ones of the shown instant in the cameras' frame.
    The pressure's bias is `Simulator.pressure_reading_kpa`.
    """

    def __init__(self, simulator: Simulator, rng: np.random.Generator) -> None:
        """Attach to a simulator; `rng` draws noise and dropouts, equally many numbers for every robot and step."""
        self._simulator, self.rng = simulator, rng
        self._differenced = np.array(["observation.finite_difference" in each.effects for each in simulator.models])
        self._past: list[tuple[float, Array, Array, Array]] = []
        self._shown: MocapReadings | None = None
        self._shown_at = 0.0
        self._restarted = np.ones(simulator.robots, dtype=np.bool_)

    def reset(self, robots: NDArray[np.bool_] | None = None) -> None:
        """Clear the past readings of robots (bool mask [R], None: all) after their state was set."""
        if robots is None:
            self._past, self._shown = [], None
        self._restarted |= True if robots is None else robots

    def look(self, robots: NDArray[np.bool_] | None = None) -> MocapReadings:
        """Return the readings of now; call it once a control step.

        Args:
            robots: bool mask [R] of robots whose state was set since the readings of this instant. Only their readings
                are replaced.

        Raises:
            ValueError: if `robots` is given and time has passed since the last readings.
        """
        before, instant = self._shown, self._shown_at
        readings = self._look()
        if robots is None or before is None or robots.all():
            return readings
        if instant != self._simulator.time_s:
            raise ValueError("readings of some robots need readings of all at the same instant; read all robots")
        pairs = ((new, vars(before)[name]) for name, new in vars(readings).items())
        chosen = (np.where(robots.reshape(-1, *[1] * (new.ndim - 1)), new, old) for new, old in pairs)
        self._shown = MocapReadings(*chosen)
        return self._shown

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return copies of the readings for `restore`, without random numbers and the simulator's time."""
        names = ("time_s", "positions_m", "angles_rad", "velocities_m_s")
        kept = {f"past.{name}": np.array([frame[i] for frame in self._past]) for i, name in enumerate(names)}
        readings = {} if self._shown is None else vars(self._shown)
        shown = {f"shown.{name}": each.copy() for name, each in readings.items()}
        return kept | shown | {"shown_at_s": np.array(self._shown_at), "restarted": self._restarted.copy()}

    def restore(self, snapshot: dict[str, NDArray[Any]]) -> None:
        """Restore a snapshot of the sensors of a simulator made with the same arguments."""
        kept: dict[str, Any] = {name: np.array(each) for name, each in snapshot.items()}
        past = [each for name, each in kept.items() if name.startswith("past.")]
        shown = [each for name, each in kept.items() if name.startswith("shown.")]
        self._past = [(float(time_s), *frame) for time_s, *frame in zip(*past, strict=True)]
        self._shown = MocapReadings(*shown) if shown else None
        self._shown_at, self._restarted = float(kept["shown_at_s"]), kept["restarted"]

    def _look(self) -> MocapReadings:
        effects, robots = self._simulator.effects, self._simulator.robots
        positions, angles, velocities = self._delayed(effects.value("mocap.latency", "delay"))
        turn = effects.value("mocap.rotation", "angle")
        scale = 1.0 + effects.value("mocap.scale", "scale")
        positions = _turned(positions, turn) * scale[:, None, None]
        away = [effects.value("mocap.offset", axis) for axis in ("y", "z")]
        positions = positions + np.stack(np.broadcast_arrays(*away), axis=-1)[:, None]
        noise = self.rng.standard_normal(positions.shape)
        positions = positions + effects.value("mocap.noise", "sigma")[:, None, None] * noise
        fresh = self.rng.random(robots) >= effects.value("mocap.dropout", "share")
        velocities = _turned(velocities, turn) * scale[:, None, None]
        return self._show(positions, angles + turn[:, None] * (np.arange(angles.shape[1]) > 0), velocities, fresh)

    def _show(
        self,
        positions: NDArray[np.float64],
        angles: NDArray[np.float64],
        velocities: NDArray[np.float64],
        fresh: NDArray[np.bool_],
    ) -> MocapReadings:
        """Repeat the last frame where one was dropped, and compute velocities from differences where modelled."""
        now, before = self._simulator.time_s, self._shown
        drift = np.broadcast_to(self._simulator.effects.value("clock.drift", "rate"), (self._simulator.robots,))
        stamps = now * (1.0 + drift)
        since = np.zeros_like(stamps)
        fresh = fresh | self._restarted
        if before is not None:
            held = ~fresh[:, None]
            positions = np.where(held[..., None], before.positions_m, positions)
            angles = np.where(held, before.angles_rad, angles)
            velocities = np.where(held[..., None], before.velocities_m_s, velocities)
            since = (now - self._shown_at) * (1.0 + drift)
        if self._differenced.any():
            rates = np.zeros_like(velocities)
            if before is not None and (since > 0).all():
                rates = (positions - before.positions_m) / since[:, None, None]
                rates[self._restarted] = 0.0
            velocities = np.where(self._differenced[:, None, None], rates, velocities)
        self._shown, self._shown_at = MocapReadings(positions, angles, velocities, fresh, stamps), now
        self._restarted = np.zeros_like(self._restarted)
        return self._shown

    def _delayed(self, delay_s: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
        """Return positions [R, n + 1, 2], angles [R, n + 1] and velocities as they were `delay_s` ago."""
        now = self._simulator.time_s
        frame = self._true()
        self._past = [each for each in self._past if each[0] < now]  # a reset may set the time back
        if self._restarted.any():  # a robot was at its start before its episode
            for _, *old in self._past:
                for then, this in zip(old, frame, strict=True):
                    then[self._restarted] = this[self._restarted]
        self._past.append((now, *frame))
        horizon = now - float(delay_s.max())
        while len(self._past) > _KEPT and self._past[1][0] <= horizon:
            self._past.pop(0)
        times = np.array([each[0] for each in self._past])
        place = np.interp(now - np.broadcast_to(delay_s, (self._simulator.robots,)), times, np.arange(len(times)))
        early = np.floor(place).astype(np.int64)
        late, share, everyone = np.minimum(early + 1, len(times) - 1), place - early, np.arange(len(place))
        result = []
        for k in (1, 2, 3):
            frames = np.stack([each[k] for each in self._past]).astype(np.float64)
            part = share.reshape(-1, *[1] * (frames.ndim - 2))
            one, other = frames[early, everyone], frames[late, everyone]
            result.append(np.where(part > 0, one + part * (other - one), one))
        return tuple(result)

    def _true(self) -> tuple[Array, Array, Array]:
        simulator = self._simulator
        cart = np.zeros((simulator.robots, 1, 2), simulator.cart_position_m.dtype)
        cart[:, 0, 0] = simulator.cart_position_m
        cart[:, 0, 1] = [each.arm.base_height_m for each in simulator.models]
        moving = np.zeros_like(cart)
        moving[:, 0, 0] = simulator.cart_velocity_m_s
        return (
            np.concatenate((cart, simulator.link_ends_m()), axis=1),
            np.concatenate((cart[:, :, 0] * 0, simulator.link_angles_rad), axis=1),
            np.concatenate((moving, simulator.link_end_velocities_m_s()), axis=1),
        )


class Clock:
    """Tick timing of each robot's loop: lateness and missed ticks."""

    def __init__(self, simulator: Simulator, rng: np.random.Generator) -> None:
        """Attach to a simulator; `rng` draws equally many numbers for every robot and tick."""
        self._simulator, self.rng = simulator, rng

    def tick(self) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return each robot's lateness (s, for `Simulator.step`) and whether it ticks at all, both [R].

        Lateness is the positive half of a normal distribution, since a loop cannot be early. A robot that does not tick
        keeps its last command.
        """
        effects, robots = self._simulator.effects, self._simulator.robots
        late = effects.value("clock.jitter", "sigma") * np.abs(self.rng.standard_normal(robots))
        return late, self.rng.random(robots) >= effects.value("clock.missed_ticks", "share")


def _turned(vectors: NDArray[np.float64], angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Turn vectors [R, k, 2] from y towards z by angles [R] or [1]."""
    sine, cosine = np.sin(angle)[:, None], np.cos(angle)[:, None]
    y, z = vectors[..., 0], vectors[..., 1]
    return np.stack((cosine * y - sine * z, sine * y + cosine * z), axis=-1)
