"""Chained goals: drawing, counting, storing and resuming."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from softarm.daemon.control.workspace import refusals
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal
from validation import chained
from validation.chained import Cart, Leg, draw, fly, summary

CONFIG = Config()
GOAL = Goal("reach", -0.2, 0.6)


def leg(**changed: object) -> Leg:
    usual = {"reached": True, "trained": True, "max_cart_m": 0.1, "excursions": 0, "crashes": 0}
    return Leg(**{**usual, "stop": None, "events": [], "seconds": 1.0, **changed})


def test_goals_are_reproducible_and_allowed():
    drawn = [draw(CONFIG, 3, number) for number in range(50)]
    assert drawn == [draw(CONFIG, 3, number) for number in range(50)]
    assert len({(goal.y_m, goal.z_m) for goal in drawn}) == 50
    assert not any(refusals(goal, CONFIG) for goal in drawn)
    assert any(goal.y_m > 0.3 for goal in drawn)


def test_a_cart_beyond_its_bound_counts_once_until_it_is_back():
    cart = Cart(bound_m=0.255, travel_m=0.3)
    for place in (0.0, -0.256, -0.26, 0.25, 0.256, 0.3, 0.2999, 0.2, 0.3):
        cart.look(place)
    assert (cart.excursions, cart.crashes, cart.max_m) == (3, 2, 0.3)


def test_after_a_stop_a_new_arm_takes_the_next_goal_and_every_arm_is_put_away():
    stops, arms = iter(["late", None, None]), []

    class Arm:
        def __init__(self, number: int) -> None:
            self.flown, self.closed = [], False
            assert number == len(arms)
            arms.append(self)

        def fly(self, goal: Goal, trained: bool, last: bool) -> Leg:
            self.flown.append(last)
            return leg(stop=next(stops))

        def close(self) -> None:
            self.closed = True

    legs = []
    fly(Arm, [(GOAL, True)] * 3, legs.append)
    assert [arm.flown for arm in arms] == [[False], [False, True]]
    assert all(arm.closed for arm in arms)
    assert summary(legs)["stops"] == {"late": 1}


def test_the_summary_counts_what_happened():
    timing = {"steps": 10, "late_steps": 1, "stalls": 0, "paused_s": 0.0, "missed_ticks": 2, "max_late_s": 0.01}
    legs = [
        leg(max_cart_m=0.26, excursions=1, events=["rail_outside"], timing=timing),
        leg(reached=False, trained=False, crashes=1, events=["rail_outside"], timing={**timing, "max_late_s": 0.02}),
    ]
    found = summary(legs)
    assert {name: found[name] for name in ("goals", "reached", "trained_goals", "trained_reached")} == {
        "goals": 2,
        "reached": 1,
        "trained_goals": 1,
        "trained_reached": 1,
    }
    assert (found["max_cart_m"], found["excursions"], found["crashes"]) == (0.26, 1, 1)
    assert found["goals_with_event"] == {"rail_outside": 2}
    assert [incident["goal"] for incident in found["incidents"]] == [0, 1]
    assert found["timing"] == {**timing, "steps": 20, "late_steps": 2, "missed_ticks": 4, "max_late_s": 0.02}


@pytest.mark.slow
def test_an_interrupted_run_continues(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    file = tmp_path / "chained.json"
    part = tmp_path / "chained.json.part"
    arguments = ["--body", "simulated", "--policy", "pid", "--goals", "3", "--json", str(file)]

    def after_two(legs: list[Leg]) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(chained, "summary", after_two)
    assert CliRunner().invoke(chained.main, arguments).exit_code != 0
    lines = part.read_text().splitlines()
    assert len(lines) == 4
    part.write_text("\n".join(lines[:3]) + "\n")
    monkeypatch.undo()

    other = CliRunner().invoke(chained.main, [*arguments, "--seed", "1"])
    assert "belongs to another run" in other.output
    assert CliRunner().invoke(chained.main, arguments).exit_code == 0
    assert not part.exists()
    figures = json.loads(file.read_text())
    assert (figures["goals"], figures["body"], figures["stops"]) == (3, "simulated", {})
    assert figures["about"]["command"]


@pytest.mark.prove
@pytest.mark.realtime
def test_the_robot_from_outside_is_flown_over_the_wires(tmp_path: Path):
    file = tmp_path / "outside.json"
    arguments = ["--body", "outside", "--goals", "2", "--json", str(file)]
    done = CliRunner().invoke(chained.main, arguments)
    assert file.exists(), done.output
    figures = json.loads(file.read_text())
    assert (figures["goals"], figures["crashes"], figures["excursions"]) == (2, 0, 0)
    assert figures["max_cart_m"] > 0.02
    assert figures["timing"]["steps"] > 500
