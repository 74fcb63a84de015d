"""The examination as a whole: what follows from the named effects follows from them alone."""

from copy import copy
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.signal import lfilter

from softarm.diagnosis.answer.calibration import calibrated
from softarm.diagnosis.engine.candidates import Candidate, Nuisance
from softarm.diagnosis.engine.examination import Examination
from softarm.diagnosis.engine.fitted import FittedChoice
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.engine.thresholds import RIG, ROBOT
from tests.diagnosis.engine.gauge import Linear, candidate

RATE_HZ, LENGTH_S, NOISE = 50.0, 6.0, 0.02
SWING, LEVEL, BIAS = "stage.swing.size", "stage.level.height", "stage.zero.bias"
STOP, TWIN = "stage.stop.depth", "stage.twin.size"
TRUTH = {SWING: 0.8, LEVEL: 0.2}
KINDS = ("slow", "fast", "both")


def _candidate(path, *starts):
    return candidate(path, -2.0, 2.0, 0.3, *starts)


KNOWN = (_candidate(SWING, 0.3, -0.3), _candidate(LEVEL, 0.3, -0.3))
SWUNG, LEVELLED, STOPPED, TWINNED = (_candidate(path, 0.3) for path in (SWING, LEVEL, STOP, TWIN))


def _fitted(problem, *sized):
    """Return a fit of effects, each with its first sizes."""
    effects, sizes = zip(*sized, strict=True)
    return problem.fit([(effects, sizes)], rounds=1)[0]


@dataclass
class _View(Linear):
    """A reading with a swing, a level that is missing in a third of the data, and a zero that the model has."""

    acts = frozenset({SWING, LEVEL, BIAS, STOP, TWIN})

    def __post_init__(self):
        t = self._stamp(3, RATE_HZ, LENGTH_S)
        self.swing = np.concatenate((np.sin(2 * t), np.sin(5 * t), np.sin(2 * t) + np.sin(5 * t)))
        level = np.tile(t > LENGTH_S / 3, 3).astype(float)
        self.features = {"swing": self.swing, "level": level}
        self.signals = {SWING: self.swing, TWIN: self.swing + 1e-3 * np.cos(self.t_s), LEVEL: level, BIAS: 1.0}
        self._measure(TRUTH, NOISE)

    def _predict(self, point):
        return np.maximum(super()._predict(point), point.get(STOP, 0.0) - 9.0)  # a stop that no sample reaches


@pytest.fixture(scope="module", params=[ROBOT, RIG], ids=["robot", "rig"])
def examined(request):
    setup = Setup([_View()], (Nuisance(BIAS, 0.0, -0.5, 0.5),), KINDS)
    found = Examination(setup, KNOWN, request.param, lambda what, share: None)
    found.decide()
    return found


@pytest.fixture
def found(examined):
    """Return a copy, whose choice a test may change."""
    return copy(examined)


def _without_level(found):
    """The decision if the level, which was fitted, is not named."""
    decision = found.decide()
    assert {effect.candidate.name for effect in decision.selected} == {"stage.swing", "stage.level"}
    kept = tuple(effect for effect in decision.selected if effect.candidate.name == "stage.swing")
    return replace(decision, kind="incomplete", selected=kept)


@dataclass
class _Healthy(_View):
    """A reading with slow noise of ten noise floors, or with a law that is not in the list."""

    law: float = 0.0

    def __post_init__(self):
        super().__post_init__()
        white = 10 * NOISE * np.random.default_rng(3).normal(size=len(self.t_s))
        self.slow_noise = lfilter([0.2], [1.0, -0.98], white)
        residual = self.law * self.swing**2 if self.law else self.slow_noise
        self.measured = (residual + NOISE * np.random.default_rng(0).normal(size=len(self.t_s)))[:, None]


@pytest.mark.parametrize(("law", "kind"), [(0.0, "none"), (0.2, "unknown")])
def test_only_a_residual_that_a_flexible_model_explains_is_unknown(law, kind):
    setup = Setup([_Healthy(law)], (Nuisance(BIAS, 0.0, -0.02, 0.02),), KINDS)
    found = Examination(setup, (STOPPED,), RIG, lambda what, share: None)
    assert found.choice.energies[1]["stage"] > 20.0
    decision = found.decide()
    assert (decision.kind, decision.noise) == (kind, kind == "none")


