"""Excitations: command signals for identification and diagnosis.

Cart velocity in m/s, pressure in kPa (gauge). Every excitation stays inside the command range and, started with
the cart at the middle of the rail, inside +-0.20 m; the daemon's safety filter still applies.
"""

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Ramp:
    """Segment with a constant slope; a hold if start and end are equal."""

    duration_s: float
    start: float
    end: float

    def at(self, t_s: float) -> float:
        """Return the value at a time within the segment."""
        return self.start + (self.end - self.start) * t_s / self.duration_s


@dataclass(frozen=True, slots=True)
class Square:
    """Square wave that starts with half a period at `high`."""

    duration_s: float
    high: float
    low: float
    period_s: float

    def at(self, t_s: float) -> float:
        """Return the value at a time within the segment."""
        return self.high if t_s % self.period_s < self.period_s / 2 else self.low


@dataclass(frozen=True, slots=True)
class Chirp:
    """Sine about a mean with a linear change of frequency; it begins at the mean."""

    duration_s: float
    mean: float
    amplitude: float
    start_hz: float
    end_hz: float

    def at(self, t_s: float) -> float:
        """Return the value at a time within the segment."""
        turns = t_s * (self.start_hz + (self.end_hz - self.start_hz) * t_s / (2 * self.duration_s))
        return self.mean + self.amplitude * math.sin(2 * math.pi * turns)


@dataclass(frozen=True, slots=True)
class Multisine:
    """Sum of `count` harmonics of 1 / period_s, equally strong, with Schroeder's phases (a low crest).

    The amplitude is an upper bound of the distance from the mean.
    """

    duration_s: float
    mean: float
    amplitude: float
    period_s: float
    count: int

    def at(self, t_s: float) -> float:
        """Return the value at a time within the segment."""
        each = self.amplitude / (1.4 * math.sqrt(self.count))  # Schroeder's phases stay below 1.4 sqrt(count)
        harmonics = range(1, self.count + 1)
        phases = (2 * math.pi * k * t_s / self.period_s - math.pi * k * (k - 1) / self.count for k in harmonics)
        return self.mean + max(-self.amplitude, min(self.amplitude, each * sum(map(math.cos, phases))))


Segment = Ramp | Square | Chirp | Multisine  # `at` takes a time from 0 to `duration_s`
Signal = tuple[Segment, ...]


def duration_s(signal: Signal) -> float:
    """Return the duration of a signal, s."""
    return sum(segment.duration_s for segment in signal)


def value(signal: Signal, t_s: float) -> float:
    """Return the value of a signal at a time; it is zero before its start and after its end."""
    if t_s < 0:
        return 0.0
    for segment in signal:
        if t_s < segment.duration_s:
            return segment.at(t_s)
        t_s -= segment.duration_s
    return 0.0


@dataclass(frozen=True, slots=True)
class Excitation:
    """Commands over time, from rest with the cart in the middle of the rail."""

    name: str
    description: str
    pressure_kpa: Signal = ()
    cart_velocity_m_s: Signal = ()

    @property
    def duration_s(self) -> float:
        """Return the time until both signals have ended, s."""
        return max(duration_s(self.pressure_kpa), duration_s(self.cart_velocity_m_s))

    @property
    def moves_rail(self) -> bool:
        """Return whether the cart is driven."""
        return bool(self.cart_velocity_m_s)

    def at(self, t_s: float) -> tuple[float, float]:
        """Return the commanded cart velocity (m/s) and pressure (kPa) at a time."""
        return value(self.cart_velocity_m_s, t_s), value(self.pressure_kpa, t_s)


def _steps(speed_m_s: float, half_s: float) -> Signal:
    """Out to one side, across to the other, back to the middle, with rests; ends where it began."""
    rest = Ramp(1.0, 0.0, 0.0)
    return (
        Ramp(half_s, speed_m_s, speed_m_s),
        rest,
        Ramp(2 * half_s, -speed_m_s, -speed_m_s),
        rest,
        Ramp(half_s, speed_m_s, speed_m_s),
        rest,
    )


