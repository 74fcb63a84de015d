"""Films of one flight: which target, real time, and the size of the file."""

import io
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from softarm.evaluation import film
from softarm.evaluation.runner import load
from softarm.policies.base import PolicyError
from softarm.schemas.config import Config
from softarm.schemas.flights import SHELF_MIDDLE_M
from softarm.schemas.model import Model

pytestmark = pytest.mark.slow
CONFIG = Config()


def flown(policy, target_m=None, test="grid", config=CONFIG):
    return film.fly(load(policy), Model(), film.candidates(test, target_m, config), config)


def frames(gif):
    """Return the pictures of a GIF as RGB arrays, and their durations in ms."""
    image, shown, durations = Image.open(io.BytesIO(gif)), [], []
    for number in range(image.n_frames):
        image.seek(number)
        shown.append(np.asarray(image.convert("RGB")).astype(int))
        durations.append(image.info["duration"])
    return shown, durations


def test_the_highest_target_that_the_policy_reaches_is_shown_in_real_time():
    made = flown("reach")
    assert made.flight.reached
    assert (made.scenario.goal.y_m, made.scenario.goal.z_m, made.scenario.cart_start_m) == (-0.4, 0.8, 0.0)
    assert len(made.frames) == made.flight.ticks
    few = made._replace(frames=made.frames[::8])
    gif = film.encode("reach", few, Model(), CONFIG, ".gif")
    assert len(gif) < film.BYTES_MAX
    shown, durations = frames(gif)
    still_ticks = film.BEFORE_TICKS + film.AFTER_TICKS
    assert sum(durations) == pytest.approx(1000 * (len(few.frames) + still_ticks) / 30, abs=10)
    assert min(durations) >= 20  # browsers slow down shorter ones
    # Frame k shows tick k: the first and last also stand still.
    assert len(shown) == len(few.frames)
    assert (shown[0] != shown[len(shown) // 2]).any()


def test_a_target_is_flown_from_rest_and_may_be_missed():
    made = flown("reach", (0.0, 0.8))
    assert not made.flight.reached
    assert film.sentence("reach", made).startswith("film: reach, target y 0, z 0.8 m missed in 3.3 s, closest ")


def test_a_film_that_ends_with_a_stop_says_why():
    made = flown("reach", (0.0, 0.8))
    stopped = made._replace(flight=replace(made.flight, stop="the policy failed (boom)"))
    assert film.sentence("reach", stopped).endswith(" mm; the policy failed (boom)")


def test_a_policy_that_reaches_nothing_is_shown_at_the_first_target():
    config = Config.model_validate({"limits": {"rail": {"velocity_max_m_s": 0.02}}})
    wanted = film.candidates("grid", None, config)[:3]
    assert film.fly(load("reach", config), Model(), wanted, config).scenario == wanted[0]


def test_the_shelf_is_in_the_film_of_its_test():
    (wanted,) = film.candidates("shelf", (-0.45, 0.63), CONFIG)
    assert wanted.depth_m == SHELF_MIDDLE_M
    assert all(each.swing is None for each in film.candidates("swinging", None, CONFIG))


def test_what_cannot_be_shown_is_refused():
    with pytest.raises(PolicyError, match=r"no answer for the target \(-0\.43, 0\.6\)"):
        flown("trajectory", (-0.43, 0.6))
    longer = Config.model_validate({"goals": {"time_limit_s": 11}})
    with pytest.raises(ValueError, match="lasts 11 s; allowed up to 10 s"):
        flown("pid", (-0.4, 0.8), config=longer)


@pytest.fixture
def made(monkeypatch):
    """Return a flight that reaches its target, with every sixth frame, and shorten the still pictures."""
    monkeypatch.setattr(film, "BEFORE_TICKS", 3)
    monkeypatch.setattr(film, "AFTER_TICKS", 9)
    whole = flown("reach", (-0.3, 0.65))
    return whole._replace(frames=whole.frames[::6])


def test_a_large_gif_shows_fewer_pictures_in_the_same_time(made, monkeypatch):
    full = film.encode("reach", made, Model(), CONFIG, ".gif")
    monkeypatch.setattr(film, "BYTES_MAX", len(full) - 1)
    less = film.encode("reach", made, Model(), CONFIG, ".gif")
    assert len(less) < len(full)
    assert sum(frames(less)[1]) == pytest.approx(sum(frames(full)[1]), abs=70)
    monkeypatch.setattr(film, "BYTES_MAX", 1000)
    with pytest.raises(ValueError, match=r"allowed 0\.001 MB"):
        film.encode("reach", made, Model(), CONFIG, ".gif")


def test_ffmpeg_receives_every_picture(made, monkeypatch):
    calls = []

    def run(command, **options):
        calls.append((command, len(options["input"])))
        Path(command[-1]).write_bytes(b"film")
        return subprocess.CompletedProcess(command, len(calls) - 1, stderr=b"no\nno codec")

    monkeypatch.setattr(subprocess, "run", run)
    assert film.encode("reach", made, Model(), CONFIG, ".mp4") == b"film"
    pictures = len(made.frames) + film.BEFORE_TICKS + film.AFTER_TICKS
    assert calls[0][1] == pictures * 640 * 360 * 3
    assert "640x360" in calls[0][0]
    with pytest.raises(ValueError, match=r"ffmpeg failed: no codec; name a \.gif file"):
        film.encode("reach", made, Model(), CONFIG, ".mp4")


def test_a_missing_package_or_program_is_named(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"'matplotlib': pip install 'softarm\[train\]'"):
        film.check(Path("a.gif"))
