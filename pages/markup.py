"""HTML and SVG as values: every text is escaped here, once."""

import math
import re
from base64 import b64encode
from collections.abc import Iterable
from html import escape

_UNIT = re.compile(r"(?<=\d) (?=(?:%|[kM]?Pa|m?s|mm?|mm?/s|rad|k?g|N|Hz)(?!\w))")
_VOID = frozenset({"br", "meta", "input", "img", "circle", "line", "path", "rect"})

# A dotted name within a sentence (stage.effect, perhaps with its parameter); no file's name.
_FILE = r"[\w.]*\.(?:csv|html|json|mat|mcap|parquet|py|yaml)\b"
_NAME = re.compile(rf"(?<![\w./-])(?!{_FILE})[a-z][a-z0-9_]{{2,}}(?:\.[a-z][a-z0-9_]+){{1,2}}\b")


_BROAD = 4  # columns: from here on a table is broader than a phone


class Html(str):
    """Markup that is safe to put into a page as it is."""

    __slots__ = ()


Child = Html | str


def el(tag: str, *children: Child, **attributes: object) -> Html:
    """An element. Children that are no Html are text and get escaped; an attribute of None is left out.

    `class_` is class, `stroke_width` is stroke-width.
    """
    given = "".join(
        f' {name.rstrip("_").replace("_", "-")}="{escape(str(value))}"'
        for name, value in attributes.items()
        if value is not None
    )
    if tag in _VOID and not children:
        return Html(f"<{tag}{given}/>")
    return Html(f"<{tag}{given}>{join(children)}</{tag}>")


def join(children: Iterable[Child], between: str = "") -> Html:
    """Markup and texts, one after the other."""
    return Html(between.join(child if isinstance(child, Html) else escape(child) for child in children))


def prose(text: str) -> Html:
    """A sentence with the dotted names in it set as code, and no line break between a number and its unit."""
    text = _UNIT.sub("\N{NO-BREAK SPACE}", text)
    parts: list[Child] = []
    end = 0
    for found in _NAME.finditer(text):
        parts += [text[end : found.start()], el("code", found.group())]
        end = found.end()
    return join([*parts, text[end:]])


def table(head: Iterable[Child], rows: Iterable[Iterable[Child]], caption: str, numbers: Iterable[int] = ()) -> Html:
    """A table that scrolls sideways on a narrow screen, and says so. numbers: columns that align right, by index."""
    head, right = tuple(head), frozenset(numbers)

    def cell(i: int, child: Child, tag: str) -> Html:
        if tag == "td" and i == 0:
            return el("th", child, scope="row")
        return el(tag, child, class_="n" if i in right else None, scope="col" if tag == "th" else None)

    header = el("tr", *(cell(i, child, "th") for i, child in enumerate(head)))
    body = [el("tr", *(cell(i, child, "td") for i, child in enumerate(row))) for row in rows]
    whole = el("table", el("caption", caption), el("thead", header), el("tbody", *body))
    kind = "wide broad" if len(head) >= _BROAD else "wide"
    return el("div", whole, class_=kind, tabindex="0", role="region", aria_label=caption)


def shaded(share: float, content: Child) -> Html:
    """A number on a ground that is the stronger the larger its share (0 .. 1)."""
    return el("span", content, class_="shaded", style=f"--share:{min(1.0, max(0.0, share)):.3f}")


def bar(share: float, kind: str, text: str) -> Html:
    """A number with a bar of its share (0 .. 1, cut there; none where it is not known) beside it."""
    width = 100 * min(1.0, max(0.0, share)) if math.isfinite(share) else 0.0
    fill = el("span", class_=f"fill {kind}", style=f"width:{width:.1f}%")
    track = el("span", fill, class_="track", aria_hidden="true")
    return el("span", el("span", text, class_="num"), track, class_="bar")


def tiles(facts: Iterable[tuple[str, Child]]) -> Html:
    """The figures at the top of a page: (what it is, its value)."""
    return el("dl", *(el("div", el("dt", name), el("dd", value)) for name, value in facts), class_="figures")


def legend(*kinds: str) -> Html:
    """What the colours are."""
    items = (el("span", el("i", class_=f"key {kind}", aria_hidden="true"), kind, class_="entry") for kind in kinds)
    return el("p", *items, class_="legend")


def picture(png: bytes, text: str, kind: str | None = None) -> Html:
    """A PNG inside the page; `text` says what it shows to who cannot see it."""
    source = f"data:image/png;base64,{b64encode(png).decode('ascii')}"
    return el("figure", el("img", alt=text, src=source), class_=f"picture {kind}" if kind else "picture")
