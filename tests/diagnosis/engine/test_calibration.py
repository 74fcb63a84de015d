"""Calibration: resolved parameters come back with their share of the gap; the others stay nominal."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.signal import lfilter

from softarm.diagnosis.answer.calibration import WORTH, calibrated
from softarm.diagnosis.engine.candidates import Nuisance
from softarm.diagnosis.engine.problem import Setup
from tests.diagnosis.engine.gauge import Linear, candidate

RATE_HZ, LENGTH_S, NOISE = 60.0, 6.0, 0.05
SCALE, BIAS, SLOPE = "stage.gain.scale", "stage.zero.bias", "stage.drift.slope"
NUISANCES = (Nuisance(SCALE, 1.0, 0.8, 1.2), Nuisance(BIAS, 0.0, -0.5, 0.5), Nuisance(SLOPE, 0.0, -0.2, 0.2))
NOMINAL = {each.path: each.nominal for each in NUISANCES}


@dataclass
class _Gauge(Linear):
    """A gauge with a scale, a bias and a slope in time; three trials."""

    truth: dict[str, float]
    seed: int = 0
    rate_hz: float = RATE_HZ
    drift: float = 0.0  # step of a slow disturbance
    nominal = NOMINAL

    def __post_init__(self):
        t = self._stamp(3, self.rate_hz, LENGTH_S)
        inputs = np.concatenate((np.sin(2 * t), np.sign(np.sin(3 * t)), np.exp(-t)))
        self.signals = {SCALE: inputs, BIAS: 1.0, SLOPE: self.t_s}
        self._measure(self.truth, NOISE, self.seed)
        steps = np.random.default_rng(self.seed).normal(size=len(self.t_s))
        self.measured += self.drift * lfilter([1.0], [1.0, -0.995], steps)[:, None]


def calibration(truth, seed=0, rate_hz=RATE_HZ, drift=0.0):
    gauge = _Gauge(truth, seed, rate_hz, drift)
    setup = Setup([gauge], NUISANCES, ("sine", "square", "decay"))
    plain = setup.plain()
    problem = setup.weighed(gauge.gap([{}])) if drift else plain
    (nothing,) = problem.fit([((), ())])
    return calibrated(setup, problem, plain, nothing, lambda path: "-")


def test_resolved_parameters_come_back_and_the_gap_falls_to_the_noise():
    found = calibration({SCALE: 1.1, BIAS: 0.2})
    assert {each.name for each in found.parameters} == {SCALE, BIAS}
    for each in found.parameters:
        truth = {SCALE: 1.1, BIAS: 0.2}[each.name]
        assert each.low < truth < each.high
        assert each.value == pytest.approx(truth, abs=0.02)
        assert each.nominal == NOMINAL[each.name]
        assert not each.at_edge
        assert (each.tolerance_low, each.tolerance_high) == pytest.approx(
            {SCALE: (0.8, 1.2), BIAS: (-0.5, 0.5)}[each.name]
        )
    assert [each.name for each in found.parameters] == [BIAS, SCALE]  # what takes most comes first
    assert all(each.shrink > 0.3 for each in found.parameters)
    assert found.rms["stage"] == pytest.approx(NOISE, rel=0.1)


def test_noise_alone_is_rarely_calibrated():
    resolved = [len(calibration({}, seed).parameters) for seed in range(40)]
    assert sum(resolved) <= 14  # of 120 tests at 5 %, on few blocks


def test_without_a_resolved_parameter_the_model_stays_nominal():
    found = next(each for each in (calibration({}, seed) for seed in range(40)) if not each.parameters)
    assert found.values == {}
    assert set(map(len, found.folds)) == {0}
    assert found.rms["stage"] == pytest.approx(NOISE, rel=0.1)


def test_a_parameter_beyond_its_tolerance_is_at_the_edge():
    found = calibration({SCALE: 1.6})
    (scale,) = (each for each in found.parameters if each.name == SCALE)
    assert scale.at_edge
    assert scale.value == pytest.approx(1.2)


def test_a_parameter_that_takes_less_than_a_hundredth_of_the_gap_stays_nominal():
    for slope, named in ((0.0015, [SCALE]), (0.003, [SCALE, SLOPE])):  # both are resolved at this rate
        found = calibration({SCALE: 1.1, SLOPE: slope}, rate_hz=240.0)
        assert [each.name for each in found.parameters] == named


def test_no_parameter_enlarges_the_gap_once_the_others_are_fitted_again():
    """At seed 19, a parameter takes less once another one, which took too little, is nominal again."""
    for seed, drift in ((19, 0.02), (19, 0.03), (3, 0.01)):
        assert all(each.shrink >= WORTH for each in calibration({SCALE: 1.03}, seed, drift=drift).parameters)


class _Amplifier(_Gauge):
    """A gauge whose bias is scaled with its input, and bends a little."""

    def _predict(self, point):
        at = NOMINAL | dict(point)
        return at[SCALE] * (self.signals[SCALE] + at[BIAS] + at[BIAS] ** 2)


@pytest.mark.parametrize(("share", "slope"), [(0.15, 1.5), (-0.3, 0.85)])
def test_beside_an_effect_a_nuisance_acts_as_it_does_there(share, slope):
    """Its slope is the one to the edge of its box, or to its own value if that is far from nominal."""
    gauge, kinds = _Amplifier({}), ("sine", "square", "decay")
    (nothing,) = Setup([gauge], NUISANCES, kinds).plain().fit([((), ())])
    effect = candidate(SCALE, 0.5, 5.0, 0.5, 1.5, nominal=1.0)
    fit = replace(nothing, effects=(effect,), u=((3.0,),), nuisance=np.array([0.0, share, 0.0]))
    changes = Setup([gauge], NUISANCES, kinds).beside(fit).directions[0].nuisances
    assert changes[1] == pytest.approx(np.full_like(changes[1], -3 * 0.5 * slope), rel=1e-4)
    assert not changes[0].any()  # the scale itself is the effect's
