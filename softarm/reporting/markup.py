"""Builder of HTML and SVG; it escapes every text exactly once."""

import math
import re
from base64 import b64encode
from collections.abc import Iterable
from html import escape

_UNIT = re.compile(r"(?<=\d) (?=(?:%|[kM]?Pa|m?s|mm?|mm?/s|rad|k?g|N|Hz)(?!\w))")
_VOID = frozenset({"br", "meta", "input", "img", "circle", "line", "path", "rect"})

# A dotted name within a sentence (stage.effect or stage.effect.parameter), but no file name.
_FILE = r"[\w.]*\.(?:csv|html|json|mat|mcap|parquet|py|yaml)\b"
_NAME = re.compile(rf"(?<![\w./-])(?!{_FILE})[a-z][a-z0-9_]{{2,}}(?:\.[a-z][a-z0-9_]+){{1,2}}\b")

# Number of columns from which a table is wider than a phone.
_BROAD = 4


class Html(str):
    """Markup that is safe to insert into a page unchanged."""

    __slots__ = ()


Child = Html | str


def el(tag: str, *children: Child, **attributes: object) -> Html:
    """Return an element; children that are not `Html` are escaped, and attributes that are None are omitted.

    `class_` becomes class, `stroke_width` becomes stroke-width.
    """
    given = "".join(
        f' {name.rstrip("_").replace("_", "-")}="{escape(str(value))}"'
        for name, value in attributes.items()
        if value is not None
    )
    if tag in _VOID and not children:
        return Html(f"<{tag}{given}/>")
    return Html(f"<{tag}{given}>{join(children)}</{tag}>")


def join(children: Iterable[Child]) -> Html:
    """Join markup and texts; texts are escaped."""
    return Html("".join(child if isinstance(child, Html) else escape(child) for child in children))


def prose(text: str) -> Html:
    """Return a sentence with dotted names as code and without line breaks between numbers and units."""
    text = _UNIT.sub("\N{NO-BREAK SPACE}", text)
    parts: list[Child] = []
    end = 0
    for found in _NAME.finditer(text):
        parts += [text[end : found.start()], el("code", found.group())]
        end = found.end()
    return join([*parts, text[end:]])


def table(head: Iterable[Child], rows: Iterable[Iterable[Child]], caption: str, numbers: Iterable[int] = ()) -> Html:
    """Return a table that scrolls sideways on a narrow screen; `numbers` are the indices of right-aligned columns."""
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
    """Return a number on a background whose strength is its share (0 .. 1)."""
    return el("span", content, class_="shaded", style=f"--share:{min(1.0, max(0.0, share)):.3f}")


def bar(share: float, kind: str, text: str) -> Html:
    """Return a number with a bar of its share, limited to 0 .. 1; NaN gives an empty bar."""
    width = 100 * min(1.0, max(0.0, share)) if math.isfinite(share) else 0.0
    fill = el("span", class_=f"fill {kind}", style=f"width:{width:.1f}%")
    track = el("span", fill, class_="track", aria_hidden="true")
    return el("span", el("span", text, class_="num"), track, class_="bar")


def tiles(facts: Iterable[tuple[str, Child]]) -> Html:
    """Return the key figures at the top of a page, given as (name, value)."""
    return el("dl", *(el("div", el("dt", name), el("dd", value)) for name, value in facts), class_="figures")


def legend(*kinds: str) -> Html:
    """Return a legend of the colours."""
    items = (el("span", el("i", class_=f"key {kind}", aria_hidden="true"), kind, class_="entry") for kind in kinds)
    return el("p", *items, class_="legend")


def picture(png: bytes, text: str, kind: str | None = None) -> Html:
    """Return an embedded PNG; `text` describes it for screen readers."""
    source = f"data:image/png;base64,{b64encode(png).decode('ascii')}"
    return el("figure", el("img", alt=text, src=source), class_=f"picture {kind}" if kind else "picture")
