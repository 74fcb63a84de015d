"""The task with the effects of sensors and clock: what robots show, what they do, and exact resume."""

from dataclasses import replace

import numpy as np
import pytest

from softarm.schemas.model import Model
from softarm.simulator import model_file
from softarm.simulator.effects import REGISTRY, exemplars
from softarm.training.learn import validation
from softarm.training.learn.network import NetworkShape, PolicyNetwork
from softarm.training.run.recipe import ROBUST
from softarm.training.task.environment import ACTIONS, INPUTS, Environment, Randomisation, Step, environment_of
from softarm.training.task.reach import TASKS, ShelfTask
from tests.cli.invoke import invoke

REACH = TASKS["reach"]
EXACT = replace(REACH, rail_guard=False, action_noise=0.0)
ROBOTS = 16
FAR = np.tile(np.float32([[-0.2, 0.9]]), (ROBOTS, 1))
OURS = [name for name in REGISTRY if name.startswith(("mocap.", "clock.")) or name == "pressure.sensor_bias"]
TIP, RATES, SENT = slice(2, 4), [1, 4, 5], 6  # places in an observation


def model(effects: dict[str, dict[str, float]]) -> Model:
    """The seed's model with more effects."""
    return Model(effects=Model().effects | effects)


def strong() -> Model:
    """All effects of sensors and clock at their exemplars."""
    return model({name: exemplars()[name] for name in OURS})


def begin(model: Model | None = None, task=EXACT, targets=FAR) -> Environment:
    environment = Environment(task, len(targets), 0, model)
    environment.reset(validation.at_rest(np.zeros(len(targets)), 5), targets)
    return environment


