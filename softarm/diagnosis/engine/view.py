"""Interface of a view: one stage simulated from its measured inputs and compared with its measured outputs.

The search over effects (`softarm.diagnosis.engine.search`) uses nothing else of a robot.
"""

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# 'stage.effect.parameter' -> value in the registry's unit; other parameters are those of the nominal model.
Point = Mapping[str, float]


class View(Protocol):
    """View of one stage: M samples of all trials in order, on uniform stamps within each trial; S channels."""

    stage: str  # of `softarm.simulator.effects.STAGES` or of a rig
    unit: str  # of all channels
    channels: tuple[str, ...]  # names in words, [S]
    t_s: Array  # time on the trial's clock, s, [M]
    trial: NDArray[np.int64]  # index of each sample's trial, [M]
    measured: Array  # [M, S]; NaN if missing
    floor: Array  # noise floor, RMS, [S]: sensor noise and the tolerance of a good simulator
    noise: Array  # RMS of further white measurement noise, [S]; it does not count as a gap
    acts: frozenset[str]  # parameters (keys of a Point) that act on the prediction

    @property
    def regimes(self) -> Mapping[str, NDArray[np.bool_]]:
        """Return masks [M] of parts of the data by name: inflating, at reversals, near the end of the rail, ..."""

    @property
    def features(self) -> Mapping[str, Array]:
        """Return inputs and measured states [M] by name, for a flexible model of the residual."""

    @property
    def echoes(self) -> frozenset[str]:
        """Return the features that contain the view's own measurement, and so the residual's noise."""

    @property
    def own_nuisances(self) -> Mapping[str, float]:
        """Return nuisances of this view alone: name -> relative change at the edge of the box."""

    def own_directions(self) -> NDArray[np.float32]:
        """Return the changes of the gap with the view's own nuisances, to their edges, [q, M, S]."""
        return np.empty((0, *self.measured.shape), np.float32)

    def start_directions(self) -> NDArray[np.float32] | None:
        """Return the changes of the gap with a trial's start, [d, M, S], or None if the start is measured."""
        return None

    def gap(self, points: Sequence[Point]) -> NDArray[np.float32]:
        """Return measured minus predicted at each point, [P, M, S]; NaN if not measured."""
