"""Cameras, pressure sensor and rail encoder: from the true state to the readings that the controller receives.

All stamps are on the controller's clock, nanoseconds since the robot's start.
"""

from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from softarm.reality.parameters import Mocap, PressureSensor, RailSensor
from softarm.schemas.messages import MocapFrame, Pose, PressureReading, RailReading

Array = NDArray[np.float64]
R = TypeVar("R", MocapFrame, PressureReading, RailReading)


def nanoseconds(t_s: float) -> int:
    """Convert seconds to whole nanoseconds."""
    return round(t_s * 1e9)


def quantised(value: float, quantum: float) -> float:
    """Return the nearest multiple of a quantum; a quantum of 0 changes nothing."""
    return round(value / quantum) * quantum if quantum else value


class Sensor(Generic[R]):
    """Sensor with a regular rate, and its readings on their way to the controller, in order."""

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz, self._count = rate_hz, 1
        self._readings: list[R] = []

    @property
    def due_s(self) -> float:
        """Return the time of the next reading, s."""
        return self._count / self._rate_hz

    def received(self, now_s: float) -> list[R]:
        """Return the readings received by a time since the last call, oldest first."""
        now_ns = nanoseconds(now_s)
        count = sum(reading.t_receive_ns <= now_ns for reading in self._readings)
        received, self._readings = self._readings[:count], self._readings[count:]
        return received


class Cameras(Sensor[MocapFrame]):
    """Cameras that see six marker sets (`softarm.schemas.messages.BODY_NAMES`); frames arrive in order."""

    def __init__(self, parameters: Mocap, drift: float, base_height_m: float, random: np.random.Generator) -> None:
        super().__init__(parameters.rate_hz)
        self._p, self._drift, self._base_m, self._random = parameters, drift, base_height_m, random
        # Displacement of the loose marker set, m.
        self._wobble = np.zeros(2)
        self._wobble_m_s = np.zeros(2)
        self._end_m_s: Array | None = None

    def shake(self, end_velocity_m_s: tuple[float, float], dt_s: float) -> None:
        """Advance the loose marker set by a step: a damped spring connects it to its moving link."""
        velocity = np.array(end_velocity_m_s)
        before = velocity if self._end_m_s is None else self._end_m_s
        self._end_m_s = velocity
        omega = 2 * np.pi * self._p.loose_hz
        pull = omega**2 * self._wobble + 2 * self._p.loose_damping * omega * self._wobble_m_s
        self._wobble_m_s = self._wobble_m_s - pull * dt_s - (velocity - before)
        self._wobble = self._wobble + self._wobble_m_s * dt_s

    def expose(self, t_s: float, cart_m: float, ends_m: Array, angles_rad: Array) -> None:
        """Take a frame; a frame that is lost on the network still counts in the sequence."""
        sequence = self._count
        self._count += 1
        p, random = self._p, self._random
        places = np.vstack(([cart_m, self._base_m], ends_m))
        if p.loose_link:
            places[p.loose_link] += self._wobble
        places = self._calibrated(places) + random.normal(0.0, 1.0, places.shape) * p.noise_m
        angles = np.append(0.0, angles_rad) + p.rotation_rad + random.normal(0.0, 1.0, 6) * p.angle_noise_rad
        jitter_s = random.exponential(1.0) * p.transport_jitter_s
        if random.random() < p.dropout:
            return
        received_s = t_s + p.latency_s + p.transport_s + jitter_s
        received_ns = nanoseconds(received_s)
        if self._readings:
            received_ns = max(received_ns, self._readings[-1].t_receive_ns)
        stamp_ns = nanoseconds(t_s * (1 + self._drift) + p.latency_s)
        bodies = tuple(Pose(y, z, angle) for (y, z), angle in zip(places.tolist(), angles.tolist(), strict=True))
        self._readings.append(MocapFrame(sequence, stamp_ns, received_ns, bodies))

    def _calibrated(self, places: Array) -> Array:
        p = self._p
        sine, cosine = np.sin(p.rotation_rad), np.cos(p.rotation_rad)
        middle = np.array((0.0, self._base_m))
        # Positive angles turn towards +y, like the angles of the links.
        turned = (places - middle) @ np.array(((cosine, sine), (-sine, cosine)))
        return np.asarray(middle + (1 + p.scale) * turned + (p.offset_y_m, p.offset_z_m))


class Gauge(Sensor[PressureReading]):
    """Pressure sensor inside the regulator."""

    def __init__(self, parameters: PressureSensor, random: np.random.Generator) -> None:
        super().__init__(parameters.rate_hz)
        self._p, self._random = parameters, random

    def read(self, t_s: float, pressure_kpa: float) -> None:
        """Take a reading at a time."""
        self._count += 1
        p = self._p
        raw = pressure_kpa + p.bias_kpa + float(self._random.normal()) * p.noise_kpa
        self._readings.append(PressureReading(nanoseconds(t_s), quantised(raw, p.quantum_kpa), True))


class Encoder(Sensor[RailReading]):
    """Encoder read-back of the rail's axis."""

    def __init__(self, parameters: RailSensor) -> None:
        super().__init__(parameters.rate_hz)
        self._p = parameters

    def read(self, t_s: float, position_m: float, velocity_m_s: float) -> None:
        """Take a reading at a time."""
        self._count += 1
        position = quantised(position_m, self._p.position_quantum_m)
        velocity = quantised(velocity_m_s, self._p.velocity_quantum_m_s)
        self._readings.append(RailReading(nanoseconds(t_s), position, velocity, True))
