"""From trials of the robot and a nominal model to a verdict with its evidence."""

import time
from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.data.trials import Trial, TrialError
from softarm.diagnosis.engine.candidates import point_of
from softarm.diagnosis.engine.confidence import confidence, margins
from softarm.diagnosis.engine.decision import Decision, stage_of, stage_shares
from softarm.diagnosis.engine.examination import Examination
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.engine.result import Diagnosis
from softarm.diagnosis.engine.search import Choice, Progress, Search, SelectedEffect
from softarm.diagnosis.engine.shrink import chain_interval, interval, widened
from softarm.diagnosis.engine.structure import Structure
from softarm.diagnosis.engine.thresholds import ROBOT
from softarm.diagnosis.engine.view import Array, Point
from softarm.diagnosis.engine.whitened import BLOCK_S, Key, WhitenedResidual, blocks_of
from softarm.diagnosis.robot import evidence, experiments
from softarm.diagnosis.robot.candidates import candidates, nuisances
from softarm.diagnosis.robot.chain import astray, tip_gap
from softarm.diagnosis.robot.counts import Count, counts
from softarm.diagnosis.robot.drive import SERVO, driven
from softarm.diagnosis.robot.floors import chain_floor, drift, rms, stage_floors
from softarm.diagnosis.robot.markers import loose_marker
from softarm.diagnosis.robot.trial_grid import TrialGrid, on_grid
from softarm.diagnosis.robot.views import robot_views
from softarm.schemas.model import Model
from softarm.schemas.verdict import (
    Estimate,
    Gap,
    Interval,
    NamedEffect,
    NextExperiment,
    Quantity,
    Shrink,
    Verdict,
    Where,
)
from softarm.simulator.effects import REGISTRY, STAGES, find

OWN_STAGE_MIN = 0.1  # energy


