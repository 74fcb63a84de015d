"""Fits: known parameters come back with honest intervals, within bounds, and what is held out is really held out."""

import dataclasses
from dataclasses import dataclass, field

import numpy as np
import pytest
from scipy.signal import lfilter

from softarm.diagnosis.engine.candidates import Candidate, Nuisance
from softarm.diagnosis.engine.equal_sets import Prediction
from softarm.diagnosis.engine.fits import COARSE, EDGE_COST, LEAST_WIDTH, NUDGE, nudged
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.engine.whitened import BLOCK_S
from tests.diagnosis.engine.gauge import ELSEWHERE, Gauge, candidate

RATE_HZ, LENGTH_S, NOISE = 60.0, 6.0, 0.05
KINDS = ("steps", "chirp", "decay")
SCALE, TIME, BIAS, LOAD = "stage.gain.scale", "stage.lag.time", "stage.zero.bias", "stage.load.share"
TRUE = {SCALE: 0.3, TIME: 0.15, BIAS: 0.2}


GAIN = candidate(SCALE, -0.5, 0.5, 0.1, 0.1, -0.1)
LAG = candidate(TIME, 0.0, 1.0, 0.1, 0.05, 0.4)
ZERO = Nuisance(BIAS, 0.0, -0.3, 0.3)


@dataclass
class _View(Gauge):
    """A lagging gauge with three trials: (1 + scale) x lag(input) + bias, and noise."""

    seed: int = 0
    truth: dict[str, float] = field(default_factory=lambda: dict(TRUE))
    acts = frozenset({SCALE, TIME, BIAS})

    def __post_init__(self):
        t = self._stamp(3, RATE_HZ, LENGTH_S)
        waves = (np.sign(np.sin(2.1 * t)), np.sin(2 * np.pi * t * (0.2 + 0.15 * t)), np.exp(-t) * np.cos(5 * t))
        self.inputs = np.stack([1 + wave for wave in waves])
        self._measure(self.truth, NOISE, self.seed)

    def _predict(self, point):
        time_s = point.get(TIME, 0.0)
        keep = np.exp(-1 / (RATE_HZ * time_s)) if time_s > 1e-6 else 0.0
        seen, _ = lfilter([1 - keep], [1.0, -keep], self.inputs, zi=keep * self.inputs[:, :1])
        return (1 + point.get(SCALE, 0.0)) * seen.ravel() + point.get(BIAS, 0.0)


def _problem(view, nuisances=(ZERO,)):
    return Setup([view], nuisances, KINDS).plain()


def _fit(problem, *effects, start=0, rounds=8):
    return problem.fit([(effects, tuple(each.starts[start] for each in effects))], rounds=rounds)[0]


@pytest.fixture(scope="module")
def both():
    """Gain and lag fitted together, the zero a nuisance."""
    return _fit(_problem(_View()), GAIN, LAG)


class _Loaded(_View):
    """The gauge with a load that changes its reading as the gain does."""

    acts = _View.acts | {LOAD}

    def _predict(self, point):
        return super()._predict(point | {SCALE: point.get(SCALE, 0.0) + point.get(LOAD, 0.0)})


class _Kinked(_View):
    """The gauge with a gain whose effect has a ripple, so that its loss has a minimum every 0.04."""

    def _predict(self, point):
        scale = point.get(SCALE, 0.0)
        return super()._predict(point | {SCALE: scale + 0.02 * np.sin(2 * np.pi * scale / 0.04)})


def test_wide_differences_descend_over_small_minima():
    fine = _problem(_Kinked(truth={SCALE: TRUE[SCALE]}))
    start = [((GAIN,), ((-0.4,),))]
    assert fine.fit(start, 12)[0].loss > 10 * fine.losses([((GAIN,), ((TRUE[SCALE],),))])[0]
    rough = dataclasses.replace(fine, nudge=COARSE).fit(start, 12)[0]
    assert rough.point[SCALE] == pytest.approx(TRUE[SCALE], abs=0.02)


def test_a_law_with_jumps_moves_no_further_than_its_reach():
    """Its last linearisation holds nearby only, and so do its folds and halves."""
    (parameter,) = GAIN.parameters
    near = dataclasses.replace(GAIN, parameters=(dataclasses.replace(parameter, reach=0.05),))
    fit = _problem(_View()).fit([((near,), ((0.0,),))], 2)[0]
    assert fit.u[0][0] == pytest.approx(0.05)
    assert fit.folds.max() <= 0.1 + 1e-12
    assert fit.apart.max() <= 0.1 + 1e-12


@pytest.mark.parametrize("nudge", [NUDGE, COARSE, 30.0])
def test_a_difference_stays_within_the_wider_side_of_the_bounds(nudge):
    (parameter,) = GAIN.parameters
    for u in (-0.5, -0.1, 0.0, 0.3, 0.5):
        moved = u + nudged(parameter, u, nudge)
        assert parameter.low <= moved <= parameter.high
        assert abs(moved - u) == pytest.approx(min(nudge * parameter.size, 0.5 + abs(u)))


