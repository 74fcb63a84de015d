"""The drawing of the arm: smooth, tapered, and the same in pictures and in browsers."""

from importlib.resources import files

import numpy as np
import pytest

from softarm.reporting.arm import RADII_M, outline

BENT = np.array([[0.0, 0.96], [0.02, 0.87], [0.06, 0.79], [0.12, 0.72], [0.2, 0.68], [0.29, 0.66]])


def sides(points):
    """Return the two long sides of an outline, both from the cart to the tip."""
    count = 8 * (len(points) - 1) + 1
    drawn = outline(points)
    return drawn[:count], drawn[-count:][::-1]


def test_the_outline_passes_both_sides_of_every_point_and_tapers():
    left, right = sides(BENT)
    np.testing.assert_allclose(((left + right) / 2)[::8], BENT, atol=1e-12)
    widths = np.linalg.norm(left - right, axis=1)
    np.testing.assert_allclose(widths[[0, -1]] / 2, RADII_M)
    assert (np.diff(widths) < 0).all()


def test_the_sides_have_no_step_at_the_joints():
    for side in sides(BENT):
        strokes = np.diff(side, axis=0)
        turns = np.diff(np.unwrap(np.arctan2(strokes[:, 1], strokes[:, 0])))
        assert np.abs(turns).max() < 0.15


@pytest.mark.slow
def test_browsers_draw_the_same_outline(browser):
    page = browser.new_page()
    page.add_script_tag(content=(files("softarm.reporting") / "shared" / "arm.js").read_text())
    drawn = page.evaluate("(points) => armOutline(points, ARM_RADII_M)", BENT.tolist())
    page.close()
    np.testing.assert_allclose(drawn, outline(BENT), atol=1e-12)