def test_a_choice_has_the_sizes_of_all_data_to_which_it_is_fitted():
    """The search used half of the data, whose intervals are wider."""
    setups = []
    for kept_s in (LENGTH_S / 2, LENGTH_S):
        view = _View()
        view.measured[view.t_s > kept_s] = np.nan
        setups.append(Setup([view], (Nuisance(BIAS, 0.0, -0.5, 0.5),), KINDS))
    half, whole = (Examination(setup, KNOWN, RIG, lambda what, share: None) for setup in setups)
    fitted = half.on(setups[1])
    for each in (half, fitted, whole):
        assert set(each.choice.chosen.names) == {"stage.level", "stage.swing"}
    bounds = []
    for each in (fitted, whole, half):
        fit = each.choice.chosen
        order = np.argsort(fit.names)
        bounds.append([end[order] for end in each.interval(fit)])
    np.testing.assert_allclose(bounds[0], bounds[1], atol=1e-4)
    widths = [high - low for low, high in bounds]
    assert (widths[2] > 1.2 * widths[0]).all()


def test_the_fit_of_the_named_effects_has_no_other(found):
    named = found.named(_without_level(found))
    assert named.names == ("stage.swing",)
    kept = found.verdict_problem.part(found.choice.chosen, [found.choice.chosen.names.index("stage.swing")])
    assert named.loss < kept.loss
    assert named.held_out.sum() > 2 * found.choice.chosen.held_out.sum()
    assert [each.names for each in found.without_each(named).values()] == [()]


def test_the_named_effect_takes_over_from_a_similar_one_that_is_not_named(found):
    """Beside its twin the swing has 0.5 of 0.8; size, held-out gap and calibration of the name are those without it."""
    decision = found.decide()
    chosen = _fitted(found.verdict_problem, (SWUNG, (0.5,)), (LEVELLED, (0.2,)), (TWINNED, (0.3,)))
    found.choice = replace(found.choice, chosen=chosen)
    named = found.named(decision)
    assert named.point == {path: pytest.approx(size, abs=0.02) for path, size in TRUTH.items()}
    low, high = found.interval(named)
    assert low[0] < TRUTH[SWING] < high[0]
    assert named.held_out.sum() < 1.2 * chosen.held_out.sum()


def test_a_named_effect_keeps_its_size_if_it_has_none_without_the_dropped_ones(found):
    """A stop that no sample reaches has no size of its own."""
    decision = _without_level(found)
    chosen = _fitted(found.verdict_problem, (SWUNG, (0.8,)), (LEVELLED, (0.2,)), (STOPPED, (0.4,)))
    found.choice = replace(found.choice, chosen=chosen)
    stop = replace(decision.selected[0], candidate=STOPPED)
    named = found.named(replace(decision, selected=(*decision.selected, stop)))
    assert named.point == {path: chosen.point[path] for path in (SWING, STOP)}


def test_a_named_effect_keeps_its_size_if_it_goes_to_a_bound_without_the_dropped_ones(found):
    """A Stribeck speed went to the end of its range once the other frictions were dropped."""
    decision = _without_level(found)
    low = replace(SWUNG, parameters=(replace(SWUNG.parameters[0], high=0.7),))
    chosen = _fitted(found.verdict_problem, (low, (0.5,)), (LEVELLED, (0.2,)), (TWINNED, (0.3,)))
    found.choice = replace(found.choice, chosen=chosen)
    named = found.named(decision)
    assert named.point == {SWING: chosen.point[SWING]}
    assert not named.at_bound


def test_if_all_are_named_they_have_the_sizes_of_the_search_and_if_none_is_its_null_model(found):
    decision = found.decide()
    named = found.named(decision)
    assert named.names == found.choice.chosen.names
    assert named.x == pytest.approx(found.choice.chosen.x, abs=1e-3)
    assert found.named(replace(decision, selected=())) is found.choice.null_model


