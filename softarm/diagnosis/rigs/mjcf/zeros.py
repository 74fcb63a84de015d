"""Zeros of a joint that differ between recordings: dry friction holds the pose that sets an encoder's zero."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine.view import Array

# Largest zero of one recording beside the others', in errors of a good zero.
APART = 20
# Share of the squares left that these zeros have to explain to be reported.
REPORTED = 0.5


@dataclass(frozen=True, slots=True)
class Zeros:
    """Linear change of a joint's M gaps with a zero of each of K recordings; their mean stays a gap."""

    recording: NDArray[np.int64]  # of each sample, [M]
    change: Array  # of the gap per rad or m of a zero, [M]
    good: float  # error of a good zero, rad or m

    @classmethod
    def of(cls, recordings: Sequence[str], trial: NDArray[np.int64], change: Array, good: float) -> "Zeros":
        """Return the zeros of a joint.

        Args:
            recordings: recording of each trial.
            trial: trial of each sample, [M].
            change: change of the gap with a zero, per rad or m; NaN where no sample was measured [M].
            good: error of a good zero, rad or m.
        """
        names = list(dict.fromkeys(recordings))
        return cls(np.array([names.index(name) for name in recordings])[trial], np.nan_to_num(change), good)

    def without(self, gaps: Array) -> Array:
        """Return gaps [P, M] without the zeros that explain them best, [P, M]."""
        return np.asarray(gaps + self._best(gaps)[:, self.recording] * self.change)

    def apart(self, gaps: Array) -> float:
        """Return the range of the zeros that explain most of some gaps [1, M], rad or m; 0 if there is none."""
        zeros = self._best(gaps)
        explained = np.nansum(self.without(gaps) ** 2) < (1 - REPORTED) * np.nansum(gaps**2)
        apart, largest = float(np.ptp(zeros)), np.abs(zeros).max()
        return apart if explained and self.good < apart and largest < APART * self.good else 0.0

    def _best(self, gaps: Array) -> Array:
        """Return the zero of each recording beside their mean that explains gaps [P, M] best, rad or m, [P, K]."""
        change = np.where(np.isnan(gaps[0]), 0.0, self.change)
        squares = np.maximum(np.bincount(self.recording, change**2), 1e-30)
        explained = -change * np.nan_to_num(gaps)
        products = np.stack([explained[:, self.recording == k].sum(axis=1) for k in range(len(squares))], axis=1)
        mean = products.sum(axis=1, keepdims=True) / squares.sum()
        return np.asarray(np.clip(products / squares - mean, -APART * self.good, APART * self.good))
