"""The API answers as its own schema says: the small part of `python -m softarm.benchmarks.prove.api`."""

import pytest

from softarm.benchmarks.prove import api


@pytest.mark.slow
def test_every_answer_is_one_that_the_schema_names():
    pytest.importorskip("schemathesis")
    held, said = api.run(examples=4, seed=0)
    assert held, said
