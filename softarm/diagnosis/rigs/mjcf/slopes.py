"""Changes of a joint's rigid-body terms with its bodies and the base: masses, payload, length of the link, tilt."""

from functools import cache, cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.mjcf.loads import powers
from softarm.diagnosis.rigs.mjcf.mechanism import Changes, Joint, Mechanism
from softarm.diagnosis.rigs.mjcf.others import OtherJoints

# Changes of a length at which the terms are computed.
LENGTH_SHARES = (-0.1, 0.1)
# Places of a payload whose change is kept.
KEPT = 8
# Place of a payload along the axes of the last link.
Place = tuple[float, float, float]


class BodyChange(NamedTuple):
    """Change of the rigid-body terms: of the bodies behind a joint, of the base, and of a simulation's steps."""

    mass_share: float
    payload_kg: float
    payload_m: Place  # along the axes of the last link
    length_share: float
    tilts_rad: tuple[tuple[str, float], ...] = ()  # axis, angle
    part_shares: tuple[tuple[str, float], ...] = ()  # first body of a part, share of its mass
    late_s: float = 0.0  # time by which forces have earlier speeds


class Slopes:
    """Rigid-body terms along a measured motion, [ROWS, M], and their changes, each computed at its first use.

    Masses and tilts enter linearly, lengths as a polynomial of second degree.

    Attributes:
        base: terms of the model.
        reach_m: usual distance of a payload from the last joint; 0 on a balanced link.
        loaded: returns the change per kg of a payload at a place.
        longer: returns the change at one of LENGTH_SHARES of the joint's link.
        late: returns the change with forces of earlier speeds.
    """

    def __init__(self, mechanism: Mechanism, joint: Joint, others: OtherJoints) -> None:
        """Compute the terms of the model; others: motion of the other joints."""
        self._link = mechanism.last_link(joint)
        self.reach_m = self._link.reach_m
        self._others, self.base = others, others.terms()
        self.loaded = lru_cache(KEPT)(self._loaded)
        self.longer = cache(lambda share: others.terms(share) - self.base)
        self.late = cache(lambda late_s: others.terms_late(late_s) - self.base)

    @cached_property
    def changes(self) -> Changes:
        """Changes with each part's mass, a payload and a tilt of the base, [ROWS, M] each."""
        return self._others.changes()

    @cached_property
    def heavier(self) -> Array:
        """Change per share of all masses behind the joint, [ROWS, M]."""
        return np.asarray(sum(self.changes.parts.values()))

    def at(self, change: BodyChange, start: Array | None = None) -> Array:
        """Return the terms with changed bodies, [ROWS, M]; start: terms to start from, instead of the base."""
        found = (self.base if start is None else start).copy()
        if change.mass_share:
            found += change.mass_share * self.heavier
        if change.payload_kg:
            found += change.payload_kg * self.loaded(change.payload_m)
        if change.length_share:
            found += self._stretched(change.length_share)
        for axis, angle in change.tilts_rad:
            found += angle * self.changes.tilted[axis]
        for part, share in change.part_shares:
            found += share * self.changes.parts[part]
        if change.late_s:
            found += self.late(change.late_s)
        return found

    def _loaded(self, at_m: Place) -> Array:
        return np.tensordot(powers(self._link.place(at_m)), self.changes.point, 1)

    def _stretched(self, share: float) -> Array:
        """Return the change by a longer link, from those of LENGTH_SHARES, [ROWS, M]."""
        low, high = LENGTH_SHARES
        lower, higher = (share * (share - b) / (a * (a - b)) for a, b in ((low, high), (high, low)))
        return np.asarray(lower * self.longer(low) + higher * self.longer(high))
