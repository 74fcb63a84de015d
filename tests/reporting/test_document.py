"""Elements, tables, numbers and charts of a page, and the page around them."""

import json
import re
from html import unescape

import numpy as np
import pytest

from softarm.reporting import charts, numbers
from softarm.reporting.colours import LIGHT, NIGHT
from softarm.reporting.document import Section, document, framed
from softarm.reporting.markup import Html, bar, el, join, picture, prose, shaded, table, tiles

NASTY = "</td><script>alert(1)</script> \"quoted\" & 'so'"
ESCAPED = "&lt;/td&gt;&lt;script&gt;alert(1)&lt;/script&gt; &quot;quoted&quot; &amp; &#x27;so&#x27;"


@pytest.mark.parametrize(
    "made",
    [
        el("p", NASTY),
        el("p", title=NASTY),
        join([NASTY]),
        prose(NASTY),
        table((NASTY,), [(NASTY,)], NASTY),
        tiles([(NASTY, NASTY)]),
        bar(0.5, "plain", NASTY),
        shaded(0.5, NASTY),
        picture(b"", NASTY),
    ],
)
def test_texts_are_escaped_once(made):
    assert "<script" not in made
    assert ESCAPED in made


def test_markup_stays_markup_and_an_attribute_of_none_is_left_out():
    inner = el("b", "x")
    assert el("p", inner, " & ", class_="a", stroke_width=2, title=None) == (
        '<p class="a" stroke-width="2"><b>x</b> &amp; </p>'
    )
    assert isinstance(join([inner, "y"]), Html)
    assert el("br") == "<br/>"


def test_a_table_names_its_columns_and_rows_and_can_be_scrolled_by_keyboard():
    made = table(("name", "value"), [("a", "1")], "Values", numbers=(1,))
    assert '<th scope="row">a</th><td class="n">1</td>' in made
    assert '<th class="n" scope="col">value</th>' in made
    assert made.startswith('<div class="wide" tabindex="0" role="region" aria-label="Values">')


@pytest.mark.parametrize(("share", "width"), [(0.25, 25), (-1.0, 0), (7.0, 100), (float("nan"), 0)])
def test_a_bar_is_as_long_as_its_share_and_never_longer_than_its_track(share, width):
    assert f'style="width:{width:.1f}%"' in bar(share, "plain", "")


def test_dotted_names_are_set_as_code_and_files_are_not():
    text = prose("pressure.lag and rail.delay.delay, not verdict.json, e.g. 3 kPa")
    assert text == (
        "<code>pressure.lag</code> and <code>rail.delay.delay</code>, not verdict.json, e.g. 3\N{NO-BREAK SPACE}kPa"
    )


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.0612, "s", "61 ms"),
        (0.25, "s", "0.25 s"),
        (0.1, "-", "0.1"),
        (0.0, "m", "0 m"),
        (1234.5, "N", "1234 N"),
        (3e-7, "N", "3.0e-07 N"),
        (float("inf"), "kPa/s", "none"),
        (float("nan"), "m", "not known"),
    ],
)
def test_numbers_are_written_as_people_read_them(value, unit, text):
    assert numbers.quantity(value, unit) == text


@pytest.mark.parametrize(
    ("share", "text"), [(0.5, "50 %"), (0.001, "under 1 %"), (0.0, "0 %"), (-0.001, "0 %"), (float("nan"), "not known")]
)
def test_a_share_is_a_whole_percentage(share, text):
    assert numbers.percent(share) == text


def test_a_list_is_written_as_an_enumeration():
    assert numbers.listed(["a"]) == "a"
    assert numbers.listed(["a", "b", "c"], "or") == "a, b or c"


def test_a_spectrum_keeps_its_level_when_thinned():
    frequency_hz = np.linspace(0.1, 50, 5000)
    f, density = charts.thinned(frequency_hz, np.full(5000, 0.3))
    assert len(f) < 200
    np.testing.assert_allclose(density, 0.3)


def test_a_spectrum_draws_what_has_values_and_names_it():
    frequency_hz = np.linspace(0.1, 50, 500)
    curves = {"nominal": 1 / frequency_hz, "patched": np.zeros(500)}
    drawn = charts.spectrum(frequency_hz, curves, 0.1, "Residual")
    assert "Residual: nominal<" in drawn
    assert drawn.count('class="curve ') == 1
    assert drawn.count('class="floor"') == 1
    assert charts.spectrum(frequency_hz, {"patched": np.zeros(500)}, 0.1, "Residual") is None


def test_a_flat_spectrum_of_one_frequency_is_drawn_without_nan():
    drawn = charts.spectrum(np.array([2.0]), {"nominal": np.array([0.3])}, float("nan"), "Residual")
    assert "nan" not in drawn
    assert "inf" not in drawn


def test_a_map_puts_places_where_they_are_and_marks_their_share():
    drawn = charts.disc_map([-0.4, 0.0, -0.4, 0.0], [0.55, 0.55, 0.80, 0.80], [1.0, 0.5, 0.25, 0.0], "reach")
    full, half, quarter = re.findall(r'<circle cx="([\d.]+)" cy="([\d.]+)" r="([\d.]+)" class="ink"/>', drawn)
    assert float(full[0]) == float(quarter[0]) < float(half[0])
    assert float(quarter[1]) < float(full[1]) == float(half[1])
    assert float(full[2]) > float(half[2]) > float(quarter[2]) > 0
    assert drawn.count('class="ring"') == 3
    assert drawn.count('class="missed"') == 1
    assert "<b>reach</b> (z over y, m)" in drawn  # its places may have different numbers of flights: no mean
    assert "y 0.00, z 0.55 m: 50 %" in drawn


def test_a_map_has_a_note_for_each_place_and_a_legend_of_its_marks():
    drawn = charts.disc_map([0.0, 0.1], [0.5, 0.6], [1.0, 0.0], "reach", ["12 mm", "<90 mm>"])
    assert "y 0.00, z 0.50 m: 12 mm" in drawn
    assert "&lt;90 mm&gt;" in drawn
    assert re.findall(r"</svg>(\w+)", charts.map_legend("all", "some", "none")) == ["all", "some", "none"]


def test_a_ladder_is_on_one_scale():
    drawn = charts.ladder(2.0, 1.0, 0.5, None)
    assert re.findall(r'<rect x="0" y="\d+" width="([\d.]+)"', drawn) == ["240.0", "120.0"]
    assert 'x1="60.0"' in drawn
    assert "50 %" in drawn


def test_lanes_draw_each_signal_over_the_whole_time():
    t_s = np.linspace(0.0, 4.0, 9)
    drawn = charts.lanes(t_s, {"pressure (kPa)": 18 * t_s / 4, "cart (m/s)": -0.5 * t_s / 4}, "Commands")
    for piece in ("pressure (kPa)", "cart (m/s)", ">18<", ">-0.5<", ">4 s<"):
        assert piece in drawn
    assert drawn.count("<path") == 2


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


@pytest.mark.slow
def test_a_long_path_makes_no_page_wider_than_a_phone(browser):
    page = browser.new_page(viewport={"width": 360, "height": 740})
    path = f"/data/{60 * 'long'}"
    page.set_content(document("t", "m", el("h1", path), [Section("One", "one", el("ul", el("li", path)))]))
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
