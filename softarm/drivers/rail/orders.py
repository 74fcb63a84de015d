"""Validity of the daemon's set-points: each one expires, and so does the permission to move.

Pure: set-points and the time go in.
"""

import math

from softarm.drivers.rail.pair import SetPoint


class Orders:
    """Newest set-point and the permission to move.

    A set-point that is not renewed for `hold_s` counts as zero until the next one arrives. Moving is permitted from
    the first enabled set-point after a disabled one. The permission ends with a disabled set-point, after
    `time_to_live_s` without any set-point, or by `forbid`.
    """

    def __init__(self, hold_s: float, time_to_live_s: float) -> None:
        self._hold_ns, self._live_ns = round(hold_s * 1e9), round(time_to_live_s * 1e9)
        # Starts enabled, so that a first enabled set-point permits nothing: an earlier process may have been moving.
        self._newest = SetPoint(0, 0, True, 0.0)
        self.permitted_since_ns: int | None = None

    @property
    def number(self) -> int:
        """Number of the newest set-point."""
        return self._newest.number

    @property
    def enable(self) -> bool:
        """Whether the daemon requests operation."""
        return self._newest.enable

    def accept(self, set_point: SetPoint, now_ns: int) -> bool:
        """Store a set-point and return whether it begins a new permission to move."""
        t_ns = min(set_point.t_ns, now_ns)
        velocity_m_s = set_point.velocity_m_s if math.isfinite(set_point.velocity_m_s) else 0.0
        begins = set_point.enable and not self._newest.enable
        if not set_point.enable:
            self.forbid()
        elif begins:
            self.permitted_since_ns = now_ns
        self._newest = set_point._replace(t_ns=t_ns, velocity_m_s=velocity_m_s)
        return begins

    def forbid(self) -> None:
        """Withdraw the permission until the daemon has disabled and enabled again."""
        self.permitted_since_ns = None

    def expire(self, now_ns: int) -> bool:
        """Withdraw the permission if its time to live has run out, and return whether that has just happened."""
        expired = self.permitted_since_ns is not None and now_ns - self._newest.t_ns > self._live_ns
        if expired:
            self.forbid()
        return expired

    def velocity_m_s(self, now_ns: int) -> float:
        """Return the velocity that may be sent now; zero without a valid set-point."""
        return self._newest.velocity_m_s if self.is_valid(now_ns) else 0.0

    def is_valid(self, now_ns: int) -> bool:
        """Return whether moving is permitted and the newest set-point has not expired."""
        return self.permitted_since_ns is not None and self.valid_for_ns(now_ns) >= 0

    def valid_for_ns(self, now_ns: int) -> int:
        """Return the time until the newest set-point expires; negative afterwards."""
        return self._newest.t_ns + self._hold_ns - now_ns
