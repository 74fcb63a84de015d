"""Sets of effects: the smallest set that explains the recordings is the answer, and its equals are known."""

from dataclasses import dataclass

import numpy as np
import pytest

from softarm.diagnosis.engine import equal_sets
from softarm.diagnosis.engine.candidates import Nuisance
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.engine.search import Search
from softarm.diagnosis.engine.thresholds import RIG, ROBOT
from tests.diagnosis.engine.gauge import Gauge, candidate

RATE_HZ, LENGTH_S, NOISE = 50.0, 12.0, 0.02
# Every effect is a mixture of the same two signals, except the last, which is another signal.
MIXTURES = {"slow": (1, 0, 0), "fast": (0, 1, 0), "sum": (1, 0.6, 0), "difference": (1, -0.6, 0), "other": (0, 0, 1)}


@dataclass
class _View(Gauge):
    """A gauge that shows a constant plus what the effects of a point add."""

    truth: tuple[float, float] = (0.0, 0.0)  # amplitudes of the slow and of the fast signal
    acts = frozenset(f"stage.{name}.size" for name in MIXTURES)

    def __post_init__(self):
        self._stamp(2, RATE_HZ, LENGTH_S)
        self.signals = np.sin(np.outer([3.0, 11.0, 7.0], self.t_s))
        self._measure(dict(zip(("stage.slow.size", "stage.fast.size"), self.truth, strict=True)), NOISE)
        self.noise = self.floor

    def _predict(self, point):
        sizes = np.array([point.get(f"stage.{name}.size", 0.0) for name in MIXTURES])
        return sizes @ np.array(list(MIXTURES.values())) @ self.signals


@pytest.fixture(params=[ROBOT, RIG], ids=["robot", "rig"])
def chosen(request):
    """Return chosen(truth, *names): the search, the fitted set of these names, and the null model."""

    def made(truth, *names):
        setup = Setup([_View(truth)], (Nuisance("elsewhere.zero.bias", 0.0, -0.3, 0.3),), ("turns", "turns"))
        candidates = tuple(candidate(f"stage.{name}.size", -4.0, 4.0, 0.2, 0.2, -0.2) for name in MIXTURES)
        search = Search(setup.weighed(), setup.plain(), ("stage",), candidates, request.param)
        own = tuple(c for c in candidates if c.name.removeprefix("stage.") in names)
        null_model = search.null_model()
        return search, search.problem.fit([(own, tuple(c.starts[0] for c in own))])[0], null_model

    return made


def test_one_effect_replaces_two_that_it_explains(chosen):
    found = equal_sets.smallest(*chosen((0.5, 0.3), "slow", "fast"))
    assert found.names == ("stage.sum",)
    assert found.u[0][0] == pytest.approx(0.5, abs=0.01)


def test_two_effects_that_no_single_one_explains_stay(chosen):
    search, both, null_model = chosen((0.5, 0.6), "slow", "fast")
    assert equal_sets.smallest(search, both, null_model) is both


def test_a_set_of_other_effects_that_explains_as_much_is_found(chosen):
    found = equal_sets.equals(*chosen((0.5, 0.6), "slow", "fast"))
    assert [fit.names for fit in found] == [("stage.sum", "stage.difference")]


def test_the_answer_of_a_search_names_its_equals(chosen):
    search, *_ = chosen((0.5, 0.6))
    choice = search.run(lambda text, share: None)
    names = {fit.names for fit in (choice.chosen, *choice.equal_sets)}
    assert len(choice.chosen.effects) == 2
    assert all("stage.other" not in each for each in names)
    assert len(names) > 1
