"""Base class of all rigs' views."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Self

import numpy as np
from numpy.typing import NDArray

from softarm.common.quantity import Quantity
from softarm.diagnosis.data.trials import TableStage, Trial, TrialError
from softarm.diagnosis.engine.thresholds import RIG
from softarm.diagnosis.engine.view import Array, Point, View
from softarm.diagnosis.engine.whitened import BLOCK_S
from softarm.diagnosis.rigs.owner_units import owners
from softarm.schemas.verdict import Interval
from softarm.simulator.effects import Effect, Parameter

# Prefixes of features that hold nothing of the view's own measured channels.
INPUTS = ("command", "base", "force", "torque", "current", "time since reversal")
# Share of a signal's RMS below which a residual counts as noise.
FLOOR_SHARE = 1e-3


def common_column(trials: Sequence[Trial], channel: str, names: Iterable[str]) -> str:
    """Return the first of these columns that a channel has in every trial; raise TrialError if there is none."""
    for name in names:
        if all(name in trial.channel(channel).columns for trial in trials):
            return name
    raise TrialError(
        f"{trials[0].source}: the {channel} channel needs a column {' or '.join(names)} in every trial; add it"
    )


def neutral_values(effects: Sequence[Effect]) -> dict[str, float]:
    """Return the neutral value of every parameter, by 'effect.parameter'."""
    return {f"{e.name.rpartition('.')[2]}.{p.name}": p.neutral for e in effects for p in e.parameters}


def given_values(about: TableStage, effects: Sequence[Effect]) -> dict[str, float]:
    """Return the parameters that a stage.yaml gives under `effects`, in standard units, by 'effect.parameter'.

    Raises TrialError for an effect or a parameter that the stage does not have, or a value without a physical meaning.
    """
    known = {e.name.rpartition(".")[2]: {p.name: p for p in e.parameters} for e in effects}
    units, found = owners(about), {}
    for name, values in about.effects.items():
        if name not in known:
            raise TrialError(
                f"effects: {about.name}.{name}: unknown, or no effect that these recordings can show; allowed "
                f"{', '.join(known)}; correct or remove it"
            )
        for parameter, value in values.items():
            if parameter not in known[name]:
                raise TrialError(
                    f"effects: {about.name}.{name}.{parameter}: unknown parameter; allowed {', '.join(known[name])}; "
                    "correct it"
                )
            own = known[name][parameter]
            unit, number = units.get(own.unit, (own.unit, 1.0))
            if not (permitted := _permitted(own, unit)).admits(value):
                raise TrialError(f"effects: {about.name}.{name}.{parameter}: {permitted.complaint(value)}; correct it")
            found[f"{name}.{parameter}"] = value / number
    return found


def _permitted(parameter: Parameter, unit: str) -> Quantity:
    """Return the values with a physical meaning; bounds from recordings would refuse a valid patch on others."""
    if parameter.name.startswith("scale") and -1 < parameter.low < 0:
        return Quantity(unit=unit, low=-1.0, above=True)
    # A ceiling, whose neutral value is its highest, may have either sign.
    if parameter.low < 0 or parameter.neutral == parameter.high:
        return Quantity(unit=unit)
    return Quantity(unit=unit, low=0.0, above=parameter.low > 0)


class RigView(View):
    """View of one stage of a rig.

    Attributes:
        block_s: length of a stretch of data that counts as independent of its neighbours, s.
        fits_starts: whether the start of every window is fitted at every point.
        restarts_few_effects: whether models with few effects are also fitted from their own starting values
            (`Thresholds`). Measured to pay for chains only; other kinds were not measured.
        blocks_each: blocks of a stretch that a long recording is cut into to keep the budget.
        far_starts: effect with one parameter -> values far from nominal at which a fit of all effects may begin.
        gap_starts: effect -> initial values of its parameters that the nominal model's gap suggests.
        shared: effects that change other stages too, so that a best fit of one stage has none of them.
        whole: effects of the whole mechanism; all stages that load the same part have them in one size.
        together: effects of the whole that a stage alone does not determine, so that its search has none of them.
        only_together: parameters of its other effects that it does not determine either: 'effect.parameter'.
        corrects: effects that would only correct the law of a held effect: nuisances, but no candidates.
        held: parameters of effects of the whole mechanism that `hold` put into the nominal model, with their intervals.
        original: the same parameters in the model before.
        curved: tolerated parameters whose effect is far from linear: 'effect.parameter' -> evenly spaced values. The
            value that leaves the smallest gap becomes that of the nominal model.
        laws: laws that the nominal model may have, the usual ones first: 'effect.parameter' -> value. Others are used
            if they leave a much smaller gap.
        driven_by: stages whose measured motion loads this stage.
        assumptions: warnings about the description, which hold before any fit.
        ignored: energy of a gap that needs no effect, in noise floors squared.
        step_cost_s: processor time of a search per planned rollout and integration step, s; measured once.
    """

    block_s = BLOCK_S
    fits_starts = False
    restarts_few_effects = False
    blocks_each = 4
    ignored = RIG.gain.ignored
    step_cost_s = 0.07e-6
    far_starts: Mapping[str, tuple[float, ...]] = {}
    gap_starts: Mapping[str, tuple[float, ...]] = {}
    shared: frozenset[str] = frozenset()
    whole: frozenset[str] = frozenset()
    together: tuple[Effect, ...] = ()
    only_together: frozenset[str] = frozenset()
    corrects: frozenset[str] = frozenset()
    curved: Mapping[str, Array] = {}
    laws: Sequence[Mapping[str, float]] = ()
    driven_by: frozenset[str] = frozenset()
    assumptions: tuple[str, ...] = ()
    features: Mapping[str, Array] = {}
    _each = 1  # integration steps per sample
    _known: dict[str, float]

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
        """Join the samples of all trials: stamps [T], values [T, S] of the channels, and features [T] by name.

        step: resolution of the encoder, in `unit`; 0 if it has none.
        """
        self.stage, self.unit, self.channels, self.effects = stage, unit, channels, tuple(effects)
        self.original: dict[str, float] = {}
        self.held: dict[str, Interval] = {}
        self.t_s: Array = np.concatenate(t_s)
        self.trial: NDArray[np.int64] = np.repeat(np.arange(len(t_s)), [len(t) for t in t_s])
        self.measured: Array = np.concatenate(measured)
        middle = np.nanmean(self.measured, axis=0)
        if self.fits_starts:  # a link that turns over and over moves by many turns, and its swing is one of them
            middle = np.stack([np.nanmean(x, axis=0) for x in measured])[self.trial]
        swing = np.sqrt(np.nanmean((self.measured - middle) ** 2, axis=0))
        self.floor: Array = np.maximum(FLOOR_SHARE * swing, max(step, 1e-9))
        self.noise: Array = np.zeros(len(channels))
        local = [(e.name.rpartition(".")[2], n.name) for e in self.vocabulary for n in e.parameters]
        self.acts = frozenset(f"{owner}.{e}.{n}" for e, n in local for owner in self._owners(e))
        self.features = {name: np.concatenate([s[name] for s in signals]) for name in signals[0]}

    @classmethod
    def windows(cls, trial: Trial) -> tuple[Trial, ...]:
        """Cut a trial into the windows that the view is made of; the start of each window is fitted."""
        return (trial,)

    @property
    def vocabulary(self) -> tuple[Effect, ...]:
        """All effects that the stage alone or stages together can show."""
        return (*self.effects, *self.together)

    @property
    def growing(self) -> frozenset[int]:
        """Windows in which small errors grow too much; they are halved."""
        return frozenset()

    def halves(self, number: int, times: int) -> tuple[Trial, ...]:
        """Return a window cut into halves; times: how often its trial's windows were halved, with this one."""
        raise NotImplementedError

    def uninterrupted(self) -> Self:
        """Return the view of the same samples with windows as long as the mechanism allows; by default itself."""
        return self

    @property
    def rollout_s(self) -> float:
        """Processor time that a search takes per planned rollout, s, on the computer of `step_cost_s`."""
        return self.step_cost_s * self._each * len(self.t_s)

    def warnings(self, point: Point) -> tuple[str, ...]:
        """Return warnings about the data, for the reader of the verdict with the effects of a point."""
        return ()

    @property
    def regimes(self) -> Mapping[str, NDArray[np.bool_]]:
        """Parts of the data by name, [M] masks."""
        return {}

    def nominal(self, path: str) -> float:
        """Return a parameter of the nominal model; `path` is 'effect.parameter'."""
        return self._known[path]

    def value(self, point: Point, path: str, absent: float = 0.0) -> float:
        """Return 'effect.parameter' at a point, or `absent` if the recordings cannot show its effect."""
        for owner in self._owners(path.partition(".")[0]):
            if (found := point.get(f"{owner}.{path}")) is not None:
                return found
        return self._known.get(path, absent)

    def _owners(self, effect: str) -> tuple[str, ...]:
        return (self.stage, self.part(effect)) if effect in self.whole else (self.stage,)

    def part(self, effect: str) -> str:
        """Return the part of the mechanism that has an effect of the whole."""
        raise NotImplementedError

    @property
    def indistinguishable(self) -> Mapping[str, tuple[str, ...]]:
        """Effect -> effects that no recording of such a stage can separate from it: one is fitted, all are named.

        Of a dead time and a latency, only the sum shows.
        """
        pair = f"{self.stage}.dead_time", f"{self.stage}.latency"
        return {pair[0]: pair[1:]} if {effect.name for effect in self.effects} >= set(pair) else {}

    def assume(self, path: str, value: float) -> None:
        """Set 'effect.parameter' of the nominal model."""
        self._known[path] = value

    def assume_all(self, values: Mapping[str, float]) -> None:
        """Set values of the nominal model: 'effect.parameter' -> value."""
        for path, value in values.items():
            self.assume(path, value)

    def measure_noise(self) -> None:
        """Measure noise floor and usable samples again, next to another law of the nominal model."""

    def adopt(self, assumed: Mapping[str, float]) -> Self:
        """Assume the settled values of another view of the stage, measure the noise next to these, and return self."""
        self.assume_all(assumed)
        self.measure_noise()
        return self

    @property
    def assumed(self) -> Mapping[str, float]:
        """Return the values that `assume` may have set: 'effect.parameter' -> value."""
        return {path: self.nominal(path) for path in (*(self.laws[0] if self.laws else ()), *self.curved)}

    def hold(self, effect: str, sizes: Mapping[str, Interval]) -> None:
        """Put an effect into the nominal model; no fit moves it beyond the intervals of its parameters.

        Without sizes the effect stays as the model has it.
        """
        for name, size in sizes.items():
            path = f"{effect}.{name}"
            self.original[f"{self.stage}.{path}"] = self._known[path]
            self.held[f"{self.stage}.{path}"] = size
            self._known[path] = size.value
        self.effects, self.together = (
            tuple(each for each in effects if each.name != f"{self.stage}.{effect}")
            for effects in (self.effects, self.together)
        )

    @property
    def tolerances(self) -> Mapping[str, float]:
        """Errors that a good nominal model may have: 'effect.parameter' -> half-width, instead of the usual ones."""
        return {}

    def unresolved(self, point: Point) -> Mapping[str, float]:
        """Return half-widths of the ranges in which parameters change no sample: 'effect.parameter' -> half-width."""
        return {}

    @property
    def model_uncertainty(self) -> Mapping[str, float]:
        """Uncertainty from the form of the law itself: 'effect.parameter' -> half-width to add to its interval."""
        return {}

    @property
    def echoes(self) -> frozenset[str]:
        """Features that contain the view's own measured channels, so their noise is in the residual too."""
        return frozenset(name for name in self.features if not name.startswith(INPUTS))

    @property
    def own_nuisances(self) -> Mapping[str, float]:
        """Nuisances of this view alone: name -> share of its own value at the edge of its box."""
        return {}

    def gap(self, points: Sequence[Point]) -> NDArray[np.float32]:
        """Return measured minus predicted values at each of P points, [P, M, S]; NaN where no sample was measured."""
        return np.stack([self._gap(point) for point in points]).astype(np.float32)

    def _gap(self, point: Point) -> Array:
        """Return measured minus predicted values at a point, [M, S]."""
        raise NotImplementedError
