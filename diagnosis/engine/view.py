"""A view: one stage of the robot, driven by what was measured upstream of it, against what was measured of it.

The search over effects (`softarm.diagnosis.engine.search`) knows nothing of robots but this.
"""

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# 'stage.effect.parameter' -> value in the registry's unit; what is not named stays as the nominal model has it.
Point = Mapping[str, float]


class View(Protocol):
    """M samples on uniform stamps within each of the trials, one after the other; S channels."""

    @property
    def stage(self) -> str:
        """Name of the stage, of `softarm.simulator.effects.STAGES` or of a single-stage table."""

    @property
    def unit(self) -> str:
        """Of every channel."""

    @property
    def channels(self) -> tuple[str, ...]:
        """[S] names, for people."""

    @property
    def t_s(self) -> Array:
        """[M] seconds of the trial's clock."""

    @property
    def trial(self) -> NDArray[np.int64]:
        """[M] index of the trial that a sample belongs to, into the diagnosis's list of trials."""

    @property
    def measured(self) -> Array:
        """[M, S]; NaN where nothing was measured."""

    @property
    def floor(self) -> Array:
        """[S] RMS that no simulator is blamed for: noise, and what two honest simulators of one robot differ by."""

    @property
    def noise(self) -> Array:
        """[S] RMS of white noise in the measurement beyond what the floor holds; it is no simulator's gap."""

    @property
    def acts(self) -> frozenset[str]:
        """Parameters (keys of a Point) that change what is predicted."""

    @property
    def regimes(self) -> Mapping[str, NDArray[np.bool_]]:
        """Name in words -> [M] mask: inflating, at reversals, near the end of the rail, ..."""

    @property
    def features(self) -> Mapping[str, Array]:
        """Name in words -> [M]: inputs and measured states that a flexible model of the residual may look at."""

    @property
    def echoes(self) -> frozenset[str]:
        """Features that hold what the view itself measured: their noise is the residual's."""

    @property
    def own_nuisances(self) -> Mapping[str, float]:
        """What of the view alone is fitted beside every rival, by name -> share of its own value at the box's edge."""

    def own_directions(self) -> NDArray[np.float32]:
        """How the gap changes with each of these, to the edge, [q, M, S]."""

    def start_directions(self) -> NDArray[np.float32] | None:
        """How the gap changes with where a trial starts, [d, M, S]; None: the view begins where it was measured."""

    def gap(self, points: Sequence[Point]) -> NDArray[np.float32]:
        """Measured minus predicted at each point, [P, M, S]; NaN where nothing was measured."""
