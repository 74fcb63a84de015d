"""Replanning: it reaches, it keeps its time, and it knows where the arm is."""

import numpy as np
import pytest

from benchmarks import commands
from softarm.daemon.runtime.offline import Lockstep
from softarm.evaluation.runner import Runner
from softarm.policies.base import PolicyError
from softarm.policies.mppi import planner
from softarm.policies.mppi.estimator import Estimator, likely_joints, tip_from_cart_m
from softarm.policies.mppi.planner import cost
from softarm.policies.mppi.policy import Mppi
from softarm.policies.runner import InlineRunner
from softarm.schemas import flights
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal
from softarm.schemas.model import Model
from softarm.simulator.simulator import Simulator

HANGING = np.array([0, 0, 0, 0.5225, 0, 0, 0, 0], dtype=np.float32)
TARGET = np.array([-0.3, 0.65], dtype=np.float32)


class Clock:
    """Shows the next of some durations (ms) later at every look, the last one for ever."""

    def __init__(self, *durations_ms: float) -> None:
        self.now_ns = 0
        self.durations_ms = list(durations_ms)

    def __call__(self) -> int:
        step_ms = self.durations_ms.pop(0) if len(self.durations_ms) > 1 else self.durations_ms[0]
        self.now_ns += round(step_ms * 1e6)
        return self.now_ns


@pytest.fixture(scope="module")
def flown():
    """A policy whose clock stands still, so that all rounds are flown on any machine, and its daemon."""
    policy = Mppi(clock=Clock(0.0))
    daemon = Lockstep(Config(), policy)
    daemon.arm()
    return policy, daemon


class TestFlights:
    def test_a_high_target_is_reached_within_the_rail(self, flown):
        flight = flown[1].fly(Goal("reach", -0.3, 0.8), 0.1)
        assert flight.status.state == "reached"
        assert flight.max_cart_m <= 0.25

    def test_new_goals_in_mid_swing_are_reached(self, flown):
        _, daemon = flown
        daemon.place(0.0)
        reached = []
        for goal in (Goal("reach", 0.1, 0.6), Goal("reach", -0.25, 0.7)):
            for _ in range(10):
                daemon.tick(daemon.request("goal", Goal("reach", -0.4, 0.85)))  # each begins again, none is reached
            outputs = daemon.tick(daemon.request("goal", goal))
            assert (
                max(abs(outputs.observed.values.tip_vy_m_s), abs(outputs.observed.values.tip_vz_m_s)) > 0.05
            )  # it does swing
            while outputs.goal.state == "running":
                outputs = daemon.tick()
            reached.append(outputs.goal.state)
        assert reached == ["reached"] * 2

    def test_flights_are_repeatable(self, flown):
        """A reset forgets everything, and the sampling is seeded."""
        policy, _ = flown
        flights = []
        for _ in range(2):
            policy.reset()
            flights.append([policy.step(HANGING, TARGET) for _ in range(5)])
            policy.step(HANGING + np.float32(0.01), TARGET)
        np.testing.assert_array_equal(*flights)
        assert np.ptp(flights[0], axis=0).max() > 0

    def test_an_invalid_observation_is_a_fault_of_one_step(self, flown):
        policy, _ = flown
        runner = InlineRunner(policy)
        assert runner.step(HANGING, TARGET).fault is None
        broken = HANGING.copy()
        broken[3] = np.nan
        assert "tip_z is nan" in runner.step(broken, TARGET).fault
        assert "target_y is nan" in runner.step(HANGING, np.full(2, np.nan, np.float32)).fault
        assert runner.step(HANGING, TARGET).fault is None


class TestShelf:
    def test_plans_touch_the_shelf_and_reach_into_it(self):
        """Without the shelf in its plans the policy flies against a board."""
        scenario = flights.shelf()[4]
        reached = [
            Runner(Mppi(rounds=2, target_depth_m=depth_m, clock=Clock(0.0))).fly(scenario).status.state
            for depth_m in (None, scenario.depth_m)
        ]
        assert reached == ["failed", "reached"]

    def test_the_spec_has_the_depth(self):
        assert Mppi.describe(target_depth_m=0.05, rounds=2).shelf_depth_m == 0.05
        assert Mppi.describe().shelf_depth_m is None
        with pytest.raises(PolicyError, match="target_depth_m is inf"):
            Mppi.describe(target_depth_m=float("inf"))


class TestBudget:
    def test_with_time_every_round_is_flown(self):
        policy = Mppi(rounds=4, rollouts=64, budget_s=0.012, clock=Clock(0.0))
        policy.step(HANGING, TARGET)
        assert policy.rounds_flown == 4

    @pytest.mark.parametrize("round_ms", [2.0, 3.0, 5.9])
    def test_no_round_begins_that_would_exceed_the_budget(self, round_ms):
        clock = Clock(round_ms)
        policy = Mppi(rounds=100, rollouts=64, budget_s=0.012, clock=clock)
        for _ in range(3):
            start_ns = clock.now_ns + round(round_ms * 1e6)  # the step's first look
            policy.step(HANGING, TARGET)
            assert policy.rounds_flown > 0
            assert clock.now_ns - start_ns <= 12_000_000

    def test_without_time_the_current_plan_is_flown(self):
        clock = Clock(0.0)
        policy = Mppi(rollouts=64, clock=clock)
        policy.step(HANGING, TARGET)
        planned = policy.planned()
        clock.durations_ms = [13.0]
        for step in (1, 2, 3):
            np.testing.assert_array_equal(policy.step(HANGING, TARGET), planned[step])
            assert policy.rounds_flown == 0
        assert np.ptp(planned, axis=0).max() > 0

    def test_a_hiccup_does_not_end_the_planning(self):
        clock = Clock(0.1)
        policy = Mppi(rollouts=64, clock=clock)
        policy.step(HANGING, TARGET)
        clock.durations_ms = [0.1, 0.1, 50.0, 0.1]  # the first round takes 50 ms
        policy.step(HANGING, TARGET)
        flown = []
        for _ in range(6):
            policy.step(HANGING, TARGET)
            flown.append(policy.rounds_flown)
        assert flown[0] == 0
        assert flown[-1] > 0


