"""The same draws for every policy, until the decision is clear; stops are failures and are counted."""

import numpy as np
import pytest

from softarm.evaluation.closing import fly
from softarm.evaluation.closing.fly import PART, Replanning, compare, draw, most
from softarm.evaluation.closing.outcomes import Flights
from softarm.evaluation.runner import Runner
from softarm.policies.base import MODELS
from softarm.schemas.config import Config
from softarm.schemas.flights import CART_STARTS_M, TEST_TARGETS, Scenario
from softarm.schemas.model import Model
from softarm.simulator import model_file

REACH = MODELS / "reach.onnx"
OTHER = MODELS / "reach-robust.onnx"


@pytest.fixture(autouse=True)
def one_process(monkeypatch):
    monkeypatch.setattr(fly, "cores", lambda: 1)


@pytest.fixture
def invented(monkeypatch):
    """Replace the flights: the new policy reaches every target, the old one every second; return the jobs."""
    flown = []

    def invent(job):
        flown.append(job)
        reached = np.ones(PART, dtype=bool) if job.is_new else np.arange(PART) % 2 == 0
        return Flights(reached, (None,) * PART, np.arange(PART))

    monkeypatch.setattr(fly, "_fly", invent)
    return flown


def with_effect(name, **values):
    return Model(effects=Model().effects | {name: values})


def test_draws_are_the_same_every_time_and_half_of_them_swing():
    drawn = [draw(number) for number in range(400)]
    assert drawn == [draw(number) for number in range(400)]
    assert len({each.goal for each in drawn}) == len(TEST_TARGETS)
    resting = [each for each in drawn if each.swing is None]
    assert {each.cart_start_m for each in resting} == set(CART_STARTS_M)
    assert 0.4 < len(resting) / len(drawn) < 0.6


def test_the_flights_end_when_one_policy_is_clearly_better(invented):
    reported = []
    old, new = compare(REACH, OTHER, Model(), Config(), 324, on_progress=lambda *args: reported.append(args))
    assert old.reached.size == new.reached.size == reported[-1][0] <= 60
    assert len(invented) == 2 * new.reached.size / PART


def test_known_flights_of_the_old_policy_are_not_repeated(invented):
    whole, new = compare(REACH, OTHER, Model(), Config(), 324)
    del invented[:]
    again = compare(REACH, OTHER, Model(), Config(), 324, known=whole)
    assert all(job.is_new for job in invented)
    assert again[1].reached.tolist() == new.reached.tolist()


def test_a_replanning_policy_flies_fewer_draws(tmp_path):
    assert (most(REACH, 324), most(Replanning(tmp_path / "a.yaml"), 324)) == (324, 108)
    assert most(REACH, 35) == 36


@pytest.mark.slow
def test_a_camera_latency_of_46_ms_causes_no_stop():
    """A latched stop once ended 53 of 107 goals."""
    found = fly.fly(REACH, with_effect("mocap.latency", delay=0.046), Config(), 6)
    assert found.stops == (None,) * 6
    assert found.share > 0.6


@pytest.mark.slow
def test_the_replanning_policy_plans_on_the_model_of_its_file(tmp_path):
    model = with_effect("rail.delay", delay=0.06)
    model_file.save(model, tmp_path / "patched-model.yaml")
    flown = Runner(Replanning(tmp_path / "patched-model.yaml").load(), model).fly(Scenario(TEST_TARGETS[4], 0.0))
    assert flown.reached
    assert flown.stop is None
