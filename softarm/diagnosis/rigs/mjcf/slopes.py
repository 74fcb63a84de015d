"""Changes of a joint's rigid-body terms with its bodies and the base: masses, payload, length of the link, tilt."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.mjcf.mechanism import Change, Course, Joint, Mechanism

# Changes at which the terms are computed.
MASS_STEP, PAYLOAD_STEP_KG, TILT_STEP_RAD = 0.1, 0.05, 0.05
LENGTH_SHARES = (-0.1, 0.0, 0.1)


class BodyChange(NamedTuple):
    """Fitted change of the bodies behind a joint and of the base."""

    mass_share: float
    payload_kg: float
    payload_m: float  # distance from the last joint
    length_share: float
    tilts_rad: tuple[tuple[str, float], ...] = ()  # axis, angle


class Slopes(NamedTuple):
    """Rigid-body terms of a recording and their changes. Masses and tilts enter linearly, lengths as a parabola."""

    base: Array  # [ROWS, T]
    heavier: Array  # [ROWS, T] per share of mass
    distances_m: tuple[float, ...]  # [D] places of a payload
    loaded: Array  # [D, ROWS, T] per kg of a payload at each place
    longer: Array  # [L, ROWS, T] at each of LENGTH_SHARES; [0, ROWS, T] if no joint follows on the link
    tilted: Mapping[str, Array]  # axis -> [ROWS, T] per rad of the base's tilt

    def at(self, change: BodyChange, start: Array | None = None) -> Array:
        """Return the terms with changed bodies, [ROWS, T]; start: terms to start from, instead of the base."""
        found = self.base if start is None else start
        if change.mass_share:
            found = found + change.mass_share * self.heavier
        if change.payload_kg:
            found = found + change.payload_kg * _interpolated(self.distances_m, self.loaded, change.payload_m)
        if change.length_share:
            found = found + _interpolated(LENGTH_SHARES, self.longer, change.length_share)
        for axis, angle in change.tilts_rad:
            found = found + angle * self.tilted[axis]
        return found


def slopes(mechanism: Mechanism, joint: Joint, course: Course) -> Slopes:
    """Return the rigid-body terms of a joint and their changes along a measured motion."""
    centre_m = mechanism.last_link(joint).centre_m
    distances = (0.0, centre_m, 2 * centre_m) if centre_m else (0.0,)
    base = mechanism.terms(joint, course)

    def changed(change: Change) -> Array:
        return mechanism.terms(joint, course, change) - base if change != Change() else np.zeros_like(base)

    loads = [Change(payload_kg=PAYLOAD_STEP_KG, payload_m=distance) for distance in distances]
    shares = LENGTH_SHARES if mechanism.carries(joint) else ()
    return Slopes(
        base=base,
        heavier=changed(Change(mass_share=MASS_STEP)) / MASS_STEP,
        distances_m=distances,
        loaded=np.stack([changed(load) for load in loads]) / PAYLOAD_STEP_KG,
        longer=np.array([changed(Change(length_share=share)) for share in shares]).reshape(len(shares), *base.shape),
        tilted={
            axis: changed(Change(tilts_rad={axis: TILT_STEP_RAD})) / TILT_STEP_RAD for axis in mechanism.level_axes
        },
    )


def joined(found: Sequence[Slopes]) -> Slopes:
    """Return the terms of all recordings one after the other, [..., M]."""
    first = found[0]
    return Slopes(
        base=np.concatenate([each.base for each in found], axis=-1),
        heavier=np.concatenate([each.heavier for each in found], axis=-1),
        distances_m=first.distances_m,
        loaded=np.concatenate([each.loaded for each in found], axis=-1),
        longer=np.concatenate([each.longer for each in found], axis=-1),
        tilted={axis: np.concatenate([each.tilted[axis] for each in found], axis=-1) for axis in first.tilted},
    )


def _interpolated(nodes: Sequence[float], values: Array, at: float) -> Array:
    """Return the polynomial through values at some nodes, [D, ...], at another place."""
    weights = [math.prod((at - b) / (a - b) for b in nodes if b != a) for a in nodes]
    return np.asarray(np.tensordot(weights, values, 1))