def test_a_parameter_fixed_by_equal_bounds_still_has_a_difference():
    (parameter,) = GAIN.parameters
    fixed = dataclasses.replace(parameter, low=0.2, high=0.2)
    assert nudged(fixed, 0.2, NUDGE) == pytest.approx(NUDGE * parameter.size)


@pytest.mark.parametrize("start", [0, 1])
def test_known_parameters_come_back_from_each_start(both, start):
    found = _fit(_problem(_View()), GAIN, LAG, start=start)
    assert found.point[SCALE] == pytest.approx(TRUE[SCALE], abs=0.01)
    assert found.point[TIME] == pytest.approx(TRUE[TIME], abs=0.01)
    assert found.nuisance[0] * ZERO.edge == pytest.approx(TRUE[BIAS], abs=0.01)
    assert found.point == pytest.approx(both.point, abs=1e-3)


def test_the_loss_is_that_of_the_noise(both):
    samples = len(KINDS) * RATE_HZ * LENGTH_S
    assert both.loss == pytest.approx(samples, rel=0.1)
    assert both.held_out.sum() == pytest.approx(samples, rel=0.15)
    assert both.held_out.sum() > both.loss


def test_a_stretch_is_worth_the_same_whatever_the_views_own_time():
    usual, quick = Setup([_View()], (ZERO,), KINDS), Setup([_View()], (ZERO,), KINDS, block_s=BLOCK_S / 3)
    assert len(quick.blocks) == pytest.approx(3 * len(usual.blocks), rel=0.1)
    one, three = usual.weighed().fit([((), ())])[0], quick.weighed().fit([((), ())])[0]
    assert three.loss == pytest.approx(3 * one.loss, rel=1e-4)
    assert three.held_out.sum() == pytest.approx(3 * one.held_out.sum(), rel=0.05)


def test_many_fits_at_once_are_each_alone(both):
    problem = _problem(_View())
    sets = [((), ()), ((GAIN,), ((0.1,),)), ((GAIN, LAG), (GAIN.starts[0], LAG.starts[0]))]
    together = problem.fit(sets, rounds=8)
    assert [f.names for f in together] == [(), ("stage.gain",), ("stage.gain", "stage.lag")]
    assert together[2].point == pytest.approx(both.point, rel=1e-4)
    assert together[0].loss > together[1].loss > together[2].loss


@pytest.mark.parametrize(("scale", "end"), [(0.8, 0.5), (-0.8, -0.5)])
def test_a_fit_stays_within_bounds_and_reports_an_effect_at_its_bound(scale, end):
    fit = _fit(_problem(_View(truth={SCALE: scale})), GAIN)
    assert fit.point[SCALE] == pytest.approx(end)
    assert fit.at_bound


def test_within_its_bounds_no_effect_is_at_one(both):
    assert not both.at_bound
    absent = _fit(_problem(_View(truth={})), LAG)
    assert absent.point[TIME] == pytest.approx(0.0, abs=0.005)
    assert not absent.at_bound  # an effect that is absent stands at no bound, though zero is one


def test_friction_that_slips_at_once_is_at_no_bound():
    torque, give = (candidate(f"stage.friction.{name}", 0.0, 1.0, 0.1).parameters[0] for name in ("torque", "give"))
    friction = Candidate("stage.friction", "stage", (torque, dataclasses.replace(give, nominal=0.1, shape=True)), ())
    assert not friction.at_bound((0.5, 0.0))
    assert friction.at_bound((1.0, 0.0))
    assert friction.at_bound((0.5, 1.0))


def test_a_nuisance_stays_in_its_box():
    fit = _fit(_problem(_View(truth={BIAS: 0.9})))
    assert fit.nuisance[0] * ZERO.edge == pytest.approx(ZERO.high)


@pytest.mark.parametrize("start", [0.15, 0.5])
def test_of_sizes_that_fit_alike_the_one_that_needs_least_of_the_nuisances_is_taken(start):
    problem = _problem(_Loaded(truth={SCALE: 0.3}), (Nuisance(LOAD, 0.0, -0.2, 0.2),))
    gain = candidate(SCALE, -0.5, 0.5, 0.1, start)
    assert abs(_fit(problem, gain).point[SCALE] - 0.3) > 0.04
    fit = _fit(dataclasses.replace(problem, edge_cost=EDGE_COST), gain)
    assert fit.point[SCALE] == pytest.approx(0.3, abs=0.01)
    assert fit.nuisance == pytest.approx([0.0], abs=0.05)
    assert fit.loss == pytest.approx(_fit(problem, gain).loss, rel=1e-3)


def test_a_parameter_that_an_effect_fits_is_no_nuisance():
    own = candidate(BIAS, -2.0, 2.0, 0.2, 0.2)
    fit = _fit(_problem(_View(truth={BIAS: 0.9})), own)
    assert fit.nuisance[0] == 0.0
    assert fit.point[BIAS] == pytest.approx(0.9, abs=0.02)


