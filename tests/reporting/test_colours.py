"""One table of colours for the dashboard, the reports, the log player and every picture."""

import json
import re
from importlib.resources import files

import pytest

from softarm.recordings.foxglove.export import layout
from softarm.reporting.colours import LIGHT, on_any_ground

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
