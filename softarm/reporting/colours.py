"""The table of colours (`shared/colours.css`) for pictures that cannot use a style sheet."""

import re
from importlib.resources import files

_TABLE = (files("softarm.reporting") / "shared" / "colours.css").read_text(encoding="utf-8")


def _colours(rule: str) -> dict[str, str]:
    return dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6});", rule))


_DAY, _, _NIGHT = _TABLE.partition("@media")
# Name -> `#rrggbb`.
LIGHT, NIGHT = _colours(_DAY), _colours(_NIGHT)


def rgb(colour: str) -> tuple[float, float, float]:
    """Return red, green and blue of `#rrggbb`, each 0 to 1."""
    red, green, blue = (int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5))
    return red, green, blue


def on_any_ground(name: str) -> tuple[float, float, float]:
    """Return the mean of a colour's tones in both colour schemes, for viewers with an unknown background."""
    red, green, blue = ((a + b) / 2 for a, b in zip(rgb(LIGHT[name]), rgb(NIGHT[name]), strict=True))
    return red, green, blue
