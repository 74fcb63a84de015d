"""Flights by the daemon's own tick: the same for every policy and robot, whatever became of the flight before."""

import numpy as np

from softarm.evaluation.robots import ROBOTS
from softarm.evaluation.runner import Runner, fly
from softarm.policies import registry
from softarm.policies.base import PolicyError
from softarm.policies.pid import Pid
from softarm.schemas import flights
from softarm.schemas.flights import Scenario
from softarm.schemas.goals import Goal


def test_a_planner_flies_a_robot_unlike_its_model():
    (flight,) = fly(registry.load("mppi"), ROBOTS["nominal"], [Scenario(Goal("reach", -0.2, 0.6), 0.1)])
    assert flight.reached


def test_a_shelf_policy_gets_the_depth_and_the_shelf_is_simulated():
    reported = []

    class Deep(Pid):
        target_depth_m = 0.03

        def step(self, observation, goal):
            reported.append(self.target_depth_m)
            return super().step(observation, goal)

    runner, goal = Runner(Deep()), Goal("reach", -0.45, 0.6)
    assert not runner.fly(Scenario(goal, 0.1, depth_m=0.07)).reached
    assert set(reported) == {0.07}
    reported.clear()
    runner.fly(Scenario(goal, 0.1))
    assert set(reported) == {Deep.target_depth_m}  # its own, not what the last scenario left


def test_a_shelf_exists_only_in_its_scenario():
    goal, shipped = Goal("reach", -0.35, 0.6), registry.load("reach-wide")
    at_shelf, free = Scenario(goal, 0.1, depth_m=0.2), Scenario(goal, 0.1)
    (alone,) = fly(shipped, None, [free])
    behind, after = fly(shipped, None, [at_shelf, free])
    assert alone.reached
    assert not behind.reached
    assert after == alone


def test_a_refusal_is_recorded_and_the_next_scenario_flies():
    class Picky(Pid):
        def step(self, observation, goal):
            if goal[0] < -0.3:
                raise PolicyError("no plan from here: too far")
            return super().step(observation, goal)

    refused = Scenario(Goal("reach", -0.4, 0.6), 0.0)
    easy = Scenario(Goal("reach", 0.0, 0.55), 0.0)  # PID moves its cart below it
    flights = fly(Picky(), None, [refused, easy, refused])
    assert [flight.refusal for flight in flights] == ["no plan from here: too far", None, "no plan from here: too far"]
    assert [flight.status.state for flight in flights][::2] == ["failed", "failed"]
    assert flights[1] == fly(Pid(), None, [easy])[0]


def test_goals_come_in_mid_swing_at_the_same_states_for_every_policy():
    begun = {}

    class Sees:
        def __init__(self, name):
            self.spec, self.seen = registry.load("pid").spec, begun.setdefault(name, [])

        def reset(self):
            self.fresh = True

        def step(self, observation, goal):
            if self.fresh:
                self.seen.append(np.array(observation))
            self.fresh = False
            return np.array([0.0 if self.seen is begun.get("one") else 1.0, 0.0], np.float32)

    for name in ("one", "two"):
        runner = Runner(Sees(name))
        for scenario in flights.swinging()[:4]:
            daemon = runner.begin(scenario)
            daemon.tick(daemon.request("goal", scenario.goal))
    assert np.array_equal(begun["one"], begun["two"])
    assert len(begun["one"]) == 4
    speeds = np.linalg.norm(np.array(begun["one"])[:, 4:6], axis=1)
    assert speeds.max() > 0.3  # of the tip: it swings
    assert np.ptp(np.array(begun["one"])[:, 0]) > 0.1  # carts are all along the rail
