"""Report of a run: a page with curves and tip paths, and what happens without TensorBoard."""

from base64 import b64encode
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from matplotlib.patches import Circle, FancyBboxPatch

from softarm import policies
from softarm.schemas import flights
from softarm.schemas.flights import grid
from softarm.schemas.model import Model
from softarm.training.learn import validation
from softarm.training.learn.inference import workers
from softarm.training.learn.ppo import PpoConfig
from softarm.training.record import curve
from softarm.training.record.checkpoint import TrainingConfig
from softarm.training.run import recipe, report, retrain
from softarm.training.run.session import Session
from softarm.training.task.reach import ReachTask, ShelfTask
from tests.cli.invoke import succeed

pytestmark = pytest.mark.slow

SMALL = TrainingConfig(seed=3, robots=16, validate_every=2, validation_trials=12)
FRAMES = 16 * 16
SHIPPED = Path(policies.__file__).parent / "models" / "reach.onnx"
RADIUS_M = ReachTask().success_radius_m


def session(out, pool, task=None):
    return Session(task or ReachTask(episode_steps=20), SMALL, PpoConfig(), out, pool, resume=False)


@cache
def flown():
    """Fly the shipped policy to every seventh target: most are reached, some missed."""
    prior = retrain.load_weights(SHIPPED)
    with workers(1) as pool:
        trials = validation.combined(grid(flights.TEST_TARGETS[::7]), Model().arm.links)
        outcome = validation.fly(prior.network, prior.task, trials, pool, physics_rate_hz=240.0)
    return validation.Tested(flights.shares(outcome.reached, trials.target_m[:, 1]), trials, outcome)


@pytest.mark.usefixtures("plain_pictures", "short_validation")
def test_training_without_tensorboard_continues_with_one_message(tmp_path, monkeypatch):
    monkeypatch.setattr(curve, "find_spec", lambda name: None)
    monkeypatch.setattr(report, "fly_test_trials", lambda session: flown())
    monkeypatch.setitem(recipe.RECIPES, "reach", recipe.RECIPES["reach"].model_copy(update={"frames": FRAMES}))
    result = succeed("train", "reach", "--robots", 16, "--frames", FRAMES, "--out", tmp_path)
    assert " ".join(result.output.split()).count("pip install tensorboard") == 1
    assert "tensorboard --logdir" not in result.output
    assert not (tmp_path / "tensorboard").exists()
    assert (tmp_path / "report.html").is_file()
    assert (tmp_path / "reach.onnx").is_file()


@pytest.mark.usefixtures("plain_pictures", "short_validation")
def test_a_training_that_is_too_short_says_so_and_is_not_evaluated(tmp_path, monkeypatch):
    monkeypatch.setattr(report, "fly_test_trials", lambda session: pytest.fail("evaluated"))
    result = succeed("train", "reach", "--robots", 16, "--minutes", 0.0001, "--out", tmp_path)
    *_, short, following = result.stdout.splitlines()
    assert short.startswith("0.00 M frames in 0.0 min")
    assert short.endswith("reach.onnx: too short to matter, so not evaluated; the least are 0.50 M frames")
    again = f"`softarm train reach --robots 16 --out {tmp_path} --resume`"
    assert following == f"next: {again} continues to the recipe's end"
    assert not (tmp_path / "report.html").exists()


def test_paths_of_successes_end_at_the_target():
    trials, outcome = flown().scenarios, flown().flown
    assert 5 < outcome.reached.sum() < 22, "trials that all end alike would prove nothing"
    np.testing.assert_allclose(outcome.tip_m[0, :, 0], trials.starts.cart_position_m, atol=1e-3)  # the arm hangs
    for trial, reached in enumerate(outcome.reached):
        path = outcome.tip_m[:, trial]
        flying = np.isfinite(path).all(axis=1)
        steps = round(float(outcome.time_s[trial]) * 30)
        assert flying.tolist() == [True] * (steps + 1) + [False] * (100 - steps)
        away = np.linalg.norm(path[1 : steps + 1] - trials.target_m[trial], axis=1)
        assert (away[-1] < RADIUS_M) == reached
        assert (away[:-1] >= RADIUS_M).all()
        assert away.min() == pytest.approx(outcome.closest_m[trial], abs=1e-6)


