"""Faults of robots, and the worst case of policies."""

from pathlib import Path

import pytest

from softarm.common.batch import Batch, Workers
from softarm.evaluation import faults
from softarm.evaluation.entries import Entry
from softarm.evaluation.robots import with_faults
from softarm.policies.base import MODELS
from softarm.reality.parameters import RobotParameters
from softarm.schemas.config import Config
from softarm.schemas.flights import CART_STARTS_M, Flight
from softarm.schemas.goals import GoalStatus


def test_faults_are_set_one_by_one():
    robot = with_faults(RobotParameters(), ["regulator.dead_time_s=0.06", "mocap.loose_link=2"])
    assert robot.regulator.dead_time_s == 0.06
    assert robot.mocap.loose_link == 2
    assert robot.rail == RobotParameters().rail


ENTRIES = [Entry("reach"), Entry("reach-robust")]


@pytest.fixture
def flown(monkeypatch):
    """Replace the flights: a weak rail costs every third target and stops the last flight; return the scenarios."""
    seen = []

    def fly(policy, robot, scenarios, config):
        seen.append(scenarios)
        weak = robot.rail.acceleration_m_s2 == 2
        states = ["failed" if weak and k % 3 == 0 else "reached" for k in range(len(scenarios))]
        stops = [*[None] * (len(states) - 1), "rail_outside" if weak else None]
        return [
            Flight(GoalStatus(state=state), 0.8, 0.1, 50, stop=stop) for state, stop in zip(states, stops, strict=True)
        ]

    monkeypatch.setattr(faults, "fly", fly)
    monkeypatch.setattr(faults, "load", lambda policy, config: None)
    return seen


def test_the_table_has_a_row_per_fault_and_the_worst(flown):
    found = faults.measure(ENTRIES, Workers(1), faults=("rail.acceleration_m_s2=2", "arm.damping=1"))
    assert list(found) == ["none", "rail.acceleration_m_s2=2", "arm.damping=1"]
    assert found["rail.acceleration_m_s2=2"]["reach"] == {"rest": 18 / 27, "swinging": 18 / 27, "stops": 2}
    head, rows = faults.lines(found)
    assert head == ("fault", "reach", "reach-robust")
    assert rows[0] == ("none", "100 / 100", "100 / 100")
    assert rows[1][1] == "67 / 67, 2 stops"
    assert rows[-1] == ("worst", "67", "67")


def test_every_second_target_is_flown_from_rest_and_in_mid_swing(flown):
    faults.measure(ENTRIES[:1], Workers(1), faults=())
    rest, swung = flown
    assert [each.goal for each in rest] == [each.goal for each in swung]
    assert len({each.goal for each in rest}) == 27
    assert {each.cart_start_m for each in rest} == set(CART_STARTS_M)
    assert all(each.swing is None for each in rest)
    assert all(each.swing is not None for each in swung)


def test_seeds_of_one_policy_have_columns_of_their_own(flown):
    seeds = [Entry("mine", seed, Path(f"seed-{seed}.onnx")) for seed in (1, 2)]
    found = faults.measure([*seeds, Entry("reach")], Workers(1), faults=())
    assert list(found["none"]) == ["mine, seed 1", "mine, seed 2", "reach"]
    assert len(flown) == 6


def test_the_files_of_the_configuration_travel_to_a_cluster(monkeypatch):
    seen, file = [], MODELS / "reach.onnx"
    config = Config.model_validate({"policies": {"mine": {"plugin": "onnx", "options": {"model": str(file)}}}})
    monkeypatch.setattr(faults, "run", lambda text, work, jobs, workers: seen.append(work) or Batch({}, {}))
    with pytest.raises(KeyError):  # no job has run
        faults.measure([Entry("mine")], config=config)
    assert list(seen[0].reads((Entry("mine"), "none"))) == [file]


def test_every_fault_is_one_of_the_independent_robot():
    for fault in faults.FAULTS:
        assert with_faults(RobotParameters(), [fault]) != RobotParameters()