@pytest.mark.parametrize("fold", range(3))
def test_held_out_data_do_not_change_their_own_fit(fold):
    """Spoil one kind of excitation: the parameters that judge it stay, those that judge the others go astray."""
    kinds = sorted(KINDS)
    spoilt = _View()
    spoilt.measured[spoilt.trial == KINDS.index(kinds[fold])] *= 1.2
    before, after = (_fit(_problem(view), GAIN) for view in (_View(), spoilt))
    assert after.folds[fold] == pytest.approx(before.folds[fold], abs=1e-4)
    others = [i for i in range(3) if i != fold]
    assert (np.abs(after.folds[others] - before.folds[others]) > 0.01).all()


def test_the_held_out_loss_is_that_of_the_held_out_parameters():
    view = _View(truth={SCALE: 0.3})
    problem = _problem(view, (ELSEWHERE,))
    fit = _fit(problem, GAIN)
    folds = np.array([sorted(KINDS).index(KINDS[trial]) for trial, _ in problem.blocks])
    for fold in range(3):
        gap = view.gap([{SCALE: float(fit.folds[fold, 0])}])[0, :, 0] / NOISE
        mine = view.trial == KINDS.index(sorted(KINDS)[fold])
        assert fit.held_out[folds == fold].sum() == pytest.approx(float((gap[mine] ** 2).sum()), rel=1e-3)


def test_a_strength_that_changes_from_kind_to_kind_scatters():
    view = _View(truth={SCALE: 0.3})
    steady = _fit(_problem(view), GAIN).scatter(0)
    for trial, share in enumerate((0.1, 0.3, 0.45)):
        view.measured[view.trial == trial] *= (1 + share) / 1.3
    assert steady < 0.05
    assert _fit(_problem(view), GAIN).scatter(0) > 5 * steady


def test_parts_of_the_data_do_not_trade_a_strength_for_a_tolerance():
    """A load within its box resembles the gain; the strength varies as if there were none."""
    view = _Loaded(truth={SCALE: 0.3})
    steady = _fit(_problem(view), GAIN)
    loaded = _problem(view, (Nuisance(LOAD, 0.0, -0.2, 0.2), ZERO))
    fit = _fit(dataclasses.replace(loaded, edge_cost=EDGE_COST), GAIN)
    assert fit.drift(0) == pytest.approx(steady.drift(0), abs=0.01)
    assert fit.scatter(0) == pytest.approx(steady.scatter(0), abs=0.01)


def test_a_simulated_held_out_loss_is_the_linear_one_s_where_the_law_is_linear():
    problem = _problem(_View(truth={SCALE: 0.3, BIAS: 0.2}))
    linear, simulated = _fit(problem, GAIN), _fit(dataclasses.replace(problem, simulated=True), GAIN)
    assert simulated.held_out.sum() == pytest.approx(linear.held_out.sum(), rel=0.02)
    assert simulated.held_out.sum() >= 0.98 * simulated.loss  # unseen blocks are not fitted better than seen ones


def test_no_interval_ends_at_its_own_estimate():
    """Without noise, all blocks agree."""
    view = _View(truth={SCALE: 0.3})
    view.measured = view._predict(view.truth)[:, None]
    low, high = _problem(view).interval(_fit(_problem(view), GAIN))
    assert high - low == pytest.approx([2 * LEAST_WIDTH * GAIN.parameters[0].size], rel=0.2)


def test_the_size_that_needs_least_of_a_tolerance_is_as_uncertain_as_the_best_one():
    """A load within its box resembles the gain, so the two fit alike at several sizes."""
    loaded = _problem(_Loaded(truth={SCALE: 0.3}), (Nuisance(LOAD, 0.0, -0.2, 0.2), ZERO))
    fit = _fit(dataclasses.replace(loaded, edge_cost=1000 * EDGE_COST), GAIN)
    stated, best, spread = loaded.region(fit)
    low, high = loaded.interval(fit)
    half = 0.999 * np.sqrt(spread.diagonal())
    assert abs(best - stated) > 0.1 * half
    assert (low <= np.minimum(stated, best) - half).all()
    assert (high >= np.maximum(stated, best) + half).all()


def test_a_similar_effect_replaces_an_effect_that_is_left_out():
    droop = candidate("stage.droop.scale", -0.5, 0.5, 0.1)
    view = _View(truth=TRUE)
    once = view.gap
    view.gap = lambda points: once([{**p, SCALE: p.get(SCALE, 0.0) + p.get("stage.droop.scale", 0.0)} for p in points])
    view.acts = view.acts | {"stage.droop.scale"}
    problem = _problem(view)
    halves = problem.fit([((GAIN, LAG, droop), ((0.15,), (0.15,), (0.15,)))])[0]
    prediction = Prediction(problem, halves)
    without_gain, without_droop = prediction.of((1, 2)), prediction.of((0, 1))
    assert [c.name for c in without_gain.effects] == ["stage.lag", "stage.droop"]
    assert without_gain.u[1][0] == pytest.approx(TRUE[SCALE], abs=0.03)
    assert without_droop.u[0][0] == pytest.approx(TRUE[SCALE], abs=0.03)
    assert prediction.of((0, 2)).loss > without_gain.loss + 100  # nothing replaces the lag
