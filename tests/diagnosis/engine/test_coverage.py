"""Intervals and levels hold as often as they say: neither too rarely nor too often, by made-up data of known truth."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import binom

from softarm.diagnosis.engine import structure
from softarm.diagnosis.engine.candidates import Nuisance
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.engine.shrink import interval
from tests.diagnosis.engine.gauge import Linear, candidate

TRIALS, RATE_HZ, LENGTH_S = 4, 30.0, 8.0
STEPS = round(RATE_HZ * LENGTH_S)
SAMPLES = TRIALS * STEPS
T = (np.arange(SAMPLES) % STEPS) / RATE_HZ
SCALE, BIAS = "stage.gain.scale", "stage.zero.bias"
GAIN = candidate(SCALE, 0.5, 1.5, 0.1, 1.1, nominal=1.0)
ZERO = Nuisance(BIAS, 0.0, -0.3, 0.3)
TRUE = {SCALE: 1.2, BIAS: 0.1}


def bounds(runs, share, most=None):
    """Fewest and most of so many runs that chance allows where each holds by such a share; 1 in 1000 beyond either."""
    return binom.ppf(0.001, runs, share), binom.ppf(0.999, runs, most or share)


@dataclass
class _Gauge(Linear):
    """Scale x input + bias under noise that forgets itself within `memory_s`."""

    seed: int
    memory_s: float = 0.0
    floor, nominal = np.ones(1), {SCALE: 1.0}
    t_s, trial = T, np.arange(SAMPLES) // STEPS

    def __post_init__(self):
        draw = np.random.default_rng(self.seed)
        self.signals = {SCALE: np.sin(2 * np.pi * 0.4 * T + 6 * draw.random(TRIALS)[self.trial]), BIAS: 1.0}
        noise, keep = draw.normal(size=(STEPS, TRIALS)), np.exp(-1 / (RATE_HZ * self.memory_s)) if self.memory_s else 0
        noise[1:] *= np.sqrt(1 - keep**2)
        self.noise = lfilter([1.0], [1.0, -keep], noise, axis=0).T.reshape(-1, 1)
        self.measured = self._predict(TRUE)[:, None] + self.noise


@pytest.mark.parametrize("memory_s", [0.0, 0.3], ids=["white", "a third of a second"])
def test_a_parameters_interval_holds_it_95_times_in_100(memory_s):
    """Beside a nuisance, whether the noise is white or carries on through ten samples."""
    runs, inside = 100, 0
    for seed in range(runs):
        problem = Setup([_Gauge(seed, memory_s)], (ZERO,), ("hum",) * TRIALS).plain()
        low, high = problem.interval(problem.fit([((GAIN,), GAIN.starts)], rounds=2)[0])
        inside += bool(low[0] <= TRUE[SCALE] <= high[0])
    fewest, most = bounds(runs, 0.95)
    assert fewest <= inside <= most, inside / runs


def _halves(gauge):
    """Half the width of the interval, with an inexact law and with an exact one."""
    problem = Setup([gauge], (ZERO,), ("hum",) * TRIALS).plain()
    fit = problem.fit([((GAIN,), GAIN.starts)], rounds=2)[0]
    return [float(np.ptp(problem.interval(fit, inexact), axis=0)[0]) / 2 for inexact in (True, False)]


def test_an_interval_covers_the_law_error_that_the_residual_may_hide():
    """A sine of 0.3 that no law has, left beside an input of 1: as much again may lie along the input, so +-0.3."""
    gauge = _Gauge(0)
    gauge.measured = (gauge._predict({SCALE: 1.2}) + 0.3 * np.sin(2 * np.pi * 0.9 * T))[:, None]
    inexact, exact = _halves(gauge)
    assert inexact == pytest.approx(0.3, rel=0.08)  # less what chance is granted
    assert exact < 0.05  # other blocks of the same would say the same


def test_white_noise_hides_no_law():
    """Its neighbours have nothing in common but by chance, and that is granted: 39 times in 40."""
    wider = sum(inexact > 1.001 * exact for inexact, exact in (_halves(_Gauge(seed)) for seed in range(50)))
    assert wider <= bounds(50, 0.025)[1]
    inexact, exact = _halves(_Gauge(0, 1.0))
    assert inexact > 1.2 * exact  # what lasts a second may be a law


def _shrinks(runs, unlike):
    """Intervals of campaigns [runs, 3], and the shrink that another campaign of the same kind shows [runs].

    unlike: how much trials differ in what they excite of the gap; half as much in what is left of it.
    """
    draw = np.random.default_rng(1)
    before = np.exp(unlike * draw.normal(size=(2, runs, 8)))
    after = 0.2 * before * np.exp(unlike / 2 * draw.normal(size=before.shape))
    found = np.array([interval(b, a) for b, a in zip(before[0], after[0], strict=True)])
    return found, 1 - np.sqrt(after[1].sum(axis=1) / before[1].sum(axis=1))


@pytest.mark.parametrize("unlike", [0.4, 0.7])
def test_the_interval_of_a_shrink_holds_for_fresh_campaigns(unlike):
    """The interval holds in 90 to 95 % of the campaigns; a bare bootstrap over trials would in 70 %."""
    found, fresh = _shrinks(600, unlike)
    value, low, high = found.T
    assert ((low < value) & (value < high)).all()
    inside = np.mean((low <= fresh) & (fresh <= high))
    assert 0.88 < inside < 0.97


def test_all_looks_together_find_something_in_noise_no_more_often_than_the_level_and_not_much_less(monkeypatch):
    """They share data and are counted as if they did not, which costs no more than two thirds of the level."""
    monkeypatch.setattr(structure, "LEVEL", 0.2)
    runs = 100
    found = [structure.structure(g := _Gauge(seed), g.noise) for seed in range(runs)]
    fewest, most = bounds(runs, 0.2 / 3, 0.2)
    alarms = sum(each.energy > 0 for each in found)
    assert fewest <= alarms <= most, alarms / runs
