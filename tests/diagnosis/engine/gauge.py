"""A view of one channel for tests of the engine, whose law is one line, and effects with one parameter."""

from types import SimpleNamespace

import numpy as np

from softarm.diagnosis.engine.candidates import Candidate, FittedParameter, Nuisance
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.engine.search import Search

ELSEWHERE = Nuisance("elsewhere.zero.bias", 0.0, -0.3, 0.3)  # of another stage: it changes nothing


class Gauge:
    """Base of a view; a subclass sets `acts` and the stamps and measurements, and defines `_predict`."""

    stage, unit, channels = "stage", "-", ("reading",)
    regimes, features, own_nuisances, echoes = {}, {}, {}, frozenset()
    noise = np.zeros(1)

    def _stamp(self, trials, rate_hz, length_s):
        """Set the stamps of trials of one length, s; return those of one trial."""
        t = np.arange(round(rate_hz * length_s)) / rate_hz
        self.t_s, self.trial = np.tile(t, trials), np.repeat(np.arange(trials), len(t))
        return t

    def _measure(self, truth, noise, seed=0):
        """Set the measurements of a gauge with these parameters, under noise as large as its floor."""
        self.floor = np.array([noise])
        self.measured = (self._predict(truth) + noise * np.random.default_rng(seed).normal(size=len(self.t_s)))[:, None]

    def start_directions(self):
        return None

    def gap(self, points):
        return np.stack([self.measured - self._predict(p)[:, None] for p in points]).astype(np.float32)


class Linear(Gauge):
    """Gauge whose reading is the sum of its parameters times their signals.

    A subclass sets `signals`, path -> signal, and `nominal`, path -> value where that is not 0.
    """

    signals, nominal = {}, {}

    @property
    def acts(self):
        return frozenset(self.signals)

    def _predict(self, point):
        return sum(point.get(path, self.nominal.get(path, 0.0)) * signal for path, signal in self.signals.items())


def candidate(path, low, high, size, *starts, nominal=0.0, **more):
    """Return an effect with one parameter, absent at nominal."""
    parameter = FittedParameter(path, "-", nominal, low, high, size, nominal, **more)
    return Candidate(path.rpartition(".")[0], "stage", (parameter,), tuple((start,) for start in starts))


def channel(trials, length, **more):
    """Return the part of a view that tests of residuals need: trials of one length and a floor of one."""
    number = np.arange(trials * length)
    stamps = 1 / 60 * (number % length)
    return SimpleNamespace(channels=("state",), floor=np.ones(1), trial=number // length, t_s=stamps, **more)


def search_in(view, effects, thresholds, nuisance=ELSEWHERE, kinds=("turns", "turns")):
    """Return the search for effects in a view."""
    setup = Setup([view], (nuisance,), kinds)
    return Search(setup.weighed(), setup.plain(), ("stage",), effects, thresholds)
