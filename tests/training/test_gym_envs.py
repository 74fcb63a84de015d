"""The Gymnasium environments: Gymnasium's own checker, its conventions, and the tasks."""

from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

from softarm.schemas.policy import ACTION, OBSERVATION, SHELF_GOAL
from softarm.simulator.model_file import ModelFileError
from softarm.training import gym_envs

TASKS = ("Reach", "Shelf")


def one(task: str, **options):
    return gymnasium.make(f"softarm.training.gym_envs:SoftArm{task}-v0", **options).unwrapped


def many(task: str, robots: int, **options):
    return gymnasium.make_vec(
        f"softarm.training.gym_envs:SoftArm{task}-v0",
        num_envs=robots,
        vectorization_mode="vector_entry_point",
        **options,
    ).unwrapped


@pytest.mark.parametrize("task", TASKS)
def test_gymnasiums_checker_accepts_every_render_mode(task: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Warnings are errors here, and the window is drawn into memory."""
    monkeypatch.setenv("MPLBACKEND", "agg")
    env = one(task)
    assert env.metadata["render_modes"] == ["human", "rgb_array"]
    check_env(env)


def test_gymnasiums_checker_skips_the_window_without_a_display(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("MPLBACKEND", "DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    check_env(one("Reach"))
    with pytest.raises(RuntimeError, match=r"needs a display, and neither DISPLAY .* use render_mode='rgb_array'"):
        one("Reach", render_mode="human")


@pytest.mark.parametrize("task", TASKS)
def test_the_vector_environment_follows_its_spaces_and_gymnasiums_autoreset(task: str) -> None:
    robots = 40
    env = many(task, robots)
    assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    observation, info = env.reset(seed=1)
    assert info == {}
    ended = 0
    for _ in range(110):
        assert env.observation_space.contains(observation)
        actions = np.clip(env.np_random.normal(0.0, 0.5, (robots, 2)), -1.0, 1.0).astype(np.float32)
        before = observation
        observation, reward, terminated, truncated, info = env.step(actions)
        assert reward.shape == terminated.shape == truncated.shape == (robots,)
        assert np.isfinite(reward).all()
        over = terminated | truncated
        ended += over.sum()
        assert ("final_obs" in info) == over.any()
        if over.any():
            np.testing.assert_array_equal(info["_final_obs"], over)
            np.testing.assert_array_equal(info["final_info"]["_success"], over)
            assert all((last is not None) == done for last, done in zip(info["final_obs"], over, strict=True))
            for robot in np.flatnonzero(over):
                last = info["final_obs"][robot]
                assert env.single_observation_space.contains(last)
                np.testing.assert_array_equal(last[8:], before[robot, 8:])
                assert (observation[robot, 8:] != last[8:]).all()
                assert not observation[robot, [1, 4, 5, 6]].any()
    assert ended >= robots


@pytest.mark.parametrize("task", TASKS)
def test_single_and_vector_environments_give_the_same_robot(task: str) -> None:
    single, vector = one(task), many(task, 1)
    first, _ = single.reset(seed=7)
    np.testing.assert_array_equal(first, vector.reset(seed=7)[0][0])
    action = np.array([-0.3, 0.4], dtype=np.float32)
    for _ in range(100):
        seen, reward, terminated, truncated, info = single.step(action)
        row, rewards, terminations, truncations, infos = vector.step(action[None])
        assert (reward, terminated, truncated) == (rewards[0], terminations[0], truncations[0])
        if terminated or truncated:
            np.testing.assert_array_equal(seen, infos["final_obs"][0])
            assert info["success"] == infos["final_info"]["success"][0]
            return
        np.testing.assert_array_equal(seen, row[0])
    pytest.fail("no episode is longer than 100 steps")


@pytest.mark.parametrize(
    ("robots", "action", "kind", "text"),
    [
        ((), [0.0, 0.0], TypeError, "of type list; allowed is a float32 array of shape"),
        ((), np.zeros(2, np.int64), TypeError, "of type int64; allowed is a float32"),
        ((), np.zeros((1, 2)), ValueError, r"has the shape \(1, 2\); allowed is a float32 array of shape \(2,\)"),
        ((), np.array([np.nan, 0.0]), ValueError, r"the action is \[nan, 0.0\]; allowed is a float32 array"),
        ((3,), np.zeros(2), ValueError, r"has the shape \(2,\); allowed is a float32 array of shape \(3, 2\)"),
        ((2,), np.array([[0, 0], [np.nan, 0.0]]), ValueError, r"the action of robot 1 is \[nan, 0.0\]; allowed"),
    ],
)
def test_an_invalid_action_is_refused_with_the_reason_and_changes_nothing(robots, action, kind, text) -> None:
    env, untouched = ((many if robots else one)("Reach", *robots) for _ in range(2))
    env.reset(seed=5), untouched.reset(seed=5)
    with pytest.raises(kind, match=text):
        env.step(action)
    good = np.full((*robots, 2), 0.3, np.float32)
    np.testing.assert_array_equal(env.step(good)[0], untouched.step(good)[0])


def test_actions_of_double_precision_are_accepted_and_clipped() -> None:
    first, second = one("Reach"), one("Reach")
    first.reset(seed=5), second.reset(seed=5)
    seen = [env.step(action)[0] for env, action in ((first, np.array([1e300, -7.0])), (second, np.array([9.0, -9.0])))]
    np.testing.assert_array_equal(*seen)


def test_steps_before_a_reset_or_after_the_end_are_refused() -> None:
    still = np.zeros(2, np.float32)
    with pytest.raises(ResetNeeded, match="step before reset"):
        one("Reach").step(still)
    with pytest.raises(ResetNeeded, match="step before reset"):
        many("Reach", 2).step(np.zeros((2, 2), np.float32))
    env = one("Reach")
    env.reset(seed=0, options={"target_m": (0.6, 0.8)})  # never reached
    for step in range(100):
        _, _, terminated, truncated, _ = env.step(still)
        assert (terminated, truncated) == (False, step == 99)
    with pytest.raises(ResetNeeded, match=r"after the episode's end .* call reset\(\) first"):
        env.step(still)
    env.reset()
    env.step(still)


def test_next_step_autoreset_begins_an_episode_in_a_separate_step() -> None:
    """Like in SyncVectorEnv, the step after an episode's last observation only resets the robot."""
    env = many("Reach", 6, autoreset_mode="NextStep")
    assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    observation, _ = env.reset(seed=2)
    over, ended = np.zeros(6, np.bool_), 0
    for _ in range(204):
        actions = np.clip(env.np_random.normal(0.0, 0.5, (6, 2)), -1.0, 1.0).astype(np.float32)
        before = observation
        observation, reward, terminated, truncated, info = env.step(actions)
        assert env.observation_space.contains(observation)
        assert "final_obs" not in info
        same_goal = (observation[:, 8:] == before[:, 8:]).all(axis=1)
        np.testing.assert_array_equal(same_goal, ~over)
        assert not reward[over].any()
        assert not (terminated | truncated)[over].any()
        assert not observation[over][:, [1, 4, 5]].any()  # at rest
        over = terminated | truncated
        np.testing.assert_array_equal(info["success"] & over, info["success"])
        ended += over.sum()
    assert ended >= 12


def test_gymnasiums_wrappers_accept_the_environment() -> None:
    made = "softarm.training.gym_envs:SoftArmReach-v0"
    wrapped = gymnasium.wrappers.vector
    fast = gymnasium.make_vec(made, num_envs=4, autoreset_mode="NextStep")
    assert isinstance(fast.unwrapped, gym_envs.ReachVectorEnv)  # the default of make_vec
    env = wrapped.ClipAction(wrapped.NormalizeObservation(wrapped.RecordEpisodeStatistics(fast)))
    env.reset(seed=1)
    episodes = 0
    for _ in range(110):
        *_, info = env.step(np.zeros((4, 2), np.float32))
        episodes += info["_episode"].sum() if "episode" in info else 0
    assert episodes >= 4
    with pytest.raises(ValueError, match="autoreset_mode is 'Disabled'; allowed: SameStep, NextStep"):
        many("Reach", 2, autoreset_mode=AutoresetMode.DISABLED)


def test_one_seed_determines_all_robots() -> None:
    env = many("Reach", 3)
    np.testing.assert_array_equal(env.reset(seed=4)[0], many("Reach", 3).reset(seed=4)[0])
    first, again, drawn = (env.reset(seed=seed)[0] for seed in (4, 4, None))
    np.testing.assert_array_equal(first, again)
    assert (drawn[:, 8:] != first[:, 8:]).all()
    for seed in ([1, 2, 3], np.int64(3)):
        with pytest.raises(TypeError, match=r"the seed is a .*; allowed is one Python integer"):
            env.reset(seed=seed)


@pytest.mark.parametrize(
    ("argument", "text"),
    [
        ({"task": 3}, "task is 3; allowed is a ReachTask or its name"),
        ({"task": 0}, "task is 0; allowed is a ReachTask or its name"),
        ({"model": 3}, "model is 3; allowed is a Model, a file or a shipped name"),
    ],
)
def test_a_task_or_model_of_another_type_is_refused(argument: dict[str, object], text: str) -> None:
    with pytest.raises(TypeError, match=text):
        gym_envs.ReachEnv(**argument)


def test_the_goal_can_be_set_by_options() -> None:
    observation, _ = one("Reach").reset(options={"target_m": (-0.2, 0.6)})
    np.testing.assert_allclose(observation[8:], (-0.2, 0.6), rtol=1e-6)
    observation, _ = many("Shelf", 3).reset(options={"target_m": (-0.48, 0.63), "depth_m": (0.0, 0.1, 0.2)})
    np.testing.assert_allclose(observation[:, 8:], [(-0.48, 0.63, depth) for depth in (0.0, 0.1, 0.2)], rtol=1e-6)
    with pytest.raises(ValueError, match="unknown option depth_m; this task takes target_m"):
        one("Reach").reset(options={"depth_m": 0.1})
    with pytest.raises(ValueError, match=r"target_m is \(5, 0.6\); give something within"):
        one("Reach").reset(options={"target_m": (5, 0.6)})
    for value in ((0, 0.6, 1), "ab"):
        with pytest.raises(ValueError, match=r"target_m is .*; give numbers of the shape \(2,\) or \(1, 2\)"):
            one("Reach").reset(options={"target_m": value})


def test_the_model_can_be_a_shipped_name() -> None:
    """Without rail.delay the cart answers within the first step."""
    moved = []
    for name in ("seed", "no-delay"):
        env = one("Reach", model=name)
        env.reset(seed=1)
        observation, *_ = env.step(np.array([-1.0, -1.0], dtype=np.float32))
        moved.append(abs(observation[1]))
    assert moved[0] < 0.02 < moved[1]
    with pytest.raises(ModelFileError, match=r"did you mean no-delay\?"):
        one("Reach", model="no-dely")


def test_the_place_of_the_shelf_follows_the_target() -> None:
    """The arm swings towards -y; a board at its height stops it by the front edge, one out of reach does not."""

    def farthest_y_m(depth_m: float) -> float:
        env = one("Shelf")
        env.reset(seed=2, options={"target_m": (-0.6, 0.57), "depth_m": depth_m})
        return float(min(env.step(np.array([-0.3, 1.0], dtype=np.float32))[0][2] for _ in range(30)))

    assert farthest_y_m(-0.3) < -0.25
    assert farthest_y_m(0.45) > -0.2  # the edge is at -0.15 m


def test_the_page_names_every_signal_of_the_spaces_in_its_order_and_unit() -> None:
    page = (Path(__file__).parents[2] / "docs" / "training" / "gymnasium.md").read_text(encoding="utf-8")
    observed = page.partition("| | observation | unit |")[2].partition("\n\n")[0].splitlines()[2:]
    for k, signal in enumerate((*OBSERVATION, *SHELF_GOAL)):
        number, name, unit = (cell.strip() for cell in observed[k].strip("|").split("|"))
        assert (number, name.partition(",")[0], unit) == (str(k), signal.name, signal.unit)
    assert len(observed) == one("Shelf").observation_space.shape[0]
    acted = page.partition("| | action | -1 | +1 |")[2].partition("\n\n")[0].splitlines()[2:]
    for k, signal in enumerate(ACTION):
        assert acted[k] == f"| {k} | {signal.name} | {signal.low:g} {signal.unit} | {signal.high:g} {signal.unit} |"
