"""The page: sections in order, style and script inside, nothing loaded from anywhere."""

import json
from collections.abc import Iterable
from pathlib import Path

from softarm.diagnosis.gap.result import Diagnosis
from softarm.diagnosis.report import evidence, overlays, sections
from softarm.diagnosis.report.markup import Html, el, join
from softarm.diagnosis.report.words import headline

_HERE = Path(__file__).parent
# Whatever a name or a story holds, the browser fetches nothing.
_POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:"

Story = Iterable[tuple[str, str]]


def write(diagnosis: Diagnosis, path: Path, *, story: Story = ()) -> None:
    """Write the report as one HTML file. story: further sections, (title, HTML). Raises OSError."""
    path.write_text(render(diagnosis, story=story), encoding="utf-8")


def render(diagnosis: Diagnosis, *, story: Story = ()) -> str:
    """The report as text; equal diagnoses give equal pages."""
    told: list[tuple[str, str, Html]] = [("Where in the chain", "chain", sections.chain(diagnosis))]
    told += [(title, f"story-{i}", Html(body)) for i, (title, body) in enumerate(story, 1)]
    told += [
        ("Measured, nominal, patched", "overlays", evidence.traces(diagnosis)),
        ("Frequencies and regimes", "frequencies", evidence.frequencies(diagnosis)),
        ("Rivals", "rivals", evidence.contenders(diagnosis)),
        ("What is left", "left", evidence.left(diagnosis)),
        ("The next experiment", "next", sections.next_step(diagnosis)),
        ("Details", "details", sections.details(diagnosis)),
        ("Method", "method", sections.method(diagnosis)),
    ]
    links = (el("a", title, href=f"#{anchor}") for title, anchor, _ in told)
    body = el(
        "body",
        el("header", el("p", "softarm diagnosis", class_="brand"), sections.result(diagnosis)),
        el("nav", *links, aria_label="sections"),
        el("main", *(el("section", el("h2", title), html, id=anchor) for title, anchor, html in told)),
        el("script", _data(diagnosis), type="application/json", id="data"),
        el("script", Html(_part("page.js"))),
    )
    head = el(
        "head",
        el("meta", charset="utf-8"),
        el("meta", name="viewport", content="width=device-width, initial-scale=1"),
        el("meta", name="color-scheme", content="light dark"),
        el("meta", http_equiv="Content-Security-Policy", content=_POLICY),
        el("title", f"{headline(diagnosis)} · softarm diagnosis"),
        el("style", Html(_part("page.css"))),
    )
    return "<!doctype html>\n" + join([el("html", head, body, lang="en")]) + "\n"


def _part(name: str) -> str:
    return (_HERE / name).read_text(encoding="utf-8")


def _data(diagnosis: Diagnosis) -> Html:
    """The overlays as JSON that cannot end its script element, whatever a trial is called."""
    text = json.dumps(overlays.packed(diagnosis), separators=(",", ":"), allow_nan=False)
    return Html(text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e"))
