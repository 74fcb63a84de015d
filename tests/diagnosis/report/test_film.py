"""Drawing of a film: every robot moves in the plane of its motion."""

import re

import numpy as np
import pytest

from softarm.diagnosis.engine.result import Film
from softarm.diagnosis.report.film import drawing

T = np.arange(40) / 20


def swinging(plane, more=0.0):
    """Return a link of 1 m that swings to both sides in a plane, such as xz; more: amplitude, rad."""
    angle, lines = (0.5 + more) * np.sin(np.pi * T), np.zeros((len(T), 1, 2, 3))
    lines[:, 0, 1, "xyz".index(plane[0])] = np.sin(angle)
    lines[:, 0, 1, "xyz".index(plane[1])] = -np.cos(angle)
    return lines


def ends(html):
    """Return the moving end of the only link in each frame, [F, 2], in the drawing's units."""
    frames = re.search(r'values="([^"]*)"', html)[1].split(";")
    return np.array([[float(x) for x in frame.partition("L")[2].split()] for frame in frames])


@pytest.mark.parametrize("plane", ["xz", "yz", "xy"])
def test_the_drawing_shows_the_plane_of_the_deviation(plane):
    found = ends(drawing(Film("run-0", T, {"measured": swinging(plane), "nominal": swinging(plane, 0.1)}, 1.0)))
    assert len(found) == len(T)
    assert np.ptp(found, axis=0).max() > 100  # of 460
    assert (found > 0).all()
    assert (found < [460, 300]).all()


def test_wider_motion_without_a_deviation_is_seen_from_its_end():
    """A gantry moves along y by 1 m, and what hangs from it swings along x."""
    way = np.zeros((len(T), 1, 2, 3))
    way[..., 1] = T[:, None, None]
    lines = {"measured": swinging("xz") + way, "nominal": swinging("xz", 0.1) + way}
    found = ends(drawing(Film("run-0", T, lines, 1.0)))
    assert np.corrcoef(found[:, 0], swinging("xz")[:, 0, 1, 0])[0, 1] ** 2 == pytest.approx(1.0)


def test_the_caption_names_trial_time_and_enlargement():
    more = {"measured": 0.0, "nominal": 0.1, "patched": 0.01}
    lines = {kind: swinging("xz", angle) for kind, angle in more.items()}
    html = drawing(Film("run-0", T + 3.0, lines, 20.0))
    assert "run-0 from 3 s, at half speed; deviations enlarged 20 times" in html
    assert [f'class="curve {kind}"' in html for kind in more] == [True] * 3
    assert re.findall(r'href="#film-measured" class="([^"]*)"', html) == ["body", "curve measured"]
    assert 'dur="4s"' in html
