"""The search among nested sets: what a set comes to does not hang on what stood beside it before."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from softarm.diagnosis.engine.candidates import Nuisance
from softarm.diagnosis.engine.fits import FitProblem
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.engine.thresholds import RIG, ROBOT
from tests.diagnosis.engine.gauge import Gauge, Linear, candidate, search_in

RATE_HZ, LENGTH_S, NOISE = 50.0, 6.0, 0.02
PACE, LEVEL = "stage.pace.rate", "stage.level.height"
TRUE_PACE, OTHER_WELL = 0.6, 2.3  # rad/s
REFITTING = replace(RIG, search=replace(RIG.search, refit=True))


WAVES = tuple(f"stage.wave{i}.size" for i in range(8))
RATE = candidate(PACE, -4.0, 4.0, 0.3, 0.4, -0.4)
HEIGHT = candidate(LEVEL, -1.0, 1.0, 0.1, 0.1, -0.1)


@dataclass
class _View(Gauge):
    """A wheel that turns faster than it should: a sine of its angle. A wrong pace has wells of its own."""

    height: float = 0.0
    acts = frozenset({PACE, LEVEL})

    def __post_init__(self):
        self._stamp(2, RATE_HZ, LENGTH_S)
        self._measure({PACE: TRUE_PACE, LEVEL: self.height}, NOISE)
        self.noise = self.floor

    def _predict(self, point):
        return np.sin((3.0 + point.get(PACE, 0.0)) * self.t_s) + point.get(LEVEL, 0.0)


@pytest.mark.parametrize(
    ("thresholds", "begun", "ends"),
    [
        (REFITTING, OTHER_WELL, TRUE_PACE),
        (REFITTING, TRUE_PACE, TRUE_PACE),
        (ROBOT, OTHER_WELL, OTHER_WELL),
        (RIG, OTHER_WELL, OTHER_WELL),
    ],
)
def test_only_a_refitting_search_leaves_a_wrong_minimum(thresholds, begun, ends):
    search = search_in(_View(), (RATE, HEIGHT), thresholds)
    both = search.problem.fit([((RATE, HEIGHT), ((begun,), (0.1,)))])[0]
    assert both.point[PACE] == pytest.approx(begun, abs=0.3)
    alone = next(fit for fit in search.reduced(both) if fit.names == ("stage.pace",))
    assert alone.point[PACE] == pytest.approx(ends, abs=0.5)


@pytest.mark.parametrize(("thresholds", "height", "kept"), [(RIG, 0.03, 1), (RIG, 0.08, 2), (ROBOT, 0.03, 2)])
def test_a_rig_gets_no_further_effect_within_two_floors(thresholds, height, kept, monkeypatch):
    """A zero of 1.5 floors is nobody's gap alone, so it is none beside another effect, however sure; one of four is."""
    search = search_in(_View(height), (RATE, HEIGHT), thresholds)
    search.null_model()
    monkeypatch.setattr(search, "is_gain", lambda gain: True)
    both = search.problem.fit([((RATE, HEIGHT), ((TRUE_PACE,), (height,)))])[0]
    assert search.pruned(both).names == ("stage.pace", "stage.level")[:kept]


@dataclass
class _Waves(Linear):
    """A swing that two effects express alike, and waves that are absent."""

    def __post_init__(self):
        self._stamp(2, RATE_HZ, LENGTH_S)
        shapes = (np.sin(2 * self.t_s), 0.9 * np.sin(2 * self.t_s), *(np.cos(k * self.t_s) for k in range(3, 9)))
        self.signals = dict(zip(WAVES, shapes, strict=True))
        self._measure({WAVES[0]: 0.8}, NOISE)


@pytest.mark.parametrize("predicted", [8, 3], ids=["by fits", "by sensitivities"])
def test_half_of_the_unnecessary_effects_go_at_once_but_never_all_that_express_the_cause(predicted, monkeypatch):
    monkeypatch.setattr("softarm.diagnosis.engine.search.PREDICTED", predicted)
    effects = tuple(candidate(path, -2.0, 2.0, 0.3, 0.3) for path in WAVES)
    search = search_in(_Waves(), effects, RIG)
    search.null_model()
    (fit,) = search.problem.fit([(effects, ((0.4,), (0.44,), *[(0.01,)] * 6))])
    sizes, reduced = [], search.reduced
    monkeypatch.setattr(search, "reduced", lambda each: (sizes.append(len(each.effects)), reduced(each))[1])
    left = search.pruned(fit)
    assert left.names in (("stage.wave0",), ("stage.wave1",))
    assert len(sizes) < 6  # one by one: eight, seven, ... two
    assert max(sizes) <= predicted
    assert search.is_gain(search.gain(search.problem.fit([((), ())])[0], left))


