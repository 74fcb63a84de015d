"""Rendering of the Gymnasium environments: the robot in pixels and in a window."""

import gymnasium
import numpy as np
import pytest

from softarm.training.gym_picture import SIZE


def made(task: str = "Reach", **options):
    return gymnasium.make(
        f"softarm.training.gym_envs:SoftArm{task}-v0", **{"render_mode": "rgb_array"} | options
    ).unwrapped


def pixel_of(y_m: float, z_m: float, travel_m: float = 0.3, base_m: float = 0.965, arm_m: float = 0.4445):
    """Row and column of a place, from the robot's own measures."""
    half = travel_m + arm_m + 0.06
    scale = SIZE[0] / (2 * half)
    return round(SIZE[1] - 1 - (z_m - (base_m - arm_m - 0.12)) * scale), round((y_m + half) * scale)


def around(frame: np.ndarray, place: tuple[int, int], pixels: int = 3) -> np.ndarray:
    row, column = place
    return frame[row - pixels : row + pixels + 1, column - pixels : column + pixels + 1].astype(int)


@pytest.mark.parametrize("task", ["Reach", "Shelf"])
def test_frames_have_the_documented_size_and_are_copies(task: str) -> None:
    env = made(task)
    env.reset(seed=1)
    first = env.render()
    kept = first.copy()
    for _ in range(10):
        env.step(np.array([1.0, 1.0], np.float32))
    second = env.render()
    assert first.shape == second.shape == (SIZE[1], SIZE[0], 3)
    assert first.dtype == np.uint8
    np.testing.assert_array_equal(first, kept)
    assert (first != second).any(axis=2).mean() > 0.01
    assert env.metadata["render_fps"] == 30


def test_tip_cart_and_target_are_drawn_at_their_observed_positions() -> None:
    env = made()
    observation, _ = env.reset(seed=1, options={"target_m": (-0.3, 0.6)})
    paper = env.render()[2, SIZE[0] // 2].astype(int)
    for target in ((-0.3, 0.6), (0.1, 0.7)):
        observation, _ = env.reset(seed=1, options={"target_m": target})
        frame = env.render()
        cart, tip = (observation[0], 0.965), observation[2:4]
        assert around(frame, pixel_of(*cart)).mean() < 60
        assert abs(around(frame, pixel_of(*tip)) - paper).max() > 100  # a black dot
        red, _, blue = around(frame, pixel_of(*target)).reshape(-1, 3).T
        assert (red - blue).max() > 100  # orange
        other = (0.1, 0.7) if target[0] < 0 else (-0.3, 0.6)
        red, _, blue = around(frame, pixel_of(*other)).reshape(-1, 3).T
        assert (red - blue).max() < 30


def test_the_shelf_is_drawn_at_its_place() -> None:
    env = made("Shelf")
    env.reset(seed=1, options={"target_m": (-0.42, 0.6), "depth_m": 0.1})
    frame = env.render()
    within, before = pixel_of(-0.34, 0.59), pixel_of(-0.28, 0.59)  # the edge is at -0.32 m, the top at 0.595
    assert around(frame, within, 1).mean() < around(frame, before, 1).mean() - 30


def test_a_window_shows_the_same_as_the_pixels(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MPLBACKEND", "agg")
    shown, env = made(render_mode="human"), made()
    shown.reset(seed=1), env.reset(seed=1)
    env.render()
    for _ in range(5):
        shown.step(np.array([1.0, 0.0], np.float32))
        env.step(np.array([1.0, 0.0], np.float32))
        frame = env.render()
    window = np.array(shown._window.picture.figure.canvas.buffer_rgba())[:, :, :3]
    np.testing.assert_array_equal(window, frame)
    assert shown.render() is None
    shown.close(), shown.close()


def test_unknown_render_modes_are_refused() -> None:
    from softarm.training.gym_envs import ReachEnv, ReachVectorEnv

    with pytest.raises(ValueError, match="render_mode is 'ansi'; allowed: human, rgb_array"):
        ReachEnv(render_mode="ansi")
    with pytest.raises(ValueError, match="render_mode is 'human'; allowed: rgb_array"):
        ReachVectorEnv(2, render_mode="human")


def test_rendering_before_a_reset_is_refused() -> None:
    with pytest.raises(gymnasium.error.ResetNeeded, match="render before reset"):
        made().render()
