"""Sets of effects: the smallest set that explains the recordings is the answer, and its equals are known."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pytest

from softarm.diagnosis.engine import equal_sets
from softarm.diagnosis.engine.candidates import Candidate
from softarm.diagnosis.engine.equal_sets import Prediction
from softarm.diagnosis.engine.thresholds import RIG, ROBOT
from tests.diagnosis.engine.gauge import Linear, candidate, search_in

RATE_HZ, LENGTH_S, NOISE = 50.0, 12.0, 0.02
# Every effect is a mixture of the same two signals, except the last, which is another signal.
MIXTURES = {"slow": (1, 0, 0), "fast": (0, 1, 0), "sum": (1, 0.6, 0), "difference": (1, -0.6, 0), "other": (0, 0, 1)}
SIZES = ("stage.slow.size", "stage.fast.size", "stage.other.size")
# The slow signal with a shape: the form of the other signal that it adds.
SHAPED = Candidate(
    "stage.shaped",
    "stage",
    tuple(candidate(f"stage.{name}.size", -4.0, 4.0, 0.2).parameters[0] for name in ("shaped", "shape")),
    ((0.2, 0.0),),
)


@dataclass
class _View(Linear):
    """A gauge that shows a constant plus what the effects of a point add."""

    truth: tuple[float, ...] = ()  # amplitudes of the slow, the fast and the other signal

    def __post_init__(self):
        self._stamp(2, RATE_HZ, LENGTH_S)
        waves = np.sin(np.outer([3.0, 11.0, 7.0], self.t_s))
        mixtures = MIXTURES | {"shaped": (1, 0, 0), "shape": (0, 0, 1)}
        self.signals = {f"stage.{name}.size": mixture @ waves for name, mixture in mixtures.items()}
        self._measure(dict(zip(SIZES, self.truth, strict=False)), NOISE)
        self.noise = self.floor


@pytest.fixture(params=[ROBOT, RIG], ids=["robot", "rig"])
def chosen(request):
    """Return chosen(truth, *names): the search, the fitted set of these names, and the null model."""

    def made(truth, *names):
        candidates = tuple(candidate(f"stage.{name}.size", -4.0, 4.0, 0.2, 0.2, -0.2) for name in MIXTURES)
        candidates = (SHAPED, *candidates) if "shaped" in names else candidates
        search = search_in(_View(truth), candidates, request.param)
        own = tuple(c for c in candidates if c.name.removeprefix("stage.") in names)
        null_model = search.null_model()
        return search, search.problem.fit([(own, tuple(c.starts[0] for c in own))])[0], null_model

    return made


@pytest.mark.parametrize("truth", [(0.5, 0.3), (0.5, 0.6, 0.4), (0.0, 0.0, 0.0)])
def test_the_most_promising_sets_are_those_of_a_search_over_all(chosen, truth):
    search, both, null_model = chosen(truth, "slow", "fast")
    options = [fit.effects[0] for fit in search.extended(null_model) if fit.names[0] not in both.names]
    prediction = Prediction(search.problem, both, options)
    for size, shared_max in [(1, 0), (1, 1), *((k, most) for k in (2, 3, 4) for most in range(3))]:
        every = [m for m in combinations(range(5), size) if sum(i < 2 for i in m) <= shared_max]
        losses = sorted(prediction.of(members).loss for members in every)
        found = [each.loss for each in prediction.best(size, shared_max)]
        assert found == pytest.approx(losses[: equal_sets.FITTED_MAX], abs=1e-6)


def test_one_effect_replaces_two_that_it_explains(chosen):
    found = equal_sets.smallest(*chosen((0.5, 0.3), "slow", "fast"))
    assert found.names == ("stage.sum",)
    assert found.u[0][0] == pytest.approx(0.5, abs=0.01)


def test_two_effects_that_no_single_one_explains_stay(chosen):
    search, both, null_model = chosen((0.5, 0.6), "slow", "fast")
    assert equal_sets.smallest(search, both, null_model) is both


@pytest.mark.parametrize("names", [("slow", "fast"), ("sum", "difference")])
def test_whichever_set_a_search_ends_with_its_first_equal_is_the_answer(chosen, names):
    first, equals = equal_sets.first_of_equals(*chosen((0.5, 0.6), *names))
    assert set(first.names) == {"stage.slow", "stage.fast"}
    assert [fit.names for fit in equals] == [("stage.sum", "stage.difference")]


def test_sets_that_differ_in_two_effects_from_a_set_of_many_are_not_compared(chosen, monkeypatch):
    """Their number doubles with each effect, and six joints with gaps have thirty."""
    monkeypatch.setattr(equal_sets, "COMPARED_MAX", 1)
    monkeypatch.setattr(equal_sets, "Prediction", None)
    _, equals = equal_sets.first_of_equals(*chosen((0.5, 0.6), "sum", "difference"))
    assert equals == ()


def test_a_law_with_fewer_parameters_wins_within_noise(chosen):
    search, shaped, null_model = chosen((0.5, 0.0), "shaped")
    first, equals = equal_sets.first_of_equals(search, shaped, null_model)
    assert (first.names, equals) == (("stage.slow",), ())


def test_a_law_whose_shape_is_seen_stays(chosen):
    first, _ = equal_sets.first_of_equals(*chosen((0.5, 0.0, 0.4), "shaped"))
    assert first.names == ("stage.shaped",)


def test_the_answer_of_a_search_names_its_equals(chosen):
    search, *_ = chosen((0.5, 0.6))
    choice = search.run(lambda text, share: None)
    names = {fit.names for fit in (choice.chosen, *choice.equal_sets)}
    assert len(choice.chosen.effects) == 2
    assert all("stage.other" not in each for each in names)
    assert len(names) > 1
