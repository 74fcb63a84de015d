"""Mutants of the safety code: a test detects each, or the list explains why none is needed."""

import pytest

from validation.mutants.__main__ import explanations, prove
from validation.mutants.operators import mutants
from validation.mutants.targets import TARGETS

# Its tests need neither sockets nor a clock.
SMOKE = "daemon/control/following.py"


@pytest.mark.parametrize("module", TARGETS)
def test_every_explained_mutant_still_exists(module):
    keys = [mutant.key for mutant in mutants(TARGETS[module].source)]
    assert len(set(keys)) == len(keys)
    assert explanations().get(module, {}).keys() <= set(keys)


# Over 3 s: the tests of a module run three times, in processes of their own.
@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_sample_of_mutants_is_killed_or_explained():
    found = prove(TARGETS[SMOKE], jobs=1, sample=1)
    assert found.figures["tried"] == 1
    assert found.unexplained == []
