"""Result of a diagnosis: the verdict and the evidence that a report shows."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from softarm.diagnosis.engine.view import Array
from softarm.schemas.model import Model
from softarm.schemas.verdict import Interval, Verdict
from softarm.simulator.effects import Effect

HeldOut = Literal["kind", "trial", "block"]  # unit of held-out data: kind of excitation, trial, or block


@dataclass(frozen=True, slots=True)
class Overlay:
    """Measured and simulated signal of one channel in one trial, each stage driven by its measured inputs."""

    stage: str
    trial: str
    kind: str
    channel: str
    unit: str
    t_s: Array  # [N]
    measured: Array  # [N], NaN in gaps
    nominal: Array  # [N]
    patched: Array | None  # [N]; None without named effects
    calibrated: Array | None = None  # [N], with the named effects and the calibration; None without calibration


@dataclass(frozen=True, slots=True)
class Spectrum:
    """One-sided amplitude density of a stage's residual over all trials and channels."""

    stage: str
    unit: str  # of the signal; densities are unit / sqrt(Hz)
    frequency_hz: Array
    nominal: Array
    patched: Array | None
    floor: float  # density of the floor


@dataclass(frozen=True, slots=True)
class Regime:
    """RMS gap in one part of the data."""

    stage: str
    name: str
    samples: int
    nominal_rms: float
    patched_rms: float | None
    unit: str


@dataclass(frozen=True, slots=True)
class Rival:
    """Effect that was tried as the cause."""

    name: str
    alone: float  # share of the stage's gap that it removes alone, held out
    conditional: Interval  # gain next to the named effects, or next to the other named effects
    parameters: Mapping[str, float]  # 'stage.effect.parameter' -> fitted value
    note: str = ""  # 'named', 'not separable from arm.tilt', 'at its bound', ...


@dataclass(frozen=True, slots=True)
class Unexplained:
    """Explainable gap of a stage that the named effects leave."""

    stage: str
    explained_share: float  # share of the explainable gap that the named effects explain
    depends_on: tuple[tuple[str, float], ...]  # feature -> importance, the largest first


@dataclass(frozen=True, slots=True)
class Film:
    """Moving drawing of a mechanism in some seconds of a trial."""

    trial: str
    t_s: Array  # [F]
    # Measured, nominal and, with named effects, patched -> corners of outlines, [F, L, C, 2], m right and up.
    lines: Mapping[str, Array]
    factor: float  # by which deviations from the measured motion are enlarged


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """The verdict and its evidence."""

    verdict: Verdict
    nominal: Model | None = None  # None for a rig
    patched: Model | None = None  # the nominal model with the named effects; None without named effects
    trials: tuple[tuple[str, str, float], ...] = ()  # name, kind, seconds
    overlays: tuple[Overlay, ...] = ()
    spectra: tuple[Spectrum, ...] = ()
    regimes: tuple[Regime, ...] = ()
    rivals: tuple[Rival, ...] = ()
    unexplained: tuple[Unexplained, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)  # 'stage.effect.parameter' of a rig -> unit
    seconds: float = 0.0
    # Stage -> share of its RMS that all named effects remove.
    total_shrink: Mapping[str, Interval] = field(default_factory=dict)
    held_out: HeldOut | None = None  # None if unknown
    # Stage of a rig whose noise floor is what its model leaves -> that floor in multiples of the noise of its signals.
    noise: Mapping[str, float] = field(default_factory=dict)
    margins: Mapping[str, float] = field(default_factory=dict)  # of effects that may have a confidence
    vocabulary: Mapping[str, Effect] = field(default_factory=dict)  # effects of a rig; the robot's are in the registry
    calibrated: Model | None = None  # the patched model with the calibration; None without either
    film: Film | None = None  # of a MuJoCo model
