"""Plans bring the tip onto their targets in the simulator and keep a margin to the limits."""

import numpy as np
import pytest

from softarm.policies.plans import Plans
from softarm.schemas.model import Model, seed_effects
from softarm.schemas.robot import PHYSICS_RATE_HZ
from softarm.training.task.reach import ReachTask
from softarm.training.trajectory import ceiling, planner, problem
from softarm.training.trajectory.optimiser import OUTER, UNIT, Batch, Optimiser
from softarm.training.trajectory.planner import library, nearest, plan, random_knots
from softarm.training.trajectory.problem import Rollouts

TARGETS = np.array([[-0.2, 0.6], [-0.3, 0.7], [0.0, 0.8]], dtype=np.float32)
REACHABLE = np.array([True, True, False])  # (0, 0.8): the rail is too short for any swing


@pytest.fixture(scope="module")
def small():
    """Fewer guesses than shipped: enough for these targets."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("softarm.training.trajectory.planner.LIBRARY", 512)
        patch.setattr("softarm.training.trajectory.planner.TRIES", 1)
        yield


@pytest.fixture(scope="module")
def report(small):
    return plan(TARGETS, (0.1,), seed=1)


@pytest.mark.slow
def test_reachable_targets_are_hit_and_others_are_reported_as_missed(report):
    np.testing.assert_array_equal(np.isfinite(report.reached_s), REACHABLE)
    np.testing.assert_array_equal(report.planned, REACHABLE)
    assert (report.plans.miss_m[REACHABLE] < 0.01).all()
    assert report.plans.miss_m[2] > 0.1  # 12.5 cm for a search without gradients, too
    assert (report.reached_s[:2] <= (report.plans.steps[:2] + 3) / 30 + 1e-6).all()


@pytest.mark.slow
def test_a_plan_has_the_same_tip_path_at_another_physics_rate(report):
    plans = report.plans
    for rate_hz, tolerance_m in ((PHYSICS_RATE_HZ, 1e-4), (4800.0, 2e-3)):
        flown = Rollouts(physics_rate_hz=rate_hz).fly(plans.command.transpose(1, 0, 2), plans.cart_start_m)
        for k in range(2):
            n = plans.steps[k]
            np.testing.assert_allclose(flown.tip_m[: n + 1, k], plans.tip_m[k, : n + 1], atol=tolerance_m)
            assert np.hypot(*(flown.tip_m[n, k] - TARGETS[k])) < ReachTask().success_radius_m


@pytest.mark.slow
def test_plans_keep_a_margin_to_the_limits(report):
    plans = report.plans
    flown = Rollouts(physics_rate_hz=PHYSICS_RATE_HZ).fly(plans.command.transpose(1, 0, 2), plans.cart_start_m)
    for k, n in enumerate(plans.steps):
        velocity, pressure = plans.command[k, :n].T
        assert np.abs(velocity).max() <= problem.VELOCITY_MAX_M_S + 1e-6
        assert problem.PRESSURE_MIN_KPA <= pressure.min() <= pressure.max() <= problem.PRESSURE_MAX_KPA
        assert np.abs(flown.state[: n + 1, k, 0]).max() <= ReachTask().rail_limit_m
    assert np.abs(plans.command[0, :, 0]).max() > 0.05  # it does move


def test_equal_seeds_give_equal_plans(small):
    one, two = (plan(TARGETS[:1], (0.0,), seed=3).plans for _ in range(2))
    np.testing.assert_array_equal(one.command, two.command)
    np.testing.assert_array_equal(one.steps, two.steps)


def test_a_plan_uses_the_effects_of_its_model(small, report):
    """On a robot with a longer delay a plan made for it hits; one made for the seed's robot does not."""
    effects = seed_effects() | {"rail.delay": {"delay": 0.1}}
    target = TARGETS[1:2]
    late = plan(target, (0.1,), Model(effects=effects), seed=1).plans
    usual = report.plans
    there = Rollouts(Model(effects=effects), physics_rate_hz=PHYSICS_RATE_HZ)

    def end_miss_m(plans: Plans, k: int) -> float:
        flown = there.fly(plans.command.transpose(1, 0, 2), plans.cart_start_m)
        return float(np.hypot(*(flown.tip_m[plans.steps[k], k] - target[0])))

    assert end_miss_m(usual, 1) > 0.02 > 0.01 > end_miss_m(late, 0)


@pytest.fixture(scope="module")
def optimiser():
    batch = Batch(TARGETS[:2], np.array([0.1, -0.2], dtype=np.float32), np.array([20, 26]))
    return Optimiser(Rollouts(), batch)


