"""The charts of a report in a real browser: pointer, keyboard, and the words for screen readers."""

import re

import numpy as np
import pytest

from softarm.reporting import plot
from softarm.reporting.colours import LIGHT, NIGHT, rgb
from softarm.reporting.document import Section, document
from softarm.reporting.markup import el
from softarm.reporting.plot import Traces

pytestmark = pytest.mark.slow


@pytest.fixture
def page(browser, tmp_path):
    t_s = np.arange(1001) / 100
    curves = {"measured": np.sin(t_s), "nominal": np.sin(t_s) + np.where(t_s < 5, 0.1, 0.3)}
    curves["measured"][300:310] = np.nan
    data = plot.packed(("trial", "channel"), [Traces(("one", "tip y"), "seed", "m", t_s, curves, 0.05)])
    section = Section("Charts", "charts", plot.charts(("trial", "channel"), tuple(curves), "signals"))
    path = tmp_path / "report.html"
    path.write_text(document("t", "m", el("h1", "t"), [section], plot=data), encoding="utf-8")
    errors = []
    with browser.new_context(offline=True, viewport={"width": 1000, "height": 900}) as context:
        page = context.new_page()
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("console", lambda message: errors.append(message.text))
        page.goto(path.as_uri())
        yield page
    assert errors == []


def seen(page):
    """Return the time range and the RMS of the residual from the words under the charts."""
    found = re.search(r"([\d.]+) to ([\d.]+) s: nominal ([\d.]+) m", page.inner_text("#readout"))
    return tuple(map(float, found.groups()))


# A copy is read, since Chromium advises against reading a canvas that it draws with the graphics card.
DRAWN = """(colour) => {
  const canvas = document.querySelector("#traces canvas");
  const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d", { willReadFrequently: true });
  copy.drawImage(canvas, 0, 0);
  const { data } = copy.getImageData(0, 0, canvas.width, canvas.height);
  let count = 0;
  for (let i = 0; i < data.length; i += 4) count += colour.every((part, k) => data[i + k] === part);
  return count > 500;
}"""


def wait_for_curves_in(page, table):
    page.wait_for_function(DRAWN, arg=[round(255 * part) for part in rgb(table["measured"])])


def test_the_charts_obey_keyboard_and_pointer_and_have_the_colours_of_the_scheme_and_of_paper(page):
    assert seen(page) == (0.0, 10.0, pytest.approx(0.225, abs=0.002))
    assert "trial one, channel tip y (seed). RMS of measured minus simulated" in page.get_attribute(
        "#traces", "aria-label"
    )
    page.focus("#traces")
    for _ in range(2):
        page.keyboard.press("+")
    assert seen(page)[:2] == (3.75, 6.25)
    for _ in range(6):
        page.keyboard.press("ArrowLeft")
    assert seen(page) == (0.0, 2.5, 0.1)
    page.keyboard.press("0")
    assert seen(page)[:2] == (0.0, 10.0)

    box = page.locator("#traces .u-over").first.bounding_box()

    def drag(start, end):
        for share, act in ((start, page.mouse.down), (end, page.mouse.up)):
            page.mouse.move(box["x"] + share * box["width"], box["y"] + 50)
            act()

    drag(0.5, 0.75)
    assert seen(page)[:2] == pytest.approx((5.0, 7.5), abs=0.03)
    page.keyboard.down("Shift")
    drag(0.2, 0.6)
    page.keyboard.up("Shift")
    assert seen(page)[:2] == pytest.approx((4.0, 6.5), abs=0.03)
    assert re.search(r"At [\d.]+ s: measured [-\d.]+, nominal [-\d.]+ m", page.inner_text("#readout"))
    page.mouse.dblclick(box["x"] + 100, box["y"] + 50)
    assert seen(page)[:2] == (0.0, 10.0)

    wait_for_curves_in(page, LIGHT)
    page.emulate_media(color_scheme="dark")
    wait_for_curves_in(page, NIGHT)
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    wait_for_curves_in(page, LIGHT)