@pytest.mark.parametrize(("restarts", "fits"), [(1, 2), (3, 3)])
def test_a_search_begins_again_without_an_effect_at_its_bound(restarts, fits, monkeypatch):
    """Both effects that express the swing end at their bound; without them nothing does."""
    effects = tuple(candidate(path, -2.0, 0.05, 0.3, 0.05) for path in WAVES[:4])
    search = search_in(_Waves(), effects, replace(RIG, search=replace(RIG.search, restarts=restarts)))
    pools, full = [], search.full
    monkeypatch.setattr(search, "full", lambda null, pool: (pools.append(len(pool)), full(null, pool))[1])
    assert search.backward(search.null_model(), lambda text, share: None).names == ()
    assert pools == [4, 3, 2][:fits]


def test_only_good_candidates_get_a_full_fit(monkeypatch):
    """The number of sets and the rounds of each fit; the level removes nothing of a wrong pace."""
    fits, fit = [], FitProblem.fit

    def counted(problem, sets, rounds):
        fits.append((len(sets), rounds))
        return fit(problem, sets, rounds)

    def extended(**budget):
        thresholds = replace(ROBOT, search=replace(ROBOT.search, rounds=7, rounds_rough=1, **budget))
        search = search_in(_View(), (RATE, HEIGHT), thresholds)
        base = search.null_model()
        fits.clear()
        monkeypatch.setattr(FitProblem, "fit", counted)
        search.extended(base)
        monkeypatch.undo()
        return fits

    assert extended() == [(2, 1), (2, 7)]
    assert extended(candidates_max=1) == [(2, 1), (1, 7)]
    assert extended(lag_share=0.5) == [(2, 1), (1, 7)]


def test_the_linearisation_error_of_a_nuisance_is_counted():
    view = _View()
    setup = Setup([view], (Nuisance(PACE, 0.0, -0.3, 0.3), Nuisance(LEVEL, 0.0, -0.1, 0.1)), ("turns", "turns"))
    fit = replace(setup.plain().fit([((), ())])[0], nuisance=np.array([0.5, 1.0]))
    line = np.sin(3.0 * view.t_s) + 0.5 * (np.sin(3.3 * view.t_s) - np.sin(3.0 * view.t_s))
    off = np.mean((np.sin(3.15 * view.t_s) - line) ** 2) / NOISE**2
    assert off > 1
    assert setup.linearisation_error("stage", fit) == pytest.approx(off, rel=1e-4)
    assert setup.linearisation_error("stage", replace(fit, nuisance=np.array([0.0, 1.0]))) == pytest.approx(
        0.0, abs=1e-4
    )
    own = replace(fit, effects=(RATE,), u=((0.0,),))  # what a set itself fits is no nuisance beside it
    assert setup.linearisation_error("stage", own) == pytest.approx(0.0, abs=1e-4)


@dataclass
class _Amplifier(Linear):
    """A gauge with a wrong gain, seen in small inputs only, where a cubic law resembles a gain."""

    gain: float = 1.0
    cubic: float = 0.0

    def __post_init__(self):
        self._stamp(2, RATE_HZ, LENGTH_S)
        inputs = np.sin(2 * self.t_s)
        self.signals = {"stage.gain.scale": inputs, "stage.cubic.strength": inputs**3}
        self.nominal = {"stage.gain.scale": 1.0}
        self._measure({"stage.gain.scale": self.gain, "stage.cubic.strength": self.cubic}, NOISE)
        self.noise = self.floor


@pytest.mark.parametrize(
    ("law", "tolerance", "names"),
    [
        ({"gain": 1.12}, 0.05, ()),
        ({"cubic": 0.14}, 0.05, ("stage.cubic",)),
        # Within its tolerance, the cubic law must explain more than the gain by a clear margin.
        ({"cubic": 0.14}, 0.2, ("stage.cubic",)),
        ({"gain": 1.02, "cubic": 0.05}, 0.2, ()),
    ],
)
def test_no_missing_effect_is_named_if_a_parameter_within_its_tolerance_explains_more(law, tolerance, names):
    own = candidate("stage.gain.scale", 0.2, 3.0, 0.3, 1.3, 0.7, nominal=1.0, tolerance=0.2)
    new = candidate("stage.cubic.strength", -1.0, 1.0, 0.3, 0.2, -0.2, tolerance=tolerance)
    nuisance = Nuisance("stage.gain.scale", 1.0, 0.97, 1.03)
    search = search_in(_Amplifier(**law), [replace(own, constant=True), new], ROBOT, nuisance, ("sine", "other"))
    assert search.run(lambda what, share: None).chosen.names == names
