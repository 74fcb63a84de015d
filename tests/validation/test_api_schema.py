"""The API's answers match its schema: a small run of `python -m validation.api`."""

import pytest

from validation import api


@pytest.mark.prove
def test_every_answer_is_one_that_the_schema_names():
    pytest.importorskip("schemathesis")
    held, said = api.run(examples=4, seed=0)
    assert held, said