def _dashes(count: int) -> Signal:
    """Away from the middle and back, on either side, `count` times; no two alike, so that the arm swings any way."""
    signal: list[Segment] = []
    for number in range(count):
        hold, pause, side = (number * step % 1.0 for step in (0.618034, 0.754878, 0.41))
        dash_s = 0.14 + 0.22 * hold
        speed_m_s = min(0.85, 0.16 / dash_s) * (1 if side < 0.5 else -1)
        rest = Ramp(0.25 * pause, 0.0, 0.0)
        signal += (Ramp(dash_s, speed_m_s, speed_m_s), rest, Ramp(dash_s, -speed_m_s, -speed_m_s), rest)
    return tuple(signal)


_REST = Ramp(2.0, 0.0, 0.0)

EXCITATIONS: dict[str, Excitation] = {
    excitation.name: excitation
    for excitation in (
        Excitation(
            "seed",
            "the paper's system identification: a slow sweep, a square wave, chirps; 28 s, cart at rest",
            (
                Ramp(1.0, 0.0, 0.0),
                Ramp(4.0, 0.0, 20.0),
                Ramp(4.0, 20.0, 0.0),
                Square(8.0, 16.0, 0.0, 4.0),
                Chirp(5.0, 10.0, 9.0, 0.4, 1.6),
                Chirp(5.0, 10.0, 9.5, 1.2, 3.0),
                Ramp(1.0, 0.0, 0.0),
            ),
        ),
        Excitation(
            "sinusoid",
            "one sine of the muscle at 0.7 Hz, not in `seed`: held-out data to check an identified model",
            (Ramp(1.0, 0.0, 0.0), Chirp(12.0, 9.0, 8.0, 0.7, 0.7), Ramp(2.0, 0.0, 0.0)),
        ),
        Excitation(
            "pressure-multisine",
            "ten harmonics of 0.2 Hz in the muscle, two periods",
            (Ramp(1.0, 0.0, 10.0), Multisine(10.0, 10.0, 9.5, 5.0, 10), Ramp(2.0, 0.0, 0.0)),
        ),
        Excitation(
            "pressure-staircase",
            "holds at several pressures, each reached from below and from above",
            tuple(Ramp(2.0, level, level) for level in (0.0, 5.0, 10.0, 15.0, 20.0, 15.0, 10.0, 5.0, 0.0)),
        ),
        Excitation(
            "free-decay",
            "the arm is bent, released and left to swing, twice",
            (*(Ramp(3.0, 18.0, 18.0), Ramp(6.0, 0.0, 0.0)), *(Ramp(3.0, 8.0, 8.0), Ramp(6.0, 0.0, 0.0))),
        ),
        Excitation(
            "rail-steps",
            "velocity steps of the cart at three sizes; muscle at rest",
            (),
            (Ramp(1.0, 0.0, 0.0), *_steps(0.15, 0.8), *_steps(0.4, 0.35), *_steps(0.6, 0.15)),
        ),
        Excitation(
            "rail-chirp",
            "a sine of the cart's velocity from 0.6 to 3 Hz; muscle at rest",
            (),
            (_REST, Chirp(12.0, 0.0, 0.35, 0.6, 3.0), _REST),
        ),
        Excitation(
            "rail-multisine",
            "eight harmonics of 0.5 Hz in the cart's velocity; muscle at rest",
            (),
            (_REST, Multisine(8.0, 0.0, 0.5, 2.0, 8), _REST),
        ),
        Excitation(
            "rail-dashes",
            "fast reversals of the cart while the muscle swings the arm, to measure the rail's limits",
            (Ramp(1.0, 0.0, 10.0), Chirp(56.0, 10.0, 9.5, 0.3, 1.5), _REST),
            (Ramp(1.0, 0.0, 0.0), *_dashes(75), _REST),
        ),
        Excitation(
            "both",
            "muscle and cart at once: a chirp of the pressure over a sine of the cart",
            (Ramp(1.0, 0.0, 0.0), Chirp(12.0, 9.0, 8.0, 0.3, 2.0), _REST),
            (Ramp(1.0, 0.0, 0.0), Chirp(12.0, 0.0, 0.3, 0.75, 0.75), _REST),
        ),
    )
}
