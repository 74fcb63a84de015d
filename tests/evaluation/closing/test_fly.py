"""The same goals for every policy, from rest and chained; stops are failures and are counted."""

from itertools import pairwise

import pytest

from softarm.evaluation.closing import fly
from softarm.evaluation.closing.fly import Replanning, at_rest, chains, fly_all, fly_chain
from softarm.evaluation.closing.outcomes import CHAINED, NEW, OLD, PATCHED, REPLANNED, REST
from softarm.evaluation.runner import Runner, load
from softarm.policies.base import MODELS
from softarm.schemas.config import Config, Failsafe
from softarm.schemas.flights import TEST_TARGETS, Scenario, Swing
from softarm.schemas.model import Model
from softarm.simulator import model_file
from tests.evaluation.closing import cases

REACH = MODELS / "reach.onnx"
EASY, NEVER = TEST_TARGETS[4], TEST_TARGETS[-1]  # (-0.20, 0.55), and (0, 0.80), which no command reaches


@pytest.fixture(autouse=True)
def one_process(monkeypatch):
    monkeypatch.setattr(fly, "cores", lambda: 1)


def with_effect(name, **values):
    return Model(effects=Model().effects | {name: values})


def test_chains_repeat_each_target_as_often_as_rest_and_never_in_a_row():
    chained, rest = chains(TEST_TARGETS), at_rest(TEST_TARGETS)
    assert chained == chains(TEST_TARGETS)
    goals = [scenario.goal for chain in chained for scenario in chain]
    assert sorted(goals, key=str) == sorted((scenario.goal for part in rest for scenario in part), key=str)
    assert len(chained) == 18
    assert all(one.goal != other.goal for chain in chained for one, other in pairwise(chain))
    swings = [scenario.swing for chain in chained for scenario in chain]
    assert len(set(swings)) == len(goals)  # another one each, where a stop makes it begin again


@pytest.mark.slow
def test_a_chain_continues_from_the_state_after_the_previous_goal():
    runner = Runner(load(REACH), Model())
    swing = Swing.draw(1)
    two = [Scenario(goal, swing.cart_start_m, swing=swing) for goal in (TEST_TARGETS[8], EASY)]
    chained, alone = fly_chain(runner, two), [fly_chain(runner, [scenario])[0] for scenario in two]
    assert chained[0] == alone[0]
    assert chained[1].ticks != alone[1].ticks  # not swung about again


@pytest.mark.slow
def test_after_a_stop_the_chain_continues_with_a_new_swinging_arm(monkeypatch):
    """A camera that the failsafe refuses: it stops the arm in every flight that moves for long enough."""
    config = Config(failsafe=Failsafe(mocap_late_max_s=0.03))
    runner = Runner(load(REACH), with_effect("mocap.latency", delay=0.09), config)
    begun, begin = [], runner.begin
    monkeypatch.setattr(runner, "begin", lambda scenario: begun.append(scenario) or begin(scenario))
    chain = chains(TEST_TARGETS)[0][:3]
    flown = fly_chain(runner, chain)
    stopped = [flight.stop is not None for flight in flown]
    assert begun == [chain[0], *(later for later, before in zip(chain[1:], stopped, strict=False) if before)]
    assert any(flight.stop is not None and "motion capture" in flight.stop for flight in flown)
    assert not any(flight.reached for flight in flown if flight.stop is not None)
    assert len(flown) == 3


@pytest.mark.slow
def test_a_camera_latency_of_46_ms_causes_no_stop():
    """A latched stop once ended 53 of 107 goals."""
    late = with_effect("mocap.latency", delay=0.046)
    targets = TEST_TARGETS[3:30:6]
    flown = fly_all({OLD: REACH}, {PATCHED: late}, [(OLD, PATCHED)], targets, Config())
    for manner in (REST, CHAINED):
        assert flown[OLD, PATCHED, manner].stops == (None,) * 15
        assert flown[OLD, PATCHED, manner].share > 0.7


@pytest.mark.slow
def test_every_policy_flies_the_same_scenarios_with_progress(tmp_path):
    model = with_effect("rail.delay", delay=0.06)
    file = tmp_path / "patched-model.yaml"
    model_file.save(model, file)
    policies, reported = {OLD: REACH, NEW: REACH, REPLANNED: cases.QuickReplanning(file)}, []
    pairs = [(name, PATCHED) for name in policies]
    robots, targets = {PATCHED: model}, (EASY, NEVER)
    flown = fly_all(policies, robots, pairs, targets, Config(), lambda *args: reported.append(args))
    assert set(flown) == {(name, PATCHED, manner) for name in policies for manner in (REST, CHAINED)}
    for manner in (REST, CHAINED):
        old, new, replanned = (flown[name, PATCHED, manner] for name in policies)
        assert old.reached.tolist() == new.reached.tolist()
        assert old.group.tolist() == replanned.group.tolist()
        assert replanned.reached.any()
        assert not any(old.stops)
    assert flown[OLD, PATCHED, REST].reached.tolist()[3:] == [False] * 3
    shares = [share for _, share in reported]
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, pytest.approx(1.0))
    # A replanned flight counts for more: the first half of the flights is not half of the work.
    assert shares[reported.index(next(each for each in reported if "12 of 36" in each[0]))] < 0.2


@pytest.mark.slow
def test_the_replanning_policy_plans_on_the_model_of_its_file(tmp_path):
    model = with_effect("rail.delay", delay=0.06)
    model_file.save(model, tmp_path / "patched-model.yaml")
    runner = Runner(Replanning(tmp_path / "patched-model.yaml").load(), model)
    (flown,) = fly_chain(runner, [Scenario(EASY, 0.0)])
    assert flown.reached
    assert flown.stop is None


@pytest.mark.prove
@pytest.mark.slow
def test_the_number_of_processes_does_not_change_the_flights(monkeypatch):
    robots, targets = {PATCHED: with_effect("rail.delay", delay=0.06)}, (EASY, NEVER)
    alone = fly_all({OLD: REACH}, robots, [(OLD, PATCHED)], targets, Config())
    monkeypatch.setattr(fly, "cores", lambda: 2)
    apart = fly_all({OLD: REACH}, robots, [(OLD, PATCHED)], targets, Config())
    for manner in (REST, CHAINED):
        assert alone[OLD, PATCHED, manner].reached.tolist() == apart[OLD, PATCHED, manner].reached.tolist()
