"""Documents: complete, with the common style, without external resources."""

import json
import re
from html import unescape

from softarm.reporting.colours import LIGHT, NIGHT
from softarm.reporting.document import Section, document, framed
from softarm.reporting.markup import el

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
        assert not re.search(r"https?:|@import|url\(|<link", text.replace("/*! https://github.com/leeoniya/uPlot", ""))


def test_a_framed_page_is_escaped_once_and_its_scripts_see_nothing_else():
    page = document("t", "m", el("h1", 'A "quoted" title'), SECTIONS)
    frame = framed(page, "a page", 300)
    assert 'sandbox="allow-scripts"' in frame
    assert "height:300px" in frame
    (inner,) = re.findall(r'srcdoc="([^"]*)"', frame)
    assert unescape(inner) == page.replace("<head>", '<head><base href="about:srcdoc">')


def test_the_plots_data_cannot_end_its_script_and_comes_back():
    data = {"name": "</script><script>alert(1)</script> & \u2028"}
    page = document("t", "m", LEAD, SECTIONS, plot=data)
    assert page.count("<script") == 2
    (text,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', page)
    assert json.loads(text) == data


def test_both_colour_schemes_and_paper_define_the_same_colours():
    """A missing colour would be drawn transparent."""
    assert LIGHT.keys() == NIGHT.keys()
    style = document("t", "m", LEAD, SECTIONS)
    assert set(re.findall(r"var\(--([\w-]+)\)", style)) <= set(re.findall(r"--([\w-]+): ", style)) | {"share"}
