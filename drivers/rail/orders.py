"""What of the daemon's set-points is in force: each is good for a while, and permission to move has to be kept alive.

Pure: set-points and the time go in.
"""

import math

from softarm.drivers.rail.pair import SetPoint


class Orders:
    """A set-point that is not renewed for `hold_s` counts as zero, until the next one comes.

    Moving is permitted from an enabled set-point that follows a disabled one heard here, until a disabled one, until
    none has come for `time_to_live_s`, or until it is forbidden.
    """

    def __init__(self, hold_s: float, time_to_live_s: float) -> None:
        self._hold_ns, self._live_ns = round(hold_s * 1e9), round(time_to_live_s * 1e9)
        # Enabled, so that the first one heard permits nothing: a process before this one may have been flying.
        self._newest = SetPoint(0, 0, True, 0.0)
        self.permitted_since_ns: int | None = None

    @property
    def number(self) -> int:
        """Of the newest set-point."""
        return self._newest.number

    @property
    def enable(self) -> bool:
        """Does the daemon want the drive in operation?"""
        return self._newest.enable

    def take(self, set_point: SetPoint, now_ns: int) -> bool:
        """Hear a set-point. True when it permits moving anew."""
        t_ns = min(set_point.t_ns, now_ns)
        velocity_m_s = set_point.velocity_m_s if math.isfinite(set_point.velocity_m_s) else 0.0
        turn = set_point.enable and not self._newest.enable
        if not set_point.enable:
            self.forbid()
        elif turn:
            self.permitted_since_ns = now_ns
        self._newest = set_point._replace(t_ns=t_ns, velocity_m_s=velocity_m_s)
        return turn

    def forbid(self) -> None:
        """Until the daemon has disabled and enabled again."""
        self.permitted_since_ns = None

    def lapse(self, now_ns: int) -> bool:
        """Forbid if the time to live has run out. True when that has just happened."""
        lapsed = self.permitted_since_ns is not None and now_ns - self._newest.t_ns > self._live_ns
        if lapsed:
            self.forbid()
        return lapsed

    def velocity_m_s(self, now_ns: int) -> float:
        """What the drive may be told now."""
        return self._newest.velocity_m_s if self.holds(now_ns) else 0.0

    def holds(self, now_ns: int) -> bool:
        """Is the newest set-point in force?"""
        return self.permitted_since_ns is not None and self.holds_for_ns(now_ns) >= 0

    def holds_for_ns(self, now_ns: int) -> int:
        """Until the newest set-point is too old to be believed."""
        return self._newest.t_ns + self._hold_ns - now_ns
