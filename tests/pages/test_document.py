"""The document: whole, one look, fetching nothing."""

import json
import re

from softarm.pages.colours import LIGHT
from softarm.pages.document import Section, document
from softarm.pages.markup import el

LEAD = el("h1", "Title")
SECTIONS = (Section("One <b>", "one", el("p", "a")), Section("Two", "two", el("p", "b")))


def test_a_page_has_its_sections_in_order_each_with_a_link():
    page = document("Title <i>", "softarm test", LEAD, SECTIONS)
    assert page.startswith('<!doctype html>\n<html lang="en">')
    assert "<title>Title &lt;i&gt; · softarm test</title>" in page
    assert re.findall(r'href="#(\w+)"', page) == re.findall(r'<section id="(\w+)"', page) == ["one", "two"]
    assert "<h2>One &lt;b&gt;</h2><p>a</p>" in page


def test_a_page_fetches_nothing_and_without_a_plot_runs_nothing():
    page = document("t", "m", LEAD, SECTIONS)
    assert "default-src 'none'" in page.replace("&#x27;", "'")
    assert "script" not in page
    plotted = document("t", "m", LEAD, SECTIONS, plot={"items": []})
    for text in (page, plotted):
        assert not re.search(r"https?:|@import|url\(|<link", text)


def test_the_plots_data_cannot_end_its_script_and_comes_back():
    data = {"name": "</script><script>alert(1)</script> & \u2028"}
    page = document("t", "m", LEAD, SECTIONS, plot=data)
    assert page.count("<script") == 2
    (text,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', page)
    assert json.loads(text) == data


def test_light_dark_and_paper_have_the_same_colours_to_give():
    """A colour that one of them lacks would be drawn in nothing."""
    style = document("t", "m", LEAD, SECTIONS)
    light, dark = (set(re.findall(r"--([a-z]+):", part)) for part in re.findall(r":root[^{]*\{([^}]*)\}", style)[:2])
    assert light == dark
    assert set(re.findall(r"var\(--([a-z]+)\)", style)) - {"share"} <= light


def test_pictures_have_the_light_pages_colours():
    assert LIGHT["paper"] == "#fdfcfa"
    assert LIGHT.keys() >= {"ink", "soft", "line", "measured", "nominal", "patched", "good"}