class Robot:
    """One diagnosis, step by step. Raises TrialError where nothing can be compared."""

    def __init__(self, trials: Sequence[Trial], model: Model, tell: Progress) -> None:
        self.started = time.monotonic()
        self.trials, self.nominal, self.tell = tuple(trials), model, tell
        tell("bringing trials to one grid", 0.02)
        self.grid: TrialGrid = on_grid(trials, model)
        self.model = model = driven(self.grid, model, [trial.kind for trial in trials])
        self.views = robot_views(self.grid, model)
        if not self.views:
            raise TrialError(f"{trials[0].source}: no stage can be compared; record pressure, rail or mocap as well")
        self.stages = tuple(view.stage for view in self.views)
        tell("simulating each stage alone", 0.08)
        self.setup = Setup(self.views, nuisances(model), [trial.kind for trial in trials])
        self._flown: dict[Key, NDArray[np.float32]] = {}

    def diagnosis(self) -> Diagnosis:
        """Everything."""
        known, kinds = candidates(self.model), [trial.kind for trial in self.trials]
        found = Examination(self.setup, known, kinds, ROBOT, lambda what, share: self.tell(what, 0.12 + 0.63 * share))
        search, choice, self.plain = found.search, found.choice, found.plain
        self.tell("what any model could explain", 0.75)
        flexible, decision = found.flexible, self._decided(found)
        counted = counts(self.trials, self.model)
        named = [c for c in counted if c.named]
        patched = _patched(self.model, decision, choice, named) if decision.selected or named else None
        self.tell("how far the gap shrinks", 0.85)
        point = _point(decision, choice)
        verdict = self._verdict(search, choice, decision, counted, flexible, point)
        self.tell("gathering the evidence", 0.95)
        pairs = evidence.gaps(self.setup, {}, point or None)
        explained = dict.fromkeys(self.stages, decision.explained)
        return Diagnosis(
            verdict=verdict,
            nominal=self.nominal,
            patched=patched,
            trials=tuple((t.name, t.kind, t.duration_s) for t in self.trials),
            overlays=evidence.overlays(self.views, pairs, self.trials),
            spectra=evidence.spectra(self.views, pairs),
            regimes=evidence.regime_rows(self.views, pairs),
            rivals=evidence.rivals(search, choice, decision.selected),
            leftovers=evidence.leftovers(flexible, explained),
            nuisances=self.setup.fitted_nuisances(choice.chosen),
            seconds=time.monotonic() - self.started,
            together=self._together(choice, point) if point else {},
            held_out=self.setup.unseen,
            margins=margins(decision.selected),
        )

    def _decided(self, found: Examination) -> Decision:
        """What it amounts to; `none` only where every stage and the chain are within what counts as none."""
        signs: dict[str, Structure] = {}
        if "rail" in self.stages:
            view = self.views[self.stages.index("rail")]
            drifts = drift(view, found.null_left["rail"], found.left["rail"], ROBOT.structure_share)
            signs |= {"rail": drifts} if drifts else {}
        if (loose := loose_marker(self.trials, self.grid.links)) is not None:
            where = f"the markers of link {loose.link} move {1e3 * loose.rms_m:.1f} mm against it"
            signs["mocap"] = Structure(loose.energy, where, 1, 1)
        decision = found.decided(signs)
        # Beside what fell, or was never found, only nuisances are taken away.
        self.beside = found.choice.chosen if decision.selected else found.choice.null_model
        self.floors = stage_floors(self.setup, self.plain, self.beside)
        return decision if decision.kind != "none" else found.decided(signs | self._above())

    def _above(self) -> dict[str, Structure]:
        """Stages, and the chain by the stage in which it arises, that stand above what counts as none."""
        found: dict[str, Structure] = {}
        for view, gaps in zip(self.views, self.setup.gaps, strict=True):
            ratio = rms(gaps.fetch([{}])[()]) / self.floors[view.stage]
            if ratio > 1:
                found[view.stage] = Structure(ratio**2, f"{ratio:.2g} times its floor", 1, 1)
        tip = self._tips([{}])[0]
        if not found and np.isfinite(tip).any():
            ratio = np.sqrt(2) * rms(tip) / self._chain_floor
            if ratio > 1:
                stage = astray(self.grid, self.model)
                found[stage] = Structure(ratio**2, f"at the tip {ratio:.2g} times the chain's floor", 1, 1)
        return found

    @cached_property
    def _chain_floor(self) -> float:
        """What counts as none at the tip beside the decided effects, m."""
        tip = self._tips([self.beside.point])[0]
        return chain_floor(self.grid, self.model, self.setup, self.beside, tip)

    def _verdict(
        self,
        search: Search,
        choice: Choice,
        decision: Decision,
        counted: Sequence[Count],
        flexible: Mapping[str, tuple[float, Mapping[str, float]]],
        point: Point,
    ) -> Verdict:
        named = [c for c in counted if c.named]
        energies: dict[str, float] = {}
        for c in named:
            energies[c.stage] = energies.get(c.stage, 0.0) + (c.before / c.floor) ** 2
        shares = stage_shares(decision, energies)
        kind = decision.kind
        if named:
            kind = "named" if kind in ("none", "named") else "incomplete"
        stage = None if kind == "none" else stage_of(shares, STAGES)
        bounds = search.problem.interval(choice.chosen)
        selected = [self._named_effect(choice, bounds, m, point) for m in decision.selected]
        effects = sorted(
            (*selected, *(_count_effect(c) for c in named)),
            key=lambda e: -shares.get(e.name.partition(".")[0], 0.0),
        )
        return Verdict(
            verdict=kind,
            where=Where(stage=stage, share=shares, regime=self._regime(stage) if stage else "nowhere"),
            effects=tuple(effects),
            gap=self._gap(choice, flexible, point, counted),
            next_experiment=self._next(choice, decision),
            warnings=self._warnings(choice, decision),
        )

    def _regime(self, stage: str | None) -> str:
        for view, gaps in zip(self.views, self.setup.gaps, strict=True):
            if view.stage == stage:
                return evidence.where_in_words(view, gaps.fetch([{}])[()])
        return "throughout"

    def _named_effect(
        self, choice: Choice, bounds: tuple[Array, Array], effect: SelectedEffect, point: Point
    ) -> NamedEffect:
        """One named effect: parameters with intervals, confidence, held-out shrink beside the others.

        bounds: low and high of all chosen parameters.
        """
        fit = choice.chosen
        i = fit.names.index(effect.candidate.name)
        at = sum(len(c.parameters) for c in fit.effects[:i])
        parameters = {}
        for j, parameter in enumerate(effect.candidate.parameters):
            value, ends = (
                parameter.value(fit.u[i][j]),
                (parameter.value(bounds[0][at + j]), parameter.value(bounds[1][at + j])),
            )
            if np.isfinite(value):
                bounded = [x if np.isfinite(x) else find(parameter.path)[1].high for x in (value, *ends)]
                name = parameter.path.rpartition(".")[2]
                parameters[name] = Estimate(value=value, low=min(bounded), high=max(bounded), unit=parameter.unit)
        return NamedEffect(
            name=effect.candidate.name,
            parameters=parameters,
            confidence=confidence("robot", effect),
            equivalents=effect.equivalents,
            shrink=self._shrink(choice, effect, point),
        )

    def _shrink(self, choice: Choice, effect: SelectedEffect, point: Point) -> Shrink:
        """Of the effect's stage (where its simulation shows most) and of the tip, beside the other named effects.

        Every trial is judged by parameters that were fitted without its kind of excitation.
        """
        own = {d.path for d in effect.candidate.parameters} | set(effect.candidate.form)
        chosen = choice.chosen
        stage = _shows(effect)
        residual = self.plain.whitened[self.stages.index(stage)]
        before, after = (
            self._squares(residual, effect.without.fold_points),
            self._squares(residual, chosen.fold_points),
        )
        value, low, high = interval(before, after)
        points = _points(choice, point)
        without = [{k: v for k, v in each.items() if k not in own} for each in points]
        tips = [self._held_out(found) for found in np.split(self._tips([*without, *points]), 2)]
        squares = [_by_trial(t, self.grid.sample[1], len(self.trials)) for t in tips]
        chain = chain_interval(*squares) if np.isfinite(tips).any() else None
        return Shrink(stage=_interval(value, low, high), chain=None if chain is None else _interval(*chain))

    def _squares(self, residual: WhitenedResidual, fold_points: Sequence[Point]) -> Array:
        """Squares of a stage's residual by trial [K], floors as units, each trial at its own fold's point."""
        moments = residual.moments(list(fold_points))
        folds = list(np.unique(self.plain.fold))
        squares = np.zeros(len(self.trials))
        for (trial, number), fold in zip(self.plain.blocks, self.plain.fold, strict=True):
            for name, part in residual.blocks:
                if name == (trial, number):
                    rows = moments[folds.index(fold)].rows[part]
                    squares[trial] += float(rows @ rows)
        return squares

    def _tips(self, points: Sequence[Point]) -> NDArray[np.float32]:
        """Gaps of the tip at each point, [P, M, 2]; every point is flown once."""
        keys = [tuple(sorted(point.items())) for point in points]
        if missing := [key for key in dict.fromkeys(keys) if key not in self._flown]:
            self._flown |= zip(missing, tip_gap(self.grid, self.model, [dict(key) for key in missing]), strict=True)
        return np.stack([self._flown[key] for key in keys])

    def _held_out(self, gaps: NDArray[np.float32]) -> NDArray[np.float32]:
        """Of gaps by fold [F, M, S] every sample's own: from parameters that were fitted without it, [M, S]."""
        fold = dict(zip(self.plain.blocks, np.unique(self.plain.fold, return_inverse=True)[1], strict=True))
        own = np.zeros(gaps.shape[1], dtype=np.int64)
        for name, a, b in blocks_of(self.views[0], BLOCK_S):
            own[a:b] = fold[name]
        return np.asarray(gaps[own, np.arange(len(own))])

    def _gap(
        self,
        choice: Choice,
        flexible: Mapping[str, tuple[float, Mapping[str, float]]],
        point: Point,
        counted: Sequence[Count],
    ) -> Gap:
        before, after, floor, ceiling = {}, {}, {}, {}
        points = _points(choice, point)
        for view, gaps in zip(self.views, self.setup.gaps, strict=True):
            found = gaps.fetch([{}, *points])
            patched = self._held_out(np.stack([found[gaps.key(p)] for p in points]))
            share = flexible.get(view.stage, (0.0, {}))[0]
            before[view.stage] = Quantity(value=rms(found[()]), unit=view.unit)
            after[view.stage] = Quantity(value=rms(patched), unit=view.unit)
            floor[view.stage] = Quantity(value=self.floors[view.stage], unit=view.unit)
            ceiling[view.stage] = Quantity(value=rms(patched) * float(np.sqrt(1 - share)), unit=view.unit)
        for c in sorted(counted, key=lambda c: not c.named):
            if c.stage not in before and (c.named or c.stage in ("clock", "observation")):
                rest = c.after if c.named else c.before
                before[c.stage], floor[c.stage] = (
                    Quantity(value=round(x, 9), unit=c.unit) for x in (c.before, c.floor)
                )
                after[c.stage] = ceiling[c.stage] = Quantity(value=round(rest, 9), unit=c.unit)
        tips = self._tips([{}, *points])
        if np.isfinite(tips).any():
            both = np.sqrt(2) * rms(tips[0]), np.sqrt(2) * rms(self._held_out(tips[1:]))
            before["chain"], after["chain"] = (Quantity(value=x, unit="m") for x in both)
            floor["chain"] = Quantity(value=self._chain_floor, unit="m")
        return Gap(before=before, after=after, floor=floor, ceiling=ceiling)

    def _together(self, choice: Choice, point: Point) -> dict[str, Interval]:
        """Stage -> share of the RMS in `_gap` that goes with all named effects; trials drawn anew."""
        points = _points(choice, point)
        pairs = {}
        for view, gaps in zip(self.views, self.setup.gaps, strict=True):
            found = gaps.fetch([{}, *points])
            pairs[view.stage] = view.trial, found[()], self._held_out(np.stack([found[gaps.key(p)] for p in points]))
        tips = self._tips([{}, *points])
        if np.isfinite(tips).any():
            pairs["chain"] = self.grid.sample[1], tips[0], self._held_out(tips[1:])
        return {
            stage: _interval(*law(*(_by_trial(gap, trial, len(self.trials)) for gap in both)))
            for stage, (trial, *both) in pairs.items()
            for law in (chain_interval if stage == "chain" else interval,)
        }

    def _next(self, choice: Choice, decision: Decision) -> NextExperiment | None:
        """A flight that splits a set; else that nothing does; else, where something is left, the worst one again."""
        asked = None
        for effect in decision.selected:
            close = [(f, g) for f, g in effect.rivals if f.effects[-1].name in effect.equivalents]
            if close:
                explanations = {effect.candidate.name: choice.chosen.point} | {
                    f.effects[-1].name: f.point for f, _ in close[:3]
                }
                found = experiments.splitting(
                    self.model, explanations, self.plain, [trial.kind for trial in self.trials]
                )
                if found is not None and found.expect:
                    return found
                asked = asked or found
        if asked is not None:
            return asked
        if decision.kind in ("unknown", "incomplete"):
            view, residual = max(
                zip(self.views, self.plain.whitened, strict=True), key=lambda p: choice.energies[1][p[0].stage]
            )
            rows = residual.moments([{}])[0].rows.reshape(len(view.trial), -1)
            worst = max(
                range(len(self.trials)),
                key=lambda k: float((rows[view.trial == k] ** 2).mean()) if (view.trial == k).any() else 0.0,
            )
            return experiments.repeated(self.trials[worst].kind)
        return None

    def _warnings(self, choice: Choice, decision: Decision) -> tuple[str, ...]:
        found = [w for trial in self.trials for w in trial.warnings]
        if self.model is not self.nominal:
            found.append(
                f"the axis is driven by a servo, which the model does not say: compared and patched with {SERVO}"
            )
        for trial in self.trials:
            found += [f"{trial.name}: {text}" for text in trial.not_observable.values()]
        if len({t.kind for t in self.trials}) < 3:
            found.append(
                "fewer than three kinds of excitation: a plain lag fits a chirp, not steps; fly more (softarm excite)"
            )
        found += [f"{stage}: {where}; no effect of the list explains that" for stage, where in decision.odd.items()]
        for effect in choice.selected:
            if effect not in decision.selected:
                found.append(
                    f"{effect.candidate.name} shrinks the gap and leaves more than it explains: it is not named"
                )
        for fit, gain in choice.alone[:3]:
            if fit.at_bound and gain.value > 50:
                found.append(
                    f"{fit.names[0]} would explain part of the gap, at the end of its physical range: not named"
                )
        return tuple(dict.fromkeys(found))


