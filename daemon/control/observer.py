"""From what the devices measured to what the policy is fed. Pure; time comes in with the inputs."""

from collections import deque
from collections.abc import Iterator
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from softarm.daemon.control.alignment import Alignment
from softarm.daemon.control.plausibility import CART, TIP, WINDOW, Plausibility, is_usable
from softarm.daemon.control.records import Inputs, Observed
from softarm.schemas.messages import MocapFrame, PressureReading, RailReading
from softarm.schemas.policy import Observation


class Sighting(NamedTuple):
    """What of a frame is flown by."""

    t_ns: int  # of its capture
    cart_y_m: float
    tip_y_m: float
    tip_z_m: float

    @classmethod
    def of(cls, frame: MocapFrame) -> Self:
        """Of a frame in which both are seen."""
        cart, tip = frame.bodies[CART], frame.bodies[TIP]
        return cls(frame.t_capture_ns, cart.y_m, tip.y_m, tip.z_m)


class Observer:
    """Keeps the good frames of the last while: usable and plausible.

    Velocities are first differences over a control step ([P] section 3.3), by real capture stamps: from the frame
    that was taken most nearly a step before the newest one. Zero until there is one.
    """

    def __init__(self, period_ns: int, stale_ns: int, disagreement_m: float) -> None:
        self._period_ns = period_ns
        self._stale_ns = stale_ns  # a gap longer than this is not differenced over
        self._disagreement_m = disagreement_m  # between axis and mocap: farther apart, they disagree
        self._recent: deque[Sighting] = deque()  # of at least the last step, oldest first
        self._velocities = (0.0, 0.0, 0.0)  # cart, tip y, tip z
        self._sequence = 0  # of the newest good frame
        self.plausibility = Plausibility()
        self._on_the_way_ns: deque[int] = deque(maxlen=WINDOW)
        self.newest: MocapFrame | None = None  # good or not
        self.seen: tuple[Sighting, ...] = ()  # this tick's, oldest first
        self.pressure: PressureReading | None = None
        self.rail: RailReading | None = None
        self.frames_in_a_row = 0  # good frames without a longer gap, for arming
        self.frames_lost = 0  # by the bridge's own count
        self.alignment = Alignment()
        self.apart_m: float | None = None  # axis from mocap, when they were last compared
        self.disagreeing_ticks = 0  # in a row, until now

    def update(self, inputs: Inputs) -> None:
        """Take in a tick's measurements."""
        self.pressure = inputs.pressure
        self.rail = inputs.rail
        self.seen = tuple(self._good(inputs.mocap))
        if self.seen:
            self._keep(self.seen)
        elif (self.mocap_age_ns(inputs.t_ns) or 0) > self._stale_ns:
            self.frames_in_a_row = 0
            self._velocities = (0.0, 0.0, 0.0)
        self._compare()

    def _compare(self) -> None:
        """Axis and motion capture, where both are fresh; a silent one tells nothing of the other."""
        if self.rail is not None:
            self.alignment.axis.add(self.rail)
        apart_m = self.alignment.see(self.seen[-1].t_ns, self.seen[-1].cart_y_m) if self.seen else None
        if apart_m is not None:
            self.apart_m = apart_m
            self.disagreeing_ticks = self.disagreeing_ticks + 1 if apart_m > self._disagreement_m else 0

    def _good(self, frames: tuple[MocapFrame, ...]) -> Iterator[Sighting]:
        newest_ns = self._recent[-1].t_ns if self._recent else None
        axis_m = self.rail.position_m if self.rail is not None else None
        for frame in frames:
            if self.newest is not None and frame.sequence > self.newest.sequence + 1:
                self.frames_lost += frame.sequence - self.newest.sequence - 1
            self.newest = frame
            newer = newest_ns is None or frame.t_capture_ns > newest_ns
            if newer and is_usable(frame) and self.plausibility.accepts(frame, axis_m):
                newest_ns, self._sequence = frame.t_capture_ns, frame.sequence
                self.frames_in_a_row += 1
                self._on_the_way_ns.append(frame.t_receive_ns - frame.t_capture_ns)
                yield Sighting.of(frame)

    def _keep(self, seen: tuple[Sighting, ...]) -> None:
        """Difference over the step before the newest, and forget what no later step can begin with."""
        recent, newest = self._recent, seen[-1]
        before = min(
            (one for one in (*recent, *seen[:-1]) if newest.t_ns - one.t_ns <= self._stale_ns),
            key=lambda one: abs(newest.t_ns - one.t_ns - self._period_ns),
            default=None,
        )
        self._velocities = (0.0, 0.0, 0.0) if before is None else _rates(before, newest)
        recent.extend(seen)
        while len(recent) > 1 and newest.t_ns - recent[1].t_ns >= 2 * self._period_ns:
            recent.popleft()

    def mocap_age_ns(self, now_ns: int) -> int | None:
        """Age of the newest good frame's capture; None before the first."""
        return now_ns - self._recent[-1].t_ns if self._recent else None

    def mocap_late_ns(self) -> int:
        """How old a pose is on arrival: by its stamps, and by what the axis shows that they do not say."""
        if not self._on_the_way_ns:
            return 0
        return round(sum(self._on_the_way_ns) / len(self._on_the_way_ns)) + (self.alignment.lag_ns or 0)

    def observe(self, now_ns: int, previous_cart_velocity_m_s: float) -> Observed | None:
        """The observation and its age; None while a sensor has never been heard."""
        if not self._recent or self.pressure is None or self.rail is None:
            return None
        newest = self._recent[-1]
        cart_velocity, tip_vy, tip_vz = self._velocities
        return Observed(
            values=Observation(
                cart_position_m=newest.cart_y_m,
                cart_velocity_m_s=cart_velocity,
                tip_y_m=newest.tip_y_m,
                tip_z_m=newest.tip_z_m,
                tip_vy_m_s=tip_vy,
                tip_vz_m_s=tip_vz,
                previous_cart_velocity_command_m_s=previous_cart_velocity_m_s,
                pressure_kpa=self.pressure.pressure_kpa,
            ),
            mocap_sequence=self._sequence,
            mocap_age_ns=now_ns - newest.t_ns,
            pressure_age_ns=now_ns - self.pressure.t_receive_ns,
            rail_age_ns=now_ns - self.rail.t_receive_ns,
        )


def _rates(before: Sighting, newest: Sighting) -> tuple[float, float, float]:
    """Of cart and tip (y, z) between two frames, m/s."""
    per_s = 1e9 / (newest.t_ns - before.t_ns)
    return (
        (newest.cart_y_m - before.cart_y_m) * per_s,
        (newest.tip_y_m - before.tip_y_m) * per_s,
        (newest.tip_z_m - before.tip_z_m) * per_s,
    )


def as_array(observed: Observed) -> NDArray[np.float32]:
    """The observation as the policy takes it, float32 [8]."""
    return np.array(observed.values, dtype=np.float32)
