"""Observer: turns the devices' measurements into the policy's observation. Pure; time comes with the inputs."""

from collections import deque
from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from softarm.daemon.control.alignment import LAGS_NS, Alignment, ReadingHistory
from softarm.daemon.control.dead_reckoning import DeadReckoning, Readings, Strength, TipModel, TrackedPose
from softarm.daemon.control.plausibility import CART, TIP, WINDOW, Plausibility, is_usable
from softarm.daemon.control.records import Inputs, Observed
from softarm.schemas.config import Config
from softarm.schemas.messages import MocapFrame, PressureReading, RailReading
from softarm.schemas.policy import Observation


class Observer:
    """Observation from recent good frames (usable and plausible), bridged by dead reckoning during dropouts.

    Velocities are first differences by capture stamps ([P] section 3.3), between the newest pose and the one closest to
    a control step before it; zero until there are two.
    """

    def __init__(self, config: Config) -> None:
        failsafe = config.failsafe
        self._period_ns = round(1e9 / config.control.rate_hz)
        self._stale_ns = round(failsafe.mocap_stale_s * 1e9)  # no difference is taken over a longer gap
        self._bridge_ns = round(failsafe.mocap_bridge_s * 1e9)
        self._disagreement_m = failsafe.rail_mocap_disagreement_m  # a larger distance is a disagreement
        self._recent: deque[TrackedPose] = deque()  # seen, at least over the last step, oldest first
        self._estimated: deque[TrackedPose] = deque()  # estimated between them
        self._reckoning: DeadReckoning | None = None  # from the newest seen pose
        self._strength = Strength()
        self._ages_ns: deque[int] = deque(maxlen=WINDOW)  # of the newest seen pose, in ticks that brought one
        self._pressures = ReadingHistory()
        self._velocities = (0.0, 0.0, 0.0)  # cart, tip y, tip z
        self._sequence = 0  # of the newest good frame
        self._current: TrackedPose | None = None  # pose for the policy
        self.bridged_ns = 0  # time bridged by dead reckoning; 0 if seen
        self.plausibility = Plausibility()
        self._transport_ns: deque[int] = deque(maxlen=WINDOW)
        self.newest: MocapFrame | None = None  # plausible or not
        self.good: MocapFrame | None = None  # newest plausible frame
        self.seen: tuple[TrackedPose, ...] = ()  # in this tick, oldest first
        self.pressure: PressureReading | None = None
        self.rail: RailReading | None = None
        self.frames_in_a_row = 0  # good frames without a gap, for arming
        self.alignment = Alignment()
        self.apart_m: float | None = None  # distance of axis and mocap at the last comparison
        self.disagreeing_ticks = 0  # in a row

    def update(self, inputs: Inputs) -> None:
        """Process the measurements of a tick."""
        self.pressure, self.rail = inputs.pressure, inputs.rail
        if self.rail is not None:
            self.alignment.axis.add(self.rail.t_receive_ns, self.rail.position_m, self.rail.velocity_m_s)
        if self.pressure is not None:
            self._pressures.add(self.pressure.t_receive_ns, self.pressure.pressure_kpa)
        self.seen = tuple(self._good(inputs.mocap))
        if self.seen:
            self._recent.extend(self.seen)
            # Never below zero: a late loop reads frames that arrived after its start.
            self._ages_ns.append(max(0, inputs.t_ns - self.seen[-1].t_ns))
            self._reckoning = None
            self._strength.update(self.seen[-1], self._readings())
        self._update_pose(inputs.t_ns)
        self._compare(inputs.t_ns)

    def _update_pose(self, now_ns: int) -> None:
        """Use the newest seen pose, or its extrapolation if it is overdue."""
        if not self._recent:
            return
        newest = self._recent[-1]
        carried = self._extrapolate(newest, now_ns - min(self._ages_ns))
        self.bridged_ns = 0 if carried is None else carried.t_ns - newest.t_ns
        shown = carried or newest
        if carried is not None or self.seen:
            before = self._step_before(shown, (*self._recent, *self._estimated))
            self._velocities = (0.0, 0.0, 0.0) if before is None else _rates(before, shown)
        elif now_ns - newest.t_ns > self._stale_ns:
            self.frames_in_a_row = 0
            self._velocities = (0.0, 0.0, 0.0)
        self._current = shown
        if carried is not None:
            self._estimated.append(carried)
        for past, newest_ns in ((self._recent, newest.t_ns), (self._estimated, shown.t_ns)):
            while len(past) > 1 and newest_ns - past[1].t_ns >= 2 * self._period_ns:  # older than any later step needs
                past.popleft()

    def _extrapolate(self, newest: TrackedPose, until_ns: int) -> TrackedPose | None:
        """Extrapolate the newest pose if it is overdue, but not longer than the bridging time."""
        overdue_ns = until_ns - newest.t_ns - self._period_ns // 2
        if not 0 < overdue_ns <= self._bridge_ns:
            return None
        if self._reckoning is None:
            # From seen poses alone: starting from an estimate would feed its error back.
            before = self._step_before(newest, self._recent)
            if before is None:
                return None
            self._reckoning = DeadReckoning(before, newest, self._readings(), self._strength.value)
        return self._reckoning.at(until_ns)

    def _readings(self) -> Readings:
        return Readings(self.alignment.axis, self._pressures, self.alignment.lag_ns or 0)

    def _step_before(self, shown: TrackedPose, past: Iterable[TrackedPose]) -> TrackedPose | None:
        """Return the pose closest to a control step before."""
        return min(
            (pose for pose in past if pose.t_ns < shown.t_ns and shown.t_ns - pose.t_ns <= self._stale_ns),
            key=lambda pose: abs(shown.t_ns - pose.t_ns - self._period_ns),
            default=None,
        )

    def _compare(self, now_ns: int) -> None:
        """Compare axis and motion capture while both are fresh."""
        apart_m = self.alignment.update(self.seen[-1].t_ns, self.seen[-1].cart_y_m) if self.seen else None
        at_first_m = self._apart_at_first_m(now_ns) if apart_m is None else None
        if at_first_m is not None:
            self.apart_m = at_first_m
        if apart_m is not None:
            self.apart_m = apart_m
            self.disagreeing_ticks = self.disagreeing_ticks + 1 if apart_m > self._disagreement_m else 0

    def _apart_at_first_m(self, now_ns: int) -> float | None:
        """Return the distance of axis and motion capture at the first axis reading, m; None later.

        The drive may have lost its zero. A distance that any possible latency explains does not count.
        """
        rail, fresh_ns = self.rail, now_ns - self._stale_ns
        if rail is None or rail.t_receive_ns < fresh_ns or not self._recent or self._recent[-1].t_ns < fresh_ns:
            return None
        if self.alignment.axis.at(self._recent[-1].t_ns - LAGS_NS[-1]) is not None:
            return None
        explained_m = abs(rail.velocity_m_s) * (LAGS_NS[-1] + self._stale_ns) * 1e-9
        return max(0.0, abs(rail.position_m - self._recent[-1].cart_y_m) - explained_m)

    def _good(self, frames: tuple[MocapFrame, ...]) -> Iterator[TrackedPose]:
        newest_ns = self._recent[-1].t_ns if self._recent else None
        axis_m = self.rail.position_m if self.rail is not None else None
        for frame in frames:
            self.newest = frame
            newer = newest_ns is None or frame.t_capture_ns > newest_ns
            if newer and is_usable(frame) and self.plausibility.accepts(frame, axis_m):
                newest_ns, self._sequence, self.good = frame.t_capture_ns, frame.sequence, frame
                self.frames_in_a_row += 1
                self._transport_ns.append(frame.t_receive_ns - frame.t_capture_ns)
                yield _tracked_pose(frame)

    def mocap_age_ns(self, now_ns: int) -> int | None:
        """Return the age of the newest good frame's capture, or None if there is none yet."""
        return now_ns - self._recent[-1].t_ns if self._recent else None

    def mocap_late_ns(self) -> int:
        """Return the age of a pose on arrival: by its stamps plus the latency estimated from the axis."""
        if not self._transport_ns:
            return 0
        return round(sum(self._transport_ns) / len(self._transport_ns)) + (self.alignment.lag_ns or 0)

    @property
    def tip_deviation_m(self) -> float:
        """Return the standard deviation of an estimated tip, m; 0 if the tip was seen."""
        return TipModel().deviation_m(self.bridged_ns * 1e-9) if self.bridged_ns else 0.0

    def observe(self, now_ns: int, previous_cart_velocity_m_s: float) -> Observed | None:
        """Return the current observation and its age, or None until every sensor has delivered a sample."""
        if self._current is None or self.pressure is None or self.rail is None:
            return None
        shown = self._current
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
            bridged_ns=self.bridged_ns,
            tip_deviation_m=self.tip_deviation_m,
        )


def _tracked_pose(frame: MocapFrame) -> TrackedPose:
    cart, tip = frame.bodies[CART], frame.bodies[TIP]
    return TrackedPose(frame.t_capture_ns, cart.y_m, tip.y_m, tip.z_m)


def _rates(before: TrackedPose, newest: TrackedPose) -> tuple[float, float, float]:
    """Return the velocities of the cart and of the tip (y, z), m/s."""
    per_s = 1e9 / (newest.t_ns - before.t_ns)
    return (
        (newest.cart_y_m - before.cart_y_m) * per_s,
        (newest.tip_y_m - before.tip_y_m) * per_s,
        (newest.tip_z_m - before.tip_z_m) * per_s,
    )


def as_array(observed: Observed, wants_tracking: bool) -> NDArray[np.float32]:
    """Return the observation as float32 [8], or [10] with dropout duration and tip deviation for `wants_tracking`."""
    tracking = (observed.bridged_ns * 1e-9, observed.tip_deviation_m) if wants_tracking else ()
    return np.array((*observed.values, *tracking), dtype=np.float32)
