"""What the views of all rigs share: samples of several trials one after the other, points as columns."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.data.trials import Trial
from softarm.diagnosis.engine.view import Array, Point
from softarm.diagnosis.engine.whitened import BLOCK_S
from softarm.diagnosis.rigs.vocabulary import Effect

# How features are called that hold nothing of what the view itself measured.
INPUTS = ("command", "base", "force", "torque", "current", "time since reversal")
FLOOR_SHARE = 1e-3  # of the signal: no simulator is blamed for a thousandth


class RigView:
    """One stage of a rig; satisfies `softarm.diagnosis.engine.view.View`."""

    block_s = BLOCK_S  # a stretch that says something new
    fits_starts = False  # at every point anew: then a part of a trial is no stranger to the rest of it
    # Few effects are fitted from their own starts too (`Thresholds.anew`). Of an arm a payload that came down from all
    # effects at once was seen to stay in a poor well; whether other kinds would win by it nobody has measured.
    own_wells = False

    def __init__(
        self,
        stage: str,
        unit: str,
        channels: tuple[str, ...],
        effects: Sequence[Effect],
        t_s: Sequence[Array],
        measured: Sequence[Array],
        step: float,
        signals: Sequence[Mapping[str, Array]],
    ) -> None:
        """Lists are by trial; measured [T, S]; step: an encoder's; signals: name -> [T]."""
        self.stage, self.unit, self.channels, self.effects = stage, unit, channels, tuple(effects)
        self.t_s: Array = np.concatenate(t_s)
        self.trial: NDArray[np.int64] = np.repeat(np.arange(len(t_s)), [len(t) for t in t_s])
        self.measured: Array = np.concatenate(measured)
        swing = np.sqrt(np.nanmean((self.measured - np.nanmean(self.measured, axis=0)) ** 2, axis=0))
        self.floor: Array = np.maximum(FLOOR_SHARE * swing, max(step, 1e-9))
        self.noise: Array = np.zeros(len(channels))
        self.acts = frozenset(f"{e.name}.{n.name}" for e in self.effects for n in e.parameters)
        self.features: Mapping[str, Array] = {name: np.concatenate([s[name] for s in signals]) for name in signals[0]}

    @classmethod
    def shots(cls, trial: Trial) -> tuple[Trial, ...]:
        """What a trial is cut into before the view is made of it: a start is fitted to each part."""
        return (trial,)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the view has seen in the data that a reader of the verdict has to know."""
        return ()

    @property
    def regimes(self) -> Mapping[str, NDArray[np.bool_]]:
        """See View."""
        return {}

    def nominal(self, path: str) -> float:
        """A parameter of the nominal model."""
        raise NotImplementedError

    def values(self, points: Sequence[Point], path: str) -> Array:
        """A parameter at each point, [P]."""
        name = f"{self.stage}.{path}"
        return np.array([point.get(name, self.nominal(path)) for point in points], dtype=float)

    @property
    def twins(self) -> Mapping[str, tuple[str, ...]]:
        """Effect -> effects that no recording of such a stage can tell from it: one is fitted, all are named."""
        return {}

    @property
    def tolerances(self) -> Mapping[str, float]:
        """'effect.parameter' -> what a well-kept model may be off by here, where the usual half-widths do not fit."""
        return {}

    def known_to(self, point: Point) -> Mapping[str, float]:
        """'effect.parameter' -> by how much, either way, it could differ at a point without any sample telling."""
        return {}

    @property
    def forms(self) -> Mapping[str, float]:
        """'effect.parameter' -> by how much, either way, another law of the same kind would have it, besides."""
        return {}

    @property
    def echoes(self) -> frozenset[str]:
        """See View."""
        return frozenset(name for name in self.features if not name.startswith(INPUTS))

    @property
    def own_nuisances(self) -> Mapping[str, float]:
        """See View."""
        return {}

    def own_directions(self) -> NDArray[np.float32]:
        """See View."""
        return np.empty((0, *self.measured.shape), np.float32)

    def start_directions(self) -> NDArray[np.float32] | None:
        """See View."""
        return None

    def gap(self, points: Sequence[Point]) -> NDArray[np.float32]:
        """See View."""
        return np.stack([self._gap(points, i) for i in range(len(points))]).astype(np.float32)

    def _gap(self, points: Sequence[Point], i: int) -> Array:
        """[M, S] at one point."""
        raise NotImplementedError
