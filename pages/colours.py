"""The style sheet's colours on light paper, for pictures that it does not reach (PNGs)."""

import re
from importlib.resources import files

_STYLE = (files("softarm.pages") / "style.css").read_text(encoding="utf-8")
# Name -> `#rrggbb` of every plain colour of the first rule.
LIGHT = dict(re.findall(r"--(\w+): (#[0-9a-f]{6});", _STYLE.partition("}")[0]))
