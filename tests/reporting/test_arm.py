"""The drawing of the arm and the table of colours are the same in pictures and in browsers."""

import json
import re
from importlib.resources import files

import numpy as np
import pytest

from softarm.recordings.foxglove.converter import layout
from softarm.reporting.arm import RADII_M, outline
from softarm.reporting.colours import LIGHT, on_any_ground

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


PACKAGE = files("softarm")
TABLE, LOGO = "reporting/shared/colours.css", "daemon/dashboard/icon.svg"
SOURCES = sorted(
    path.relative_to(PACKAGE).as_posix()
    for kind in ("py", "js", "css", "html", "json", "svg")
    for path in PACKAGE.rglob(f"*.{kind}")
    if not path.name.startswith("uPlot")
)
SIGNALS = {"requested", "sent", "measured", "simulated"}


def tinted(colour):
    """Return whether a hex colour is none of the greys, in which surfaces may differ."""
    digits = colour[1:] if len(colour) > 5 else "".join(digit * 2 for digit in colour[1:])
    parts = [int(digits[k : k + 2], 16) for k in (0, 2, 4)]
    return max(parts) - min(parts) > 12


def test_no_other_file_defines_a_colour():
    defined = {
        (path, colour)
        for path in SOURCES
        for colour in re.findall(r"(?<![&\w])#[0-9a-f]{3,8}\b", (PACKAGE / path).read_text())
        if len(colour) in (4, 5, 7, 9) and tinted(colour)
    }
    assert {path for path, _ in defined} == {TABLE, LOGO}


@pytest.mark.parametrize(
    "path", ["daemon/dashboard/view/chart.js", "reporting/player.js", "recordings/foxglove/layout.json"]
)
def test_every_chart_uses_the_same_word_and_colour_for_a_signal(path):
    text = (PACKAGE / path).read_text()
    if path.endswith("json"):
        pairs = re.findall(r'"label": "([^"]+)",[^}]*"color": "(\w+)"', text)
    else:
        pairs = re.findall(r'\["?[^\[\]]*?"(\w+)",(?: [^"\]]+,)? "(\w+)"', text)
    used = {word: colour for word, colour in pairs if word in SIGNALS or colour in SIGNALS - {"measured", "requested"}}
    assert used == {word: word for word in SIGNALS - {"simulated"}}


def test_the_foxglove_layout_has_the_tables_colours():
    allowed = {"#" + "".join(f"{round(255 * part):02x}" for part in on_any_ground(name)) for name in LIGHT}
    assert set(re.findall(r'"color": "(#?\w+)"', json.dumps(json.loads(layout()), indent=1))) <= allowed
