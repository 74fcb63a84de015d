"""Drawing of a film: every robot moves within its frame."""

import re

import numpy as np
import pytest

from softarm.diagnosis.engine.result import Film
from softarm.diagnosis.report.film import drawing

T = np.arange(40) / 20


def swinging(more=0.0):
    """Return the outline of a rod of 1 m by 0.1 m that swings to both sides, [F, 1, 4, 2]; more: amplitude, rad."""
    angle = (0.5 + more) * np.sin(np.pi * T)
    along, across = np.stack((np.sin(angle), -np.cos(angle)), 1), np.stack((np.cos(angle), np.sin(angle)), 1)
    corners = ((0.0, -1), (1.0, -1), (1.0, 1), (0.0, 1))
    return np.stack([far * along + 0.05 * side * across for far, side in corners], axis=1)[:, None]


def frames(html):
    """Return the corners of the only outline in each frame, [F, 4, 2], in the drawing's units."""
    shown = re.search(r'values="([^"]*)"', html)[1].split(";")
    return np.array([re.findall(r"[\d.]+", frame) for frame in shown], float).reshape(len(shown), -1, 2)


def test_the_drawing_is_true_to_scale_and_fills_its_frame():
    found = frames(drawing(Film("run-0", T, {"measured": swinging(), "nominal": swinging(0.1)}, 1.0)))
    assert found.shape == (len(T), 4, 2)
    assert (found > 0).all()
    assert (found < [460, 300]).all()
    sides = np.linalg.norm(found - np.roll(found, 1, axis=1), axis=2)
    assert sides[:, 2] / sides[:, 1] == pytest.approx(0.1, abs=0.005)
    assert sides[:, 1].min() > 200  # of 300
    assert found[0, 1, 1] > found[0, 0, 1], "down is down"


def test_a_shape_that_is_smaller_than_a_pixel_is_left_out():
    both = np.concatenate((swinging(), 0.5 + 1e-6 * swinging()), axis=1)
    html = drawing(Film("run-0", T, {"measured": both, "nominal": both}, 1.0))
    assert "Z;" in html
    assert "ZZ" not in html
    assert frames(html).shape == (len(T), 4, 2)


def test_the_caption_names_trial_time_and_enlargement():
    more = {"measured": 0.0, "nominal": 0.1, "patched": 0.01}
    html = drawing(Film("run-0", T + 3.0, {kind: swinging(angle) for kind, angle in more.items()}, 20.0))
    assert "run-0 from 3 s, at half speed; deviations enlarged 20 times" in html
    shown = re.findall(r'<use href="#film-(\w+)" class="([^"]*)"', html)
    assert shown == [("measured", "body"), *((kind, f"outline {kind}") for kind in more)]
    assert all(f'id="film-{kind}"' in html for kind in (*more, "outline"))
    assert 'dur="4s"' in html
