"""A complete HTML page: head, sections with links, embedded style and script, no external resources."""

import json
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from typing import NamedTuple

from softarm.reporting.markup import Html, el, join

# Even if a text contains markup, the browser fetches nothing and runs no script on a page without one.
_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
_SCRIPTED = f"{_POLICY}; script-src 'unsafe-inline'"

_PLOTTER = ("shared/language.js", "shared/uPlot.iife.min.js", "shared/plotter.js")
_PLOT, _PLAYER = ("plot.js",), ("shared/arm.js", "player.js")


class Section(NamedTuple):
    """A section of the page with its own title."""

    title: str
    anchor: str
    body: Html
    folded: bool = False  # behind its title until the reader opens it


def document(
    title: str, maker: str, lead: Html, sections: Sequence[Section], plot: object = None, player: object = None
) -> str:
    """Return a page as text; equal contents give equal pages.

    Args:
        maker: Program that made the page, e.g. `softarm diagnosis`.
        lead: Heading (h1) and introduction.
        plot: Data for plot.js, of `softarm.reporting.plot.packed`.
        player: Data for player.js. Without plot and player, the page has no script.
    """
    script: tuple[Html, ...] = ()
    style = _parts("shared/colours.css", "style.css")
    if plot is not None or player is not None:
        data = el("script", _embedded(plot if player is None else player), type="application/json", id="data")
        script = data, el("script", _parts(*_PLOTTER, *(_PLOT if player is None else _PLAYER)))
        style = join([style, _parts("shared/uPlot.min.css", *(["player.css"] if player is not None else []))])
    links = (el("a", section.title, href=f"#{section.anchor}") for section in sections)
    body = el(
        "body",
        el("header", el("p", maker, class_="brand"), lead),
        el("nav", *links, aria_label="sections"),
        el("main", *map(_section, sections)),
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


def framed(page: str, title: str, height_px: int) -> Html:
    """Return a page of `document` as a frame inside another page, such as a notebook; its scripts see nothing else."""
    # Otherwise a link to a section would load the outer page into the frame.
    inner = page.replace("<head>", '<head><base href="about:srcdoc">', 1)
    style = f"width:100%;height:{height_px}px;border:0"
    return el("iframe", title=title, srcdoc=inner, sandbox="allow-scripts", style=style)


def _section(of: Section) -> Html:
    if not of.folded:
        return el("section", el("h2", of.title), of.body, id=of.anchor)
    body = el("div", of.body, id=of.anchor)  # inside, so that a link to it opens the section
    return el("section", el("details", el("summary", el("h2", of.title)), body), class_="folded")


@cache
def _parts(*names: str) -> Html:
    folder = files("softarm.reporting")
    return Html("\n".join((folder / name).read_text(encoding="utf-8") for name in names))


def _embedded(value: object) -> Html:
    """Return JSON in which no text can end the script element."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return Html(text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e"))
