"""Changes of a joint's rigid-body terms with its bodies and the base: masses, payload, length of the link, tilt."""

import math
from collections.abc import Callable, Sequence
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np

from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.mjcf.mechanism import Change, Joint, Mechanism
from softarm.diagnosis.rigs.mjcf.others import OtherJoints

# Changes at which the terms are computed.
MASS_STEP, PAYLOAD_STEP_KG, TILT_STEP_RAD = 0.1, 0.05, 0.05
LENGTH_SHARES = (-0.1, 0.0, 0.1)


class BodyChange(NamedTuple):
    """Change of the rigid-body terms: of the bodies behind a joint, of the base, and of a simulation's steps."""

    mass_share: float
    payload_kg: float
    payload_m: float  # distance from the last joint
    length_share: float
    tilts_rad: tuple[tuple[str, float], ...] = ()  # axis, angle
    late_s: float = 0.0  # time by which forces have earlier speeds


class Slopes:
    """Rigid-body terms along a measured motion, [ROWS, M], and their changes, each computed at its first use.

    Masses and tilts enter linearly, lengths as a parabola.

    Attributes:
        base: terms of the model.
        distances_m: places of a payload from which those between are interpolated.
        axes: axes about which a tilt of the base turns gravity.
        loaded: returns the change per kg of a payload at one of these places.
        longer: returns the change at one of LENGTH_SHARES of the joint's link.
        tilted: returns the change per rad of a tilt about one of the axes.
        late: returns the change with forces of earlier speeds.
    """

    def __init__(self, mechanism: Mechanism, joint: Joint, others: OtherJoints) -> None:
        """Compute the terms of the model; others: motion of the other joints."""
        centre_m = mechanism.last_link(joint).centre_m
        self._others, self.base = others, others.terms(Change())
        self.distances_m = (0.0, centre_m, 2 * centre_m) if centre_m else (0.0,)
        self.axes = tuple(mechanism.level_axes)
        self.loaded, self.longer, self.tilted = cache(self._loaded), cache(self._longer), cache(self._tilted)
        self.late = cache(lambda late_s: others.terms_late(late_s) - self.base)

    @cached_property
    def heavier(self) -> Array:
        """Change per share of all masses behind the joint, [ROWS, M]."""
        return self._change(Change(mass_share=MASS_STEP)) / MASS_STEP

    def at(self, change: BodyChange, start: Array | None = None) -> Array:
        """Return the terms with changed bodies, [ROWS, M]; start: terms to start from, instead of the base."""
        found = self.base if start is None else start
        if change.mass_share:
            found = found + change.mass_share * self.heavier
        if change.payload_kg:
            found = found + change.payload_kg * _interpolated(self.distances_m, self.loaded, change.payload_m)
        if change.length_share:
            found = found + _interpolated(LENGTH_SHARES, self.longer, change.length_share)
        for axis, angle in change.tilts_rad:
            found = found + angle * self.tilted(axis)
        return found + self.late(change.late_s) if change.late_s else found

    def _loaded(self, distance_m: float) -> Array:
        return self._change(Change(payload_kg=PAYLOAD_STEP_KG, payload_m=distance_m)) / PAYLOAD_STEP_KG

    def _longer(self, share: float) -> Array:
        return self._change(Change(length_share=share)) if share else np.zeros_like(self.base)

    def _tilted(self, axis: str) -> Array:
        return self._change(Change(tilts_rad={axis: TILT_STEP_RAD})) / TILT_STEP_RAD

    def _change(self, change: Change) -> Array:
        return self._others.terms(change) - self.base


def _interpolated(nodes: Sequence[float], values: Callable[[float], Array], at: float) -> Array:
    """Return the polynomial through values at some nodes at another place; nodes without weight are not computed."""
    weights = [math.prod((at - b) / (a - b) for b in nodes if b != a) for a in nodes]
    return np.asarray(sum(weight * values(node) for weight, node in zip(weights, nodes, strict=True) if weight))
