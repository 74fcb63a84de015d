"""From what the devices measured to what the policy is fed. Pure; time comes in with the inputs."""

from collections import deque
from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from softarm.daemon.control.alignment import LAGS_NS, Alignment, Past
from softarm.daemon.control.dead_reckoning import DeadReckoning, Readings, Sighting, Strength, TipModel
from softarm.daemon.control.plausibility import CART, TIP, WINDOW, Plausibility, is_usable
from softarm.daemon.control.records import Inputs, Observed
from softarm.schemas.config import Config
from softarm.schemas.messages import MocapFrame, PressureReading, RailReading
from softarm.schemas.policy import Observation


class Observer:
    """Keeps the good frames of the last while, usable and plausible, and carries the newest on through the dark.

    Velocities are first differences over a control step ([P] section 3.3), by real capture stamps: from what was most
    nearly a step before the newest. Zero until there is something.
    """

    def __init__(self, config: Config) -> None:
        failsafe = config.failsafe
        self._period_ns = round(1e9 / config.control.rate_hz)
        self._stale_ns = round(failsafe.mocap_stale_s * 1e9)  # a gap longer than this is not differenced over
        self._bridge_ns = round(failsafe.mocap_bridge_s * 1e9)
        self._disagreement_m = failsafe.rail_mocap_disagreement_m  # farther apart, axis and mocap disagree
        self._recent: deque[Sighting] = deque()  # seen, of at least the last step, oldest first
        self._carried: deque[Sighting] = deque()  # and what was flown by between them
        self._reckoning: DeadReckoning | None = None  # from the newest one seen
        self._strength = Strength()
        self._ages_ns: deque[int] = deque(maxlen=WINDOW)  # of the newest one seen, at ticks that brought one
        self._pressures = Past()
        self._velocities = (0.0, 0.0, 0.0)  # cart, tip y, tip z
        self._sequence = 0  # of the newest good frame
        self._shown: Sighting | None = None  # what is flown by
        self.dark_ns = 0  # that it was carried on for; 0: it was seen
        self.plausibility = Plausibility()
        self._on_the_way_ns: deque[int] = deque(maxlen=WINDOW)
        self.newest: MocapFrame | None = None  # good or not
        self.good: MocapFrame | None = None  # the newest that is
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
        self.pressure, self.rail = inputs.pressure, inputs.rail
        if self.rail is not None:
            self.alignment.axis.add(self.rail.t_receive_ns, self.rail.position_m, self.rail.velocity_m_s)
        if self.pressure is not None:
            self._pressures.add(self.pressure.t_receive_ns, self.pressure.pressure_kpa)
        self.seen = tuple(self._good(inputs.mocap))
        if self.seen:
            self._recent.extend(self.seen)
            # Never below zero: a late loop reads what came after its start.
            self._ages_ns.append(max(0, inputs.t_ns - self.seen[-1].t_ns))
            self._reckoning = None
            self._strength.see(self.seen[-1], self._readings())
        self._show(inputs.t_ns)
        self._compare(inputs.t_ns)

    def _show(self, now_ns: int) -> None:
        """Fly by the newest that was seen; when that is older than it should be, by what it is carried on to."""
        if not self._recent:
            return
        newest = self._recent[-1]
        carried = self._carry_on(newest, now_ns - min(self._ages_ns))
        self.dark_ns = 0 if carried is None else carried.t_ns - newest.t_ns
        shown = carried or newest
        if carried is not None or self.seen:
            before = self._step_before(shown, (*self._recent, *self._carried))
            self._velocities = (0.0, 0.0, 0.0) if before is None else _rates(before, shown)
        elif now_ns - newest.t_ns > self._stale_ns:
            self.frames_in_a_row = 0
            self._velocities = (0.0, 0.0, 0.0)
        self._shown = shown
        if carried is not None:
            self._carried.append(carried)
        for past, newest_ns in ((self._recent, newest.t_ns), (self._carried, shown.t_ns)):
            while len(past) > 1 and newest_ns - past[1].t_ns >= 2 * self._period_ns:  # no later step begins there
                past.popleft()

    def _carry_on(self, newest: Sighting, until_ns: int) -> Sighting | None:
        """To when the cameras' newest would be from by now; None when it is seen, or was for too long not."""
        overdue_ns = until_ns - newest.t_ns - self._period_ns // 2
        if not 0 < overdue_ns <= self._bridge_ns:
            return None
        if self._reckoning is None:
            # Of what was seen alone: an estimate that the next begins with would feed its error back, ever larger.
            before = self._step_before(newest, self._recent)
            if before is None:
                return None
            self._reckoning = DeadReckoning(before, newest, self._readings(), self._strength.value)
        return self._reckoning.at(until_ns)

    def _readings(self) -> Readings:
        return Readings(self.alignment.axis, self._pressures, self.alignment.lag_ns or 0)

    def _step_before(self, shown: Sighting, past: Iterable[Sighting]) -> Sighting | None:
        """Most nearly a control step before."""
        return min(
            (one for one in past if one.t_ns < shown.t_ns and shown.t_ns - one.t_ns <= self._stale_ns),
            key=lambda one: abs(shown.t_ns - one.t_ns - self._period_ns),
            default=None,
        )

    def _compare(self, now_ns: int) -> None:
        """Axis and motion capture, where both are fresh; a silent one tells nothing of the other."""
        apart_m = self.alignment.see(self.seen[-1].t_ns, self.seen[-1].cart_y_m) if self.seen else None
        at_first_m = self._apart_at_first_m(now_ns) if apart_m is None else None
        if at_first_m is not None:
            self.apart_m = at_first_m
        if apart_m is not None:
            self.apart_m = apart_m
            self.disagreeing_ticks = self.disagreeing_ticks + 1 if apart_m > self._disagreement_m else 0

    def _apart_at_first_m(self, now_ns: int) -> float | None:
        """The same before the axis has a past, at its first reading: its drive may have forgotten its zero. m.

        None once it has one. What a camera that is late by any possible delay explains is not counted.
        """
        rail, fresh_ns = self.rail, now_ns - self._stale_ns
        if rail is None or rail.t_receive_ns < fresh_ns or not self._recent or self._recent[-1].t_ns < fresh_ns:
            return None
        if self.alignment.axis.at(self._recent[-1].t_ns - LAGS_NS[-1]) is not None:
            return None
        explained_m = abs(rail.velocity_m_s) * (LAGS_NS[-1] + self._stale_ns) * 1e-9
        return max(0.0, abs(rail.position_m - self._recent[-1].cart_y_m) - explained_m)

    def _good(self, frames: tuple[MocapFrame, ...]) -> Iterator[Sighting]:
        newest_ns = self._recent[-1].t_ns if self._recent else None
        axis_m = self.rail.position_m if self.rail is not None else None
        for frame in frames:
            if self.newest is not None and frame.sequence > self.newest.sequence + 1:
                self.frames_lost += frame.sequence - self.newest.sequence - 1
            self.newest = frame
            newer = newest_ns is None or frame.t_capture_ns > newest_ns
            if newer and is_usable(frame) and self.plausibility.accepts(frame, axis_m):
                newest_ns, self._sequence, self.good = frame.t_capture_ns, frame.sequence, frame
                self.frames_in_a_row += 1
                self._on_the_way_ns.append(frame.t_receive_ns - frame.t_capture_ns)
                yield _sighting(frame)

    def mocap_age_ns(self, now_ns: int) -> int | None:
        """Age of the newest good frame's capture; None before the first."""
        return now_ns - self._recent[-1].t_ns if self._recent else None

    def mocap_late_ns(self) -> int:
        """How old a pose is on arrival: by its stamps, and by what the axis shows that they do not say."""
        if not self._on_the_way_ns:
            return 0
        return round(sum(self._on_the_way_ns) / len(self._on_the_way_ns)) + (self.alignment.lag_ns or 0)

    @property
    def tip_deviation_m(self) -> float:
        """Standard deviation of a tip that was carried on; 0 of one that was seen."""
        return TipModel().deviation_m(self.dark_ns * 1e-9) if self.dark_ns else 0.0

    def observe(self, now_ns: int, previous_cart_velocity_m_s: float) -> Observed | None:
        """The observation and its age; None while a sensor has never been heard."""
        if self._shown is None or self.pressure is None or self.rail is None:
            return None
        shown = self._shown
        cart_velocity, tip_vy, tip_vz = self._velocities
        return Observed(
            values=Observation(
                cart_position_m=shown.cart_y_m,
                cart_velocity_m_s=cart_velocity,
                tip_y_m=shown.tip_y_m,
                tip_z_m=shown.tip_z_m,
                tip_vy_m_s=tip_vy,
                tip_vz_m_s=tip_vz,
                previous_cart_velocity_command_m_s=previous_cart_velocity_m_s,
                pressure_kpa=self.pressure.pressure_kpa,
            ),
            mocap_sequence=self._sequence,
            mocap_age_ns=now_ns - self._recent[-1].t_ns,
            pressure_age_ns=now_ns - self.pressure.t_receive_ns,
            rail_age_ns=now_ns - self.rail.t_receive_ns,
            dark_ns=self.dark_ns,
            tip_deviation_m=self.tip_deviation_m,
        )


def _sighting(frame: MocapFrame) -> Sighting:
    cart, tip = frame.bodies[CART], frame.bodies[TIP]
    return Sighting(frame.t_capture_ns, cart.y_m, tip.y_m, tip.z_m)


def _rates(before: Sighting, newest: Sighting) -> tuple[float, float, float]:
    """Of cart and tip (y, z), m/s."""
    per_s = 1e9 / (newest.t_ns - before.t_ns)
    return (
        (newest.cart_y_m - before.cart_y_m) * per_s,
        (newest.tip_y_m - before.tip_y_m) * per_s,
        (newest.tip_z_m - before.tip_z_m) * per_s,
    )


def as_array(observed: Observed, wants_sight: bool) -> NDArray[np.float32]:
    """The observation as the policy takes it, float32 [8]; with what tells whether it was seen, [10]."""
    sight = (observed.dark_ns * 1e-9, observed.tip_deviation_m) if wants_sight else ()
    return np.array((*observed.values, *sight), dtype=np.float32)
