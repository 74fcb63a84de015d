"""Check that the cart follows the set-points of its drive. Pure.

The braking law gives the range of velocities that the sent set-points allow. The range starts when the drive is enabled
and never uses later readings, so a drive that lags a little in every tick is found like one that does not move.
"""

from collections.abc import Iterable

from softarm.common.braking import BrakingLaw, fastest, stretches
from softarm.schemas.messages import RailReading

TOLERANCE_M_S = 0.25  # a swinging arm holds the cart back or drags it along: up to 0.1 observed
TICKS = 6  # in a row, with new readings
APART_S = 0.5  # readings further apart are not compared


class Following:
    """Range of velocities possible for the cart, and for how long it has been outside."""

    def __init__(self, law: BrakingLaw) -> None:
        self._law = law
        self._t_ns = 0  # of the newest reading
        self._range: tuple[float, float] | None = None  # slowest, fastest; None while disabled
        self.error_m_s = 0.0  # distance of the newest reading from the range
        self.ticks = 0  # in a row with an error above the tolerance

    @property
    def is_lost(self) -> bool:
        """Return whether the drive has failed to follow for too long."""
        return self.ticks >= TICKS

    def update(self, rail: RailReading | None, sent: Iterable[tuple[int, float]]) -> None:
        """Process a reading of the axis.

        Args:
            rail: Newest axis reading.
            sent: Time (ns) and velocity (m/s) of all set-points that may have acted since the last reading, oldest
                first.
        """
        if rail is None or not rail.enabled:
            self._range, self.error_m_s, self.ticks = None, 0.0, 0
            return
        since_s = (rail.t_receive_ns - self._t_ns) * 1e-9
        if self._range is None or not 0.0 <= since_s <= APART_S:
            self._range, self.ticks = (rail.velocity_m_s, rail.velocity_m_s), 0
        elif since_s > 0.0:
            set_points = [((rail.t_receive_ns - t_ns) * 1e-9, each) for t_ns, each in sent if t_ns <= rail.t_receive_ns]
            parts = stretches(self._law, set_points, -since_s, 0.0)
            slowest, highest = self._range
            slowest = -fastest(self._law, -slowest, [(time_s, -lowest) for time_s, _, lowest in parts])
            highest = fastest(self._law, highest, [(time_s, top) for time_s, top, _ in parts])
            self._range = (slowest, highest)
            self.error_m_s = max(rail.velocity_m_s - highest, slowest - rail.velocity_m_s, 0.0)
            self.ticks = self.ticks + 1 if self.error_m_s > TOLERANCE_M_S else 0
        self._t_ns = rail.t_receive_ns
