"""What a diagnosis found, whole: the verdict and everything a report shows. Frozen values, nothing computed here."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from softarm.schemas.model import Model
from softarm.schemas.verdict import Interval, Verdict
from softarm.simulator.effects import Effect

Array = NDArray[np.float64]
HeldOut = Literal["kind", "trial", "block"]  # what no fit has seen when it is judged


@dataclass(frozen=True, slots=True)
class Overlay:
    """One channel of one trial: measured, and simulated by the stage alone (its inputs as measured)."""

    stage: str
    trial: str
    kind: str
    channel: str
    unit: str
    t_s: Array  # [N]
    measured: Array  # [N], NaN in gaps
    nominal: Array  # [N]
    patched: Array | None  # [N]; None where nothing was named


@dataclass(frozen=True, slots=True)
class Spectrum:
    """Residuals of a stage by frequency, one-sided amplitude density, all trials and channels pooled."""

    stage: str
    unit: str  # of the signal; densities are unit / sqrt(Hz)
    frequency_hz: Array
    nominal: Array
    patched: Array | None
    floor: float  # density of the floor


@dataclass(frozen=True, slots=True)
class Regime:
    """A part of the data and how large the gap is in it."""

    stage: str
    name: str
    samples: int
    nominal_rms: float
    patched_rms: float | None
    unit: str


@dataclass(frozen=True, slots=True)
class Rival:
    """An effect (or pair) that was tried as the cause."""

    names: tuple[str, ...]
    alone: float  # share of the stage's gap that goes with it alone; held out
    conditional: Interval | None  # what it adds beside the named ones (for a named one: beside the other named ones)
    parameters: Mapping[str, float]  # 'stage.effect.parameter' -> fitted value
    note: str = ""  # 'named', 'cannot be told from arm.tilt', 'at its bound', ...


@dataclass(frozen=True, slots=True)
class Leftover:
    """What the named effects do not explain, per stage."""

    stage: str
    explained_share: float  # of what any model could explain, by the named effects
    depends_on: tuple[tuple[str, float], ...]  # feature -> importance, the largest first


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """The verdict and its evidence."""

    verdict: Verdict
    nominal: Model | None  # None: a single-stage table
    patched: Model | None  # the nominal model with the named effects; None when nothing was named
    trials: tuple[tuple[str, str, float], ...]  # name, kind, seconds
    overlays: tuple[Overlay, ...] = ()
    spectra: tuple[Spectrum, ...] = ()
    regimes: tuple[Regime, ...] = ()
    rivals: tuple[Rival, ...] = ()
    leftovers: tuple[Leftover, ...] = ()
    nuisances: Mapping[str, float] = field(default_factory=dict)  # what was fitted beside every rival, within tolerance
    units: Mapping[str, str] = field(default_factory=dict)  # of another rig's parameters, 'stage.effect.parameter'
    seconds: float = 0.0
    together: Mapping[str, Interval] = field(default_factory=dict)  # stage -> share of its RMS that goes with them all
    held_out: HeldOut | None = None  # None: nobody says
    margins: Mapping[str, float] = field(default_factory=dict)  # of named effects that may have a confidence
    vocabulary: Mapping[str, Effect] = field(default_factory=dict)  # another rig's effects; the robot's: the registry
