"""A view of one channel for tests of the engine, whose law is one line."""

import numpy as np


class Gauge:
    """Base of a view; a subclass sets `acts`, `t_s`, `trial`, `floor` and `measured`, and defines `_predict`."""

    stage, unit, channels = "stage", "-", ("reading",)
    regimes, features, own_nuisances, echoes = {}, {}, {}, frozenset()
    noise = np.zeros(1)

    def start_directions(self):
        return None

    def gap(self, points):
        return np.stack([self.measured - self._predict(p)[:, None] for p in points]).astype(np.float32)
