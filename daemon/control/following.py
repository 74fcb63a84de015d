"""Does the cart do what its drive was told? Pure.

The braking law says between which velocities a cart can be that was sent these set-points. It is asked from the moment
the drive was switched on, and never told where the cart really is: so a drive that does a little too little, tick after
tick, stands out as one that does nothing at all.
"""

from collections.abc import Iterable

from softarm.common.braking import BrakingLaw, fastest, stretches
from softarm.schemas.messages import RailReading

TOLERANCE_M_S = 0.25  # an arm that is swung up holds a cart back, or drags it along: 0.1 was seen
TICKS = 6  # in a row, with readings that are new
APART_S = 0.5  # readings further apart say nothing of each other


class Following:
    """The fastest and the slowest that the cart can be, and for how long it has been neither."""

    def __init__(self, law: BrakingLaw) -> None:
        self._law = law
        self._t_ns = 0  # of the newest reading
        self._range: tuple[float, float] | None = None  # slowest, fastest; None: not switched on
        self.off_m_s = 0.0  # how far the newest reading lies outside
        self.ticks = 0  # in a row that it lay outside by more than the tolerance

    @property
    def lost(self) -> bool:
        """The drive does not follow."""
        return self.ticks >= TICKS

    def update(self, rail: RailReading | None, sent: Iterable[tuple[int, float]]) -> None:
        """Take in a reading; sent: when (ns) and what (m/s), oldest first, all that may have acted since the last."""
        if rail is None or not rail.enabled:
            self._range, self.off_m_s, self.ticks = None, 0.0, 0
            return
        since_s = (rail.t_receive_ns - self._t_ns) * 1e-9
        if self._range is None or not 0.0 <= since_s <= APART_S:
            self._range, self.ticks = (rail.velocity_m_s, rail.velocity_m_s), 0
        elif since_s > 0.0:
            told = [((rail.t_receive_ns - t_ns) * 1e-9, each) for t_ns, each in sent if t_ns <= rail.t_receive_ns]
            parts = stretches(self._law, told, -since_s, 0.0)
            slowest, highest = self._range
            slowest = -fastest(self._law, -slowest, [(time_s, -lowest) for time_s, _, lowest in parts])
            highest = fastest(self._law, highest, [(time_s, top) for time_s, top, _ in parts])
            self._range = (slowest, highest)
            self.off_m_s = max(rail.velocity_m_s - highest, slowest - rail.velocity_m_s, 0.0)
            self.ticks = self.ticks + 1 if self.off_m_s > TOLERANCE_M_S else 0
        self._t_ns = rail.t_receive_ns