def test_a_size_is_not_shared_with_a_tolerance_that_resembles_its_effect():
    setup = Setup([_View()], (Nuisance(TWIN, 0.0, -0.3, 0.3),), KINDS)
    found = Examination(setup, KNOWN, ROBOT, lambda what, share: None)
    named = found.named(found.decide())
    assert named.point[SWING] == pytest.approx(TRUTH[SWING], abs=0.03)
    assert abs(named.nuisance[0]) < 0.1


def test_the_calibration_next_to_the_named_effects_replaces_what_is_not_named(found):
    """Next to both effects the zero is nominal; next to the swing alone it takes the level's mean."""
    decision = _without_level(found)
    (bias,) = calibrated(found.setup, found.verdict_problem, found.plain, found.named(decision), str).parameters
    assert (bias.name, bias.at_edge) == (BIAS, False)
    assert bias.value == pytest.approx(TRUTH[LEVEL] * 2 / 3, abs=0.02)


def test_an_effect_is_resolved_if_its_interval_excludes_the_models_value_and_a_sample_reaches_it(found):
    assert found.unresolved == frozenset()
    fit = _fitted(found.search.problem, (SWUNG, (0.8,)), (LEVELLED, (0.2,)), (STOPPED, (0.5,)))
    assert _unresolved(found, fit) == {"stage.stop"}
    level = _moved(LEVELLED, 0.2)
    fit = _fitted(found.search.problem, (SWUNG, fit.u[0]), (level, fit.u[1]))
    assert _unresolved(found, fit) == {"stage.level"}  # the model has this level already


def test_an_effect_that_other_data_do_not_resolve_is_not_named(found):
    assert len(found.decide().selected) == 2
    decision = found.decide(unresolved=frozenset({"stage.level"}))
    assert [effect.candidate.name for effect in decision.selected] == ["stage.swing"]
    assert [effect.candidate.name for effect in decision.unresolved] == ["stage.level"]


def test_of_two_effects_that_only_their_sum_resolves_one_stays(found):
    fit = _fitted(found.search.problem, (SWUNG, (0.5,)), (LEVELLED, (0.2,)), (TWINNED, (0.3,)))
    low, high = found.interval(fit)
    assert ((low < 0) & (high > 0)).tolist() == [True, False, True]
    assert _unresolved(found, fit) == {"stage.twin"}
    low, _ = found.interval(found.verdict_problem.part(fit, [0, 1]))
    assert low.min() > 0


def test_parameters_of_one_effect_that_only_their_sum_resolves_are_resolved(found):
    pair = Candidate("stage.pair", "stage", tuple(_candidate(path, 0.3).parameters[0] for path in (SWING, TWIN)), ())
    fit = _fitted(found.search.problem, (pair, (0.5, 0.3)), (LEVELLED, (0.2,)))
    low, high = found.interval(fit)
    assert ((low < 0) & (high > 0)).tolist() == [True, True, False]
    assert _unresolved(found, fit) == frozenset()
    fit = _fitted(found.search.problem, (pair, (0.8, -0.8)), (LEVELLED, (0.2,)))
    nothing = replace(fit, effects=(_moved(pair, 0.4), fit.effects[1]))
    assert _unresolved(found, nothing) == {"stage.pair"}  # the model has their sum already


def _moved(effect, nominal):
    return replace(effect, parameters=tuple(replace(each, nominal=nominal) for each in effect.parameters))


def _unresolved(found, fit):
    found.choice = replace(found.choice, chosen=fit)
    found.__dict__.pop("unresolved", None)
    return found.unresolved


def test_the_nominal_model_has_its_values_for_the_folds_of_search_and_verdict(found):
    """A search over recordings has other folds than its verdict, and a held effect replaces a value of the model."""
    held = FittedChoice(found.setup, found.search, found.choice, lambda fit, low, high: (low, high), {SWING: 0.5})
    blocks = len(held.plain.fold)
    held.plain = replace(held.plain, fold=np.arange(blocks))
    assert blocks > len(held.choice.null_model.folds)
    assert held.nominal.fold_points == [{SWING: 0.5}] * blocks
