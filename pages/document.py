"""A whole page: head, sections with their links, style and script inside, nothing loaded from anywhere."""

import json
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from typing import NamedTuple

from softarm.pages.markup import Html, el, join

# Whatever a name or a text holds, the browser fetches nothing, and where no script belongs it runs none.
_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
_SCRIPTED = f"{_POLICY}; script-src 'unsafe-inline'"


class Section(NamedTuple):
    """A part of the page with a title of its own."""

    title: str
    anchor: str
    body: Html


def document(
    title: str, maker: str, lead: Html, sections: Sequence[Section], plot: object = None, player: object = None
) -> str:
    """The page as text; equal contents give equal pages.

    maker: what made it, e.g. `softarm diagnosis`. lead: the h1 and what stands beneath it. plot: what plot.js draws,
    made by softarm.pages.plot.packed; player: what player.js plays; without either the page holds no script.
    """
    script: tuple[Html, ...] = ()
    style = _part("style.css")
    if plot is not None or player is not None:
        data = el("script", _embedded(plot if player is None else player), type="application/json", id="data")
        script = data, el("script", _part("plot.js" if player is None else "player.js"))
    if player is not None:
        style = join([style, _part("player.css")])
    links = (el("a", section.title, href=f"#{section.anchor}") for section in sections)
    body = el(
        "body",
        el("header", el("p", maker, class_="brand"), lead),
        el("nav", *links, aria_label="sections"),
        el("main", *(el("section", el("h2", one.title), one.body, id=one.anchor) for one in sections)),
        *script,
    )
    head = el(
        "head",
        el("meta", charset="utf-8"),
        el("meta", name="viewport", content="width=device-width, initial-scale=1"),
        el("meta", name="color-scheme", content="light dark"),
        el("meta", http_equiv="Content-Security-Policy", content=_SCRIPTED if script else _POLICY),
        el("title", f"{title} · {maker}"),
        el("style", style),
    )
    return "<!doctype html>\n" + join([el("html", head, body, lang="en")]) + "\n"


@cache
def _part(name: str) -> Html:
    return Html((files("softarm.pages") / name).read_text(encoding="utf-8"))


def _embedded(value: object) -> Html:
    """JSON that cannot end its script element, whatever it holds."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return Html(text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e"))
