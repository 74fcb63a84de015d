"""Slow changes: a drifting strength is found with its size, a wrong constant and noise are not."""

from dataclasses import dataclass

import numpy as np
import pytest

from softarm.diagnosis.engine.candidates import Nuisance
from softarm.diagnosis.engine.examination import Examination
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.engine.thresholds import RIG, ROBOT
from tests.diagnosis.engine.gauge import Linear, candidate

RATE_HZ, LENGTH_S, NOISE = 10.0, 12.0, 0.05
GAIN, BIAS = "stage.gain.scale", "stage.zero.bias"
KINDS = ("sine", "square", "decay", "sine", "both")
TRIALS = len(KINDS)


@dataclass
class _View(Linear):
    """A gauge whose gain changes by `within` during every trial and by `over` from the first trial to the last.

    A change by `settling` has a time constant of 2 s in every trial.
    """

    within: float = 0.0
    over: float = 0.0
    settling: float = 0.0
    gain: float = 1.0
    hum: float = 0.0
    seed: int = 0

    def __post_init__(self):
        t = self._stamp(TRIALS, RATE_HZ, LENGTH_S)
        shapes = {"sine": np.sin(2 * t), "square": np.sign(np.sin(t)), "decay": np.cos(3 * t) * np.exp(-t / 9)}
        shapes["both"] = shapes["sine"] + shapes["square"]
        inputs = np.concatenate([shapes[kind] for kind in KINDS])
        self.signals, self.nominal = {GAIN: inputs, BIAS: 1.0}, {GAIN: 1.0}
        self.floor, self.features = np.array([NOISE]), {"input": inputs}
        noise = NOISE * np.random.default_rng(self.seed).normal(size=len(self.t_s))
        slow = self.within * (self.t_s / LENGTH_S - 0.5) + self.over * (self.trial / (TRIALS - 1) - 0.5)
        slow += self.settling * (1 - np.exp(-self.t_s / 2.0))
        noise += self.hum * np.sin(17.3 * self.t_s)
        self.measured = ((self.gain + slow) * inputs + noise)[:, None]


def examined(thresholds=ROBOT, **view):
    setup = Setup([_View(**view)], (Nuisance(GAIN, 1.0, 0.95, 1.05), Nuisance(BIAS, 0.0, -0.1, 0.1)), KINDS)
    known = [candidate(GAIN, 0.2, 3.0, 0.3, 1.3, 0.7, nominal=1.0, tolerance=0.1)]
    return Examination(setup, known, thresholds, lambda what, share: None)


@pytest.mark.parametrize(
    ("thresholds", "which", "when"),
    [(ROBOT, "within", "within the trials"), (RIG, "over", "from the first trial to the last")],
    ids=["robot", "rig"],
)
def test_a_drifting_strength_is_unknown_and_the_sentence_says_what_drifts(thresholds, which, when):
    found = examined(thresholds, **{which: -0.5})
    (finding,) = found.slow.values()
    assert f"{GAIN} changes from 1.2" in finding.where
    assert finding.where.endswith(when)
    assert finding.energy == pytest.approx(
        np.var(_View(**{which: -0.5}).measured - _View().measured) / NOISE**2, rel=0.3
    )
    decision = found.decide()
    assert decision.kind == "unknown"
    assert decision.structure["stage"] == finding.where


def test_a_strength_that_settles_early_in_every_trial_is_found():
    (finding,) = examined(settling=0.3).slow.values()
    assert finding.where.startswith(f"{GAIN} changes from 1.1")
    assert finding.where.endswith("within the trials, mostly in their first 4.2 s")


def test_noise_and_wrong_constants_do_not_drift():
    for seed in range(4):
        assert examined(gain=1 + 0.004 * seed, seed=seed).slow == {}
    named = examined(gain=1.4)
    assert (named.slow, named.decide().kind) == ({}, "named")


def test_a_change_within_the_tolerance_is_tolerated():
    assert examined(within=0.04).slow == {}
    assert examined(within=0.12).slow != {}


def test_a_slow_change_that_is_no_visible_part_of_the_rest_belongs_to_the_form_of_the_law():
    assert examined(within=0.5, hum=0.5).slow != {}
    assert examined(within=0.2, hum=0.6).slow == {}


def test_next_to_a_large_rest_a_small_slow_change_of_an_approximate_law_does_not_count():
    assert examined(RIG, within=-0.5).slow != {}
    assert examined(RIG, within=-0.5, hum=0.5).slow == {}
    assert examined(ROBOT, within=-0.5, hum=0.5).slow != {}
