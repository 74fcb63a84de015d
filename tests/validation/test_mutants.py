"""Mutants of the safety code: a test detects each, or the list explains why none is needed."""

import pytest

from validation.mutants.__main__ import explanations
from validation.mutants.operators import mutants
from validation.mutants.targets import TARGETS


@pytest.mark.parametrize("module", TARGETS)
def test_every_explained_mutant_still_exists(module):
    keys = [mutant.key for mutant in mutants(TARGETS[module].source)]
    assert len(set(keys)) == len(keys)
    assert explanations().get(module, {}).keys() <= set(keys)