def test_the_gradient_equals_the_slope_of_the_merit(optimiser):
    """The slope is a central difference of the objective with every constraint."""
    knots = random_knots(2, np.random.default_rng(5))[:, : optimiser._knots] / UNIT
    knots = np.clip(knots, (-0.9, 0.1), (0.9, 1.9)).reshape(2, -1).astype(np.float32)
    penalty = np.full(2, 50.0, dtype=np.float32)
    terms = optimiser._terms(knots[None], optimiser._fly(knots[None]))
    # Both kinds of constraint take part.
    assert terms.ramp.max() > 0
    assert terms.rail.max() > 0
    multipliers = tuple(np.full_like(each[0], 0.3) for each in terms[1:])
    _, gradient = optimiser._model(knots, penalty, multipliers)
    step = np.float32(0.01)
    for unknown in range(0, knots.shape[1], 3):
        variants = np.repeat(knots[None], 2, axis=0)
        variants[0, :, unknown] += step
        variants[1, :, unknown] -= step
        merit = optimiser._merit(optimiser._terms(variants, optimiser._fly(variants)), penalty, multipliers)
        slope = (merit[0] - merit[1]) / (2 * step)
        # One-sided slopes of the robot, central ones of the merit: they differ by a curvature.
        np.testing.assert_allclose(gradient[:, unknown], slope, rtol=0.08, atol=0.02 * np.abs(gradient).max())


def test_a_finished_plan_leaves_its_batch_and_equals_a_plan_made_alone(monkeypatch):
    knots, steps = (each[0] for each in nearest(library(Rollouts(), 0.0, 512, np.random.default_rng(0)), TARGETS, 1))
    starts, left = np.zeros(3, dtype=np.float32), []
    narrow = Optimiser._narrow
    monkeypatch.setattr(Optimiser, "_narrow", lambda self, kept: (left.append(len(kept)), narrow(self, kept)))
    together = Optimiser(Rollouts(), Batch(TARGETS, starts, steps)).solve(knots)
    assert left[0] == 3
    assert left[-1] == 1  # the target out of reach is tried to the end
    assert len(left) == OUTER
    alone = Optimiser(Rollouts(), Batch(TARGETS[1:2], starts[:1], steps[1:2])).solve(knots[1:2])
    assert together.miss_m[1] < 0.003
    np.testing.assert_allclose(together.knots[1, : alone.knots.shape[1]] / UNIT, alone.knots[0] / UNIT, atol=1e-2)


def test_a_second_guess_replaces_a_plan_that_misses(small, monkeypatch):
    """The first guess of (-0.3, 0.7) is spoilt; the second one reaches."""
    spoilt = nearest(library(Rollouts(), 0.0, 512, np.random.default_rng(0)), TARGETS[1:2], 2)
    spoilt.knots[0], spoilt.steps[0] = 0.0, 12
    monkeypatch.setattr(planner, "nearest", lambda *_: spoilt)
    assert np.isnan(plan(TARGETS[1:2]).reached_s[0])
    monkeypatch.setattr(planner, "TRIES", 2)
    again = plan(TARGETS[1:2])
    assert np.isfinite(again.reached_s[0])
    assert again.plans.steps[0] == spoilt.steps[1, 0]


def test_search_and_planner_agree_on_reachable_targets(monkeypatch):
    for name, value in {"ROUNDS": 4, "POPULATION": 24, "ELITES": 4}.items():
        monkeypatch.setattr(ceiling, name, value)
    found = ceiling.search(TARGETS, 0.1, seed=1)
    np.testing.assert_array_equal(np.isfinite(found.reached_s), REACHABLE)
    assert 0.1 < found.closest_m[2] < 0.2


@pytest.mark.prove
def test_a_longer_rail_brings_a_missed_target_into_reach(monkeypatch):
    """(0, 0.75) needs about 0.33 m of rail on each side."""
    for name, value in {"ROUNDS": 6, "POPULATION": 48, "ELITES": 6}.items():
        monkeypatch.setattr(ceiling, name, value)
    monkeypatch.setattr(ceiling, "LEVELS", 1)
    monkeypatch.setattr(ceiling, "QUANTITIES", {name: ceiling.QUANTITIES[name] for name in ("rail half-length",)})
    (need,) = ceiling.of_missed(np.array([[-0.2, 0.6], [0.0, 0.75]], dtype=np.float32), seed=1)
    np.testing.assert_allclose(need.target_m, [0.0, 0.75])
    assert need.values == {"rail half-length": pytest.approx(0.41)}
    assert min(need.closest_m, need.closest_without_law_m) > 0.04


def test_bisection_halves_the_range_of_each_target_and_shares_searches():
    needed, searched = (1.3, 1.9, 5.0), []

    def reached(value, which):
        searched.append((value, which))
        return [value >= needed[i] for i in which]

    found = ceiling.bisected(1.0, 2.0, len(needed), reached)
    assert found == [pytest.approx(1.3, abs=1 / 32), pytest.approx(1.9, abs=1 / 32), None]
    assert all(value >= needed[i] for i, value in enumerate(found[:2]))
    assert searched[:2] == [(2.0, [0, 1, 2]), (1.5, [0, 1])]


def test_rows_of_plans_have_plain_values(report):
    found = planner.rows(report)
    assert [row["reached"] for row in found] == REACHABLE.tolist() == [row["planned"] for row in found]
    assert found[0] == pytest.approx({**found[0], "y": -0.2, "z": 0.6, "start": 0.1})
    assert found[2]["time_s"] is None