class TestEstimate:
    @staticmethod
    def follow(noise_m: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """Errors of tip (m) and link angles (rad), [ticks], of an estimate that begins in mid-swing."""
        random = np.random.default_rng(seed)
        velocity, pressure = commands.smooth(1, seed=seed)
        velocity = 0.3 * velocity[:, 0]
        robot, estimator = Simulator(physics_rate_hz=1200.0), Estimator(Model(), 1 / 30)
        before, speeds = np.zeros(3), []
        tips, angles = [], []
        for tick in range(80):
            here = np.array((robot.cart_position_m[0], *robot.tip_m()[0])) + noise_m * random.standard_normal(3)
            rates = (here - before) * 30
            before = here
            seen = np.array([here[0], rates[0], *here[1:], *rates[1:], velocity[tick - 1], robot.pressure_kpa[0]])
            if tick == 20:
                estimator.begin(seen)
            elif tick > 20:
                estimator.follow(seen, velocity[tick - 1], pressure[tick - 1, 0])
            if tick >= 20:
                tips.append(np.linalg.norm(estimator.tip_m() - robot.tip_m()[0]))
                angles.append(np.abs(estimator.simulator.link_angles_rad[0] - robot.link_angles_rad[0]).max())
            robot.step(velocity[tick], pressure[tick, 0])
            speeds.append(np.linalg.norm(robot.tip_velocity_m_s()))
        assert np.mean(speeds) > 0.1
        return np.array(tips), np.array(angles)

    @pytest.mark.parametrize("seed", range(2))
    @pytest.mark.parametrize(("noise_m", "tip_m", "angle_deg"), [(0.0, 2e-3, 0.5), (0.5e-3, 3e-3, 3.0)])
    def test_the_estimator_finds_the_hidden_state_despite_camera_noise(self, seed, noise_m, tip_m, angle_deg):
        """The model is that of the robot."""
        tips, angles = self.follow(noise_m, seed)
        assert tips.max() < tip_m
        assert angles[10:].max() < np.radians(angle_deg)

    def test_a_repeated_frame_does_not_change_the_estimate(self):
        estimator = Estimator(Model(), 1 / 30)
        start = HANGING.astype(float)
        estimator.begin(start)
        for _ in range(5):
            estimator.follow(start, 0.0, 10.0)
        assert estimator.distance_m(start) > 0.01  # the muscle has pulled, whatever the old frame shows

    @pytest.mark.parametrize("pressure", [0.0, 8.0, 20.0])
    def test_the_estimated_shape_has_the_observed_tip(self, pressure):
        arm = Model().arm
        for angles in np.random.default_rng(3).uniform(-0.4, 0.2, (20, 5)):
            tip = tip_from_cart_m(arm, angles)
            guessed, rates = likely_joints(arm, tip, np.array((0.3, 0.1)), pressure)
            assert np.linalg.norm(tip_from_cart_m(arm, guessed) - tip) < 0.01
            moved = (tip_from_cart_m(arm, guessed + 1e-4 * rates) - tip_from_cart_m(arm, guessed)) / 1e-4
            assert moved[0] == pytest.approx(0.3, abs=0.05)


class TestPlans:
    def test_every_command_is_within_the_range(self):
        random = np.random.default_rng(1)
        elites = planner.swings(random, 40, 16, 1 / 30)
        varied = planner.variations(random, elites, 200)
        for each, count in ((elites, 16), (varied, 200)):
            assert each.shape == (2, 40, count)
            assert np.abs(each).max() <= 1.0
        assert np.unique(varied[:, 20], axis=1).shape[1] > 150


class TestCost:
    @staticmethod
    def path(tip_y: list[float], cart: float = 0.0, velocity: float = 0.0) -> np.ndarray:
        steps = [[[cart], [velocity], [y], [0.6]] for y in tip_y]
        return np.array(steps, dtype=np.float32)

    def cost(self, *arguments, **keywords) -> float:
        return float(cost(self.path(*arguments, **keywords), np.array([0.0, 0.6], np.float32), 1 / 30)[0])

    def test_the_cost_prefers_near_then_early_and_late_over_missed(self):
        assert self.cost([0.2, 0.05]) < self.cost([0.2, 0.1])
        assert self.cost([0.0, 0.2]) < self.cost([0.2, 0.0])
        assert self.cost([0.2] * 38 + [0.02]) < self.cost([0.041] * 39)

    def test_a_cart_that_cannot_stop_on_the_rail_adds_cost(self):
        assert self.cost([0.0], cart=0.20, velocity=0.9) > 0.2
        assert self.cost([0.0], cart=0.20, velocity=-0.9) == self.cost([0.0])
        assert self.cost([0.0], cart=-0.249) > self.cost([0.0])

    def test_a_path_with_nan_has_infinite_cost(self):
        assert self.cost([0.0, np.nan]) == np.inf


class TestPlugin:
    @pytest.mark.parametrize(
        ("options", "said"),
        [({"rollouts": 10}, "rollouts is 10; allowed 64"), ({"budget_s": 0.1}, "budget_s"), ({"model": "sed"}, "seed")],
    )
    def test_an_invalid_option_is_named(self, options, said):
        with pytest.raises(PolicyError, match=said):
            Mppi(**options)
