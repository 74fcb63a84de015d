"""A small run of the adversary against the filter alone."""

import numpy as np
import pytest

from softarm.schemas.config import RailLimits
from softarm.schemas.robot import RAIL_EXCURSION_M, RAIL_LIMIT_M
from validation import adversary_batch
from validation.adversary_batch import Batch, Genes, Policies, World, attack

NOMINAL = World(6.0, 1 / 30, 0.0, 0.0, 0.0, 1)
POOR = World(4.0, 0.08, 0.05, 0.12, 0.2, 3)  # slow, late, loaded, seen late, and ticks are skipped


@pytest.mark.slow
def test_no_policy_moves_the_cart_beyond_the_margin(monkeypatch):
    for name, fewer in (("GENERATIONS", 1), ("MEASURED_TICKS", 60), ("FLOWN_TICKS", 80)):
        monkeypatch.setattr(adversary_batch, name, fewer)
    assert attack(POOR, robots=48, seed=1)["beyond_m"] < RAIL_EXCURSION_M


def test_the_default_limits_hold_the_nominal_robot_against_the_worst_policy():
    """Bred by the search: with 3 m/s^2 to brake with it came 2 cm beyond."""
    robots, rng = 32, np.random.default_rng(0)
    genes = Genes(*(np.full(robots, each) for each in (1.15, 1.0, 0.43, 1.0, 0.38, 0.6)))
    genes = Genes(*(each + 0.02 * rng.standard_normal(robots) for each in genes))
    flown = Batch(NOMINAL, RailLimits(), Policies(robots, rng, genes), rng).fly(200)
    assert 0.22 < flown.farthest_m.max() < RAIL_LIMIT_M + RAIL_EXCURSION_M
    mild = Batch(NOMINAL, RailLimits(braking_m_s2=4.0, surge_m_s2=8.0), Policies(robots, rng, genes), rng).fly(200)
    assert mild.farthest_m.max() > RAIL_LIMIT_M + RAIL_EXCURSION_M