def _shows(effect: SelectedEffect) -> str:
    """The stage that an effect's shrink is of: its own where it shows there, else where it shows most."""
    energies, own = effect.gain.energies, effect.candidate.stage
    return own if energies.get(own, 0.0) > OWN_STAGE_MIN else max(energies, key=lambda s: energies[s])


def _points(choice: Choice, point: Point) -> list[Point]:
    """The named effects' parameters, fitted without each fold."""
    return [{path: each[path] for path in point} for each in choice.chosen.fold_points]


def _by_trial(gap: NDArray[np.float32], trial: NDArray[np.int64], trials: int) -> Array:
    """Squares of each trial, [K]."""
    return np.array([np.nansum(gap[trial == k].astype(float) ** 2) for k in range(trials)])


def _interval(value: float, low: float, high: float) -> Interval:
    return Interval(value=value, low=min(low, value), high=max(high, value))


def _point(decision: Decision, choice: Choice) -> dict[str, float]:
    """The named effects' parameters."""
    named = {m.candidate.name for m in decision.selected}
    pairs = [(c, u) for c, u in zip(choice.chosen.effects, choice.chosen.u, strict=True) if c.name in named]
    return point_of(tuple(c for c, _ in pairs), tuple(u for _, u in pairs))


def _patched(model: Model, decision: Decision, choice: Choice, named: Sequence[Count]) -> Model:
    """The nominal model with the named effects; one that the robot turns out not to have is taken out."""
    effects = {name: dict(values) for name, values in model.effects.items()}
    point = _point(decision, choice)
    for effect in decision.selected:
        name = effect.candidate.name
        values = {p.name: point[f"{name}.{p.name}"] for p in REGISTRY[name].parameters}
        if all(values[p.name] == p.neutral for p in REGISTRY[name].parameters if p.default is None):
            effects.pop(name, None)
        else:
            effects[name] = values
    for count in named:
        if count.parameter:
            effects.setdefault(count.name, {})[count.parameter] = count.value
        elif count.present:
            effects[count.name] = {}
        else:
            effects.pop(count.name, None)
    return model.model_copy(update={"effects": effects})


def _count_effect(count: Count) -> NamedEffect:
    estimate = Estimate(value=count.value, low=count.low, high=count.high, unit=count.unit)
    parameters = {count.parameter: estimate} if count.parameter else {}
    spread = (count.high - count.low) / max(2 * abs(count.value - count.nominal), 1e-12) if count.parameter else 0.1
    stage = _interval(count.shrink, *widened(count.shrink, count.shrink - spread, count.shrink + spread))
    return NamedEffect(name=count.name, parameters=parameters, shrink=Shrink(stage=stage))
