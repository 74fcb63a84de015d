"""Changes of a joint's rigid-body terms with its bodies and the base: masses, payload, length of the link, tilt."""

from functools import cache, cached_property
from typing import NamedTuple

import numpy as np

from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.mjcf.mechanism import Change, Joint, Mechanism
from softarm.diagnosis.rigs.mjcf.others import OtherJoints

# Changes at which the terms are computed.
MASS_STEP, PAYLOAD_STEP_KG, TILT_STEP_RAD = 0.1, 0.05, 0.05
LENGTH_SHARES = (-0.1, 0.1)
# Places of a payload from which all others follow.
LATTICE = [(i, j, k) for i in range(3) for j in range(3 - i) for k in range(3 - i - j)]
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

    Masses and tilts enter linearly, the place of a payload and lengths as polynomials of second degree.

    Attributes:
        base: terms of the model.
        reach_m: usual distance of a payload from the last joint; 0 on a balanced link.
        axes: axes about which a tilt of the base turns gravity.
        loaded: returns the change per kg of a payload at a place in reaches.
        longer: returns the change at one of LENGTH_SHARES of the joint's link.
        tilted: returns the change per rad of a tilt about one of the axes.
        part: returns the change per share of the mass of one of the joint's parts, by its first body.
        late: returns the change with forces of earlier speeds.
    """

    def __init__(self, mechanism: Mechanism, joint: Joint, others: OtherJoints) -> None:
        """Compute the terms of the model; others: motion of the other joints."""
        self.reach_m = mechanism.last_link(joint).reach_m
        self._others, self.base = others, others.terms(Change())
        self.axes = tuple(mechanism.level_axes)
        self.loaded, self.longer, self.tilted = cache(self._loaded), cache(self._longer), cache(self._tilted)
        self.part = cache(lambda part: self._change(Change(mass_share=MASS_STEP, bodies=joint.parts[part])) / MASS_STEP)
        self.late = cache(lambda late_s: others.terms_late(late_s) - self.base)

    @cached_property
    def heavier(self) -> Array:
        """Change per share of all masses behind the joint, [ROWS, M]."""
        return self._change(Change(mass_share=MASS_STEP)) / MASS_STEP

    def at(self, change: BodyChange, start: Array | None = None) -> Array:
        """Return the terms with changed bodies, [ROWS, M]; start: terms to start from, instead of the base."""
        found = (self.base if start is None else start).copy()
        if change.mass_share:
            found += change.mass_share * self.heavier
        if change.payload_kg:
            found += change.payload_kg * self._carried(change.payload_m)
        if change.length_share:
            found += self._stretched(change.length_share)
        for axis, angle in change.tilts_rad:
            found += angle * self.tilted(axis)
        for part, share in change.part_shares:
            found += share * self.part(part)
        if change.late_s:
            found += self.late(change.late_s)
        return found

    def _carried(self, at_m: Place) -> Array:
        """Return the change per kg of a payload, from the places of a lattice of second degree, [ROWS, M]."""
        if not self.reach_m:
            return self.loaded((0, 0, 0))
        x, y, z = (each / self.reach_m for each in at_m)
        weights = {
            (i, j, k): _basis(x, i) * _basis(y, j) * _basis(z, k) * _basis(2 - x - y - z, 2 - i - j - k)
            for i, j, k in LATTICE
        }
        return np.asarray(sum(weight * self.loaded(place) for place, weight in weights.items() if weight))

    def _stretched(self, share: float) -> Array:
        """Return the change by a longer link, from those of LENGTH_SHARES, [ROWS, M]."""
        low, high = LENGTH_SHARES
        lower, higher = (share * (share - b) / (a * (a - b)) for a, b in ((low, high), (high, low)))
        return np.asarray(lower * self.longer(low) + higher * self.longer(high))

    def _loaded(self, place: tuple[int, int, int]) -> Array:
        x, y, z = (self.reach_m * each for each in place)
        return self._change(Change(payload_kg=PAYLOAD_STEP_KG, payload_m=(x, y, z))) / PAYLOAD_STEP_KG

    def _longer(self, share: float) -> Array:
        return self._change(Change(length_share=share))

    def _tilted(self, axis: str) -> Array:
        return self._change(Change(tilts_rad={axis: TILT_STEP_RAD})) / TILT_STEP_RAD

    def _change(self, change: Change) -> Array:
        return self._others.terms(change) - self.base


def _basis(x: float, degree: int) -> float:
    """Return the factor of a lattice's Lagrange polynomial: 1 at x = degree, 0 at the integers below, to degree 2."""
    return (1.0, x, x * (x - 1) / 2)[degree]
