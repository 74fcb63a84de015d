"""The examples of docs/policies/interface.md work as printed."""

import re
import sys
import types
from pathlib import Path

import numpy as np
import pytest

from softarm.policies.base import Policy
from softarm.policies.registry import available
from softarm.policies.runner import InlineRunner

PAGE = (Path(__file__).parents[2] / "docs/policies/interface.md").read_text(encoding="utf-8")


@pytest.fixture
def example(monkeypatch):
    module = types.ModuleType("policies_page")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    exec(re.search(r"```python\n(.*?)```", PAGE, re.DOTALL)[1], module.__dict__)
    return module.Wave


def test_the_runner_accepts_the_example_of_the_page(example):
    policy = example(speed_m_s=0.1, period_s=4.0)
    assert isinstance(policy, Policy)
    runner = InlineRunner(policy)
    velocities = []
    for _ in range(61):
        outcome = runner.step(np.zeros(8, np.float32), np.full(2, np.nan, np.float32))
        assert outcome.fault is None
        velocities.append(outcome.action[0])
    np.testing.assert_allclose([velocities[0], velocities[60]], [0.1, -0.1], atol=1e-6)  # half of 4 s


def test_the_page_lists_every_shipped_policy():
    for name in available():
        assert f"`{name}`" in PAGE
