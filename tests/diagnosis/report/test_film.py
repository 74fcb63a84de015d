"""Drawing of a film: every robot moves in the plane of its motion."""

import re

import numpy as np
import pytest

from softarm.diagnosis.engine.result import Film
from softarm.diagnosis.report.film import drawing

T = np.arange(40) / 20


def swinging(plane):
    """Return a link of 1 m that swings to both sides in a plane, such as xz; its other end rests."""
    angle, lines = 0.5 * np.sin(np.pi * T), np.zeros((len(T), 1, 2, 3))
    lines[:, 0, 1, "xyz".index(plane[0])] = np.sin(angle)
    lines[:, 0, 1, "xyz".index(plane[1])] = -np.cos(angle)
    return lines


def ends(html):
    """Return the moving end of the only link in each frame, [F, 2], in the drawing's units."""
    frames = re.search(r'values="([^"]*)"', html)[1].split(";")
    return np.array([[float(x) for x in frame.partition("L")[2].split()] for frame in frames])


@pytest.mark.parametrize("plane", ["xz", "yz", "xy"])
def test_the_drawing_shows_the_plane_of_the_motion(plane):
    html = drawing(Film("run-0", T, {"measured": swinging(plane)}, 1.0))
    found = ends(html)
    assert len(found) == len(T)
    assert np.ptp(found, axis=0).max() > 100  # of 460
    assert (found > 0).all()
    assert (found < [460, 300]).all()


def test_the_caption_names_trial_time_and_enlargement():
    lines = {kind: swinging("xz") for kind in ("measured", "nominal", "patched")}
    html = drawing(Film("run-0", T + 3.0, lines, 20.0))
    assert "run-0 from 3 s, at half speed; deviations enlarged 20 times" in html
    assert [f'class="curve {kind}"' in html for kind in lines] == [True] * 3
    assert 'dur="4s"' in html