def test_the_picture_shows_every_trial_of_each_target():
    tested = flown()
    figure = report.draw(tested, ReachTask(), "reach, seed 1")
    assert len(figure.axes) == 8
    drawn = {line.get_gid(): line for axes in figure.axes for line in axes.get_lines() if line.get_gid()}
    assert drawn.keys() == {f"trial-{k}" for k in range(24)}
    for k, reached in enumerate(tested.flown.reached):
        line = drawn[f"trial-{k}"]
        assert line.get_color() == (report.REACHED if reached else report.MISSED)
        away = np.linalg.norm(line.get_xydata()[-1] - tested.scenarios.target_m[k])
        assert (away < RADIUS_M) == reached
    # Panels lie as the targets do, whatever order those have.
    places = [axes.get_position() for axes in figure.axes]
    centres = [next(p for p in axes.patches if isinstance(p, Circle)).get_center() for axes in figure.axes]
    for way, of in ((lambda place: place.x0, 0), (lambda place: place.y0, 1)):
        order = np.argsort([centre[of] for centre in centres], kind="stable")
        assert (np.diff([way(places[k]) for k in order]) >= -1e-9).all()
    words = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert any(word.startswith("in ") for word in words)
    assert any(word.endswith("cm away") for word in words)


def test_a_report_is_one_self_contained_file_also_without_a_folder_for_tensorboard(tmp_path, pool):
    (tmp_path / "tensorboard").write_text("in the way")
    run = session(tmp_path, pool)
    run.run(frames=2 * FRAMES, minutes=None)
    assert len(run.curve) == 2
    assert str(tmp_path / "tensorboard") in run.events.fault
    text = report.write(run, flown()).read_text()
    for picture in ("learning_curve.png", "tip_paths.png"):
        content = (tmp_path / picture).read_bytes()
        assert content.startswith(b"\x89PNG")
        assert f"data:image/png;base64,{b64encode(content).decode()}" in text
    assert "http://" not in text
    assert "https://" not in text
    assert "<script" not in text
    assert flown().report.sentence in text
    assert "<code>run.robots</code></th><td>16</td><td>2048</td>" in text
    assert "ppo." not in text  # as usual
    assert f"{run.best:.1%}" in text


@pytest.mark.prove
def test_the_shelf_is_drawn_with_its_boards(tmp_path, pool):
    run = session(tmp_path, pool, task=ShelfTask())
    run.run(frames=2 * FRAMES, minutes=None)
    trials = validation.combined(flights.shelf(), run.model.arm.links)
    tested = validation.Tested(
        validation.ShelfReport(0.5, 0.25), trials, validation.fly(run.average, run.task, trials, pool)
    )
    text = report.write(run, tested).read_text()
    assert "shelf, seed 3" in text
    assert text.count("data:image/png;base64,") == 2
    figure = report.draw(tested, run.task, run.title)
    assert len(figure.axes) == 4
    assert sum(len([line for line in axes.get_lines() if line.get_gid()]) for axes in figure.axes) == 12
    for axes, target, depth in zip(
        figure.axes, tested.scenarios.target_m[::3], tested.scenarios.depth_m[::3], strict=True
    ):
        boards = [patch.get_path().get_extents() for patch in axes.patches if isinstance(patch, FancyBboxPatch)]
        lower, upper = sorted(boards, key=lambda board: board.y0)
        assert lower.y1 == pytest.approx(target[1] - run.task.board_below_m, abs=1e-6)
        assert upper.y0 - lower.y1 == pytest.approx(0.2, abs=1e-6)
        assert lower.x1 == upper.x1 == pytest.approx(target[0] + depth, abs=1e-6)


def test_a_page_lists_only_settings_that_differ_from_the_default():
    usual = {"run.robots": 4096, "task.target_z_m": [0.55, 0.7], "randomise.each_episode": False}
    assert report.changed(usual, usual) == []
    given = usual | {"task.target_z_m": [0.55, 0.8], "randomise.each_episode": True}
    assert report.changed(given, usual) == [("task.target_z_m", "0.55 .. 0.8", "0.55 .. 0.7")]
    given |= {"randomise.ranges.arm.payload.mass": [0.0, 0.05]}
    assert ("randomise.ranges.arm.payload.mass", "0 .. 0.05", "") in report.changed(given, usual)
    assert ("randomise.each_episode", "True", "False") in report.changed(given, usual)
