"""Markup: every text is escaped."""

import pytest

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