def actions(steps: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(-1, 1, (steps, ROBOTS, 2)).astype(np.float32)


def fly(environment: Environment, steps: int = 20) -> list[Step]:
    return [environment.step(action) for action in actions(steps)]


def same(ours: list[Step], theirs: list[Step]) -> bool:
    return all(np.array_equal(a, b) for x, y in zip(ours, theirs, strict=True) for a, b in zip(x, y, strict=True))


@pytest.fixture(scope="module")
def plain() -> list[Step]:
    """Return the steps of robots without effects of sensors and clock."""
    return fly(begin())


@pytest.mark.parametrize("name", OURS)
def test_each_effect_changes_what_is_observed(name, plain):
    changed = fly(begin(model({name: exemplars()[name]})))
    assert any(not np.allclose(a.observation, b.observation, atol=1e-6) for a, b in zip(plain, changed, strict=True))


def test_a_dropout_repeats_the_last_observation():
    environment = begin(model({"mocap.dropout": {"share": 0.5}}))
    before, repeated = environment._observe(), 0
    for step, plain in zip(fly(environment), fly(begin()), strict=True):
        held = (step.observation[:, [0, 2, 3]] == before[:, [0, 2, 3]]).all(axis=1)
        assert not step.observation[np.ix_(held, RATES)].any()
        np.testing.assert_allclose(step.observation[~held, TIP], plain.observation[~held, TIP], atol=1e-6)
        before, repeated = step.observation, repeated + held.sum()
    assert 0.35 < repeated / (20 * ROBOTS) < 0.65


def test_a_displaced_frame_changes_the_observation_and_not_the_success():
    """Targets where the tip is, and where it is seen: the first are reached."""
    displaced = model({"mocap.offset": {"y": 0.08, "z": -0.05}, "mocap.rotation": {"angle": 0.1}})
    tip = np.array([0.0, 0.5225])
    turned = np.array([-np.sin(0.1), np.cos(0.1)]) * tip[1] + [0.08, -0.05]
    environment = begin(displaced, targets=np.float32([tip, turned]))
    np.testing.assert_allclose(environment._observe()[:, TIP], [turned, turned], atol=1e-5)
    vent = np.tile(np.float32([0.0, 2 * 0.7 / 20.7 - 1.0]), (2, 1))
    step = environment.step(vent)
    assert step.success.tolist() == [True, False]
    np.testing.assert_allclose(step.final_observation[0, TIP], turned, atol=5e-3)
    np.testing.assert_allclose(step.final_tip_m[0], tip, atol=5e-3)


@pytest.mark.parametrize("guard", [False, True])
def test_a_missed_tick_keeps_the_command(guard):
    environment = begin(model({"clock.missed_ticks": {"share": 0.5}}), replace(EXACT, rail_guard=guard))
    simulator, given = environment.simulator, []
    issue = simulator.step
    simulator.step = lambda velocity, pressure, *args, **more: (
        given.append(np.column_stack((velocity, pressure))),
        issue(velocity, pressure, *args, **more),
    )
    steps = fly(environment)
    last, kept = np.zeros((ROBOTS, 2)), 0
    for command, step in zip(given, steps, strict=True):
        held = (command == last).all(axis=1)
        assert ((command[:, 0] == last[:, 0]) == (command[:, 1] == last[:, 1])).all()  # both, or neither
        np.testing.assert_array_equal(step.final_observation[:, SENT], command[:, 0].astype(np.float32))
        over = step.terminated | step.truncated
        last, kept = np.where(over[:, None], 0.0, command), kept + held.sum()
        if over.any():  # begins with the pressure that it begins with
            last[over, 1] = simulator.pressure_kpa[over]
    assert 0.35 < kept / (20 * ROBOTS) < 0.65


def test_a_restart_clears_the_sensors_of_that_robot_alone():
    """Robot 0 reaches at once; what the others show does not depend on it."""
    distorted = model({"mocap.latency": {"delay": 0.05}, "mocap.offset": {"y": 0.01}})
    near = FAR.copy()
    near[0] = (0.0, 0.53)
    one, other = begin(distorted, targets=near), begin(distorted)
    restarts = 0
    for action in actions(12):
        ours, theirs = one.step(action), other.step(action)
        np.testing.assert_array_equal(ours.observation[1:], theirs.observation[1:])
        if ours.terminated[0] or ours.truncated[0]:
            restarts += 1
            pose = np.array([one.simulator.cart_position_m[0], *one.simulator.tip_m()[0]])
            np.testing.assert_allclose(ours.observation[0, [0, 2, 3]], pose + np.array([0.01, 0.01, 0.0]), atol=1e-6)
            assert not ours.observation[0, RATES].any()
    assert restarts >= 1


@pytest.mark.parametrize("model", [Model(), strong()])
def test_a_robot_with_nan_restarts_without_effect_on_others(model):
    environment = begin(model)
    environment.simulator.reset(robots=[2], pressure_kpa=np.nan)
    for step in fly(environment, 3):
        assert all(np.isfinite(values).all() for values in step)
        assert np.flatnonzero(step.terminated).tolist() in ([], [2])


@pytest.mark.parametrize(
    ("task", "model", "ranges"),
    [(REACH, Model(), {}), (REACH, strong(), {}), (REACH, Model(), ROBUST), (ShelfTask(), Model(), ROBUST)],
)
def test_a_snapshot_is_continued_bit_for_bit(task, model, ranges):
    robots = Randomisation(ranges, each_episode=True)
    one, two = (environment_of(task, ROBOTS, seed, model, randomisation=robots) for seed in (5, 99))
    one.reset()
    one.stagger()
    plan = actions(60)
    for action in plan[:30]:
        one.step(action)
    snapshot = one.snapshot()
    expected = [one.step(action) for action in plan[30:]]
    two.restore(snapshot)
    assert any((step.terminated | step.truncated).any() for step in expected)
    assert same([two.step(action) for action in plan[30:]], expected)


def test_the_closest_distance_of_a_trial_is_the_true_one(pool):
    network = PolicyNetwork(NetworkShape(INPUTS, ACTIONS))
    trials = validation.Scenarios(validation.at_rest(np.zeros(1), 5), np.float32([[0.0, 0.53]]))
    displaced = model({"mocap.offset": {"y": 0.1, "z": 0.1}})
    outcome = validation.fly(network, REACH, trials, pool, model=displaced)
    assert outcome.reached[0]
    assert outcome.closest_m[0] < REACH.success_radius_m


def test_the_command_takes_a_model_by_file_or_name(tmp_path, monkeypatch):
    given = []

    def session(*arguments):
        given.append(arguments)
        raise ValueError("enough")

    monkeypatch.setattr("softarm.training.run.recipe.Session", session)
    model_file.save(strong(), tmp_path / "blurred.yaml")
    for name in (str(tmp_path / "blurred.yaml"), "no-delay"):
        assert "enough" in invoke("train", "reach", "--model", name).output
    assert [each[6:8] for each in given] == [(strong(), "blurred"), (model_file.load("no-delay"), "no-delay")]
    assert [each[3].name for each in given] == ["reach-blurred-1", "reach-no-delay-1"]  # no run in another's folder
    result = invoke("train", "reach", "--model", "no-dely")
    assert result.exit_code == 1
    assert "did you mean no-delay?" in result.output
