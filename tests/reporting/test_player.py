"""The log player in a real browser: it shows the flight, and every control works."""

import re
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from softarm.daemon.logbook import logs
from softarm.recordings import player
from softarm.schemas.robot import RAIL_TRAVEL_M
from tests.processes import until

FLIGHT = Path(__file__).parents[1] / "data" / "flight.mcap"
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def ticks():
    """(seconds since the first tick, inputs, outputs)."""
    found = [(inputs, outputs) for inputs, outputs, _ in logs.read(FLIGHT)]
    return [((inputs.t_ns - found[0][0].t_ns) * 1e-9, inputs, outputs) for inputs, outputs in found]


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    log = logs.read(FLIGHT)
    path = tmp_path_factory.mktemp("page") / "flight.html"
    path.write_text(player.page(log, log.entries()))
    return path


@pytest.fixture(scope="module")
def opened(browser, file):
    """Opens the page without a network, the desktop's once; it has to ask for nothing and complain of nothing."""
    asked, said, pages = [], [], {}

    def open_(at="", **options):
        key = repr(options)
        if key not in pages:
            context = browser.new_context(offline=True, **{"viewport": {"width": 1280, "height": 900}} | options)
            pages[key] = page = context.new_page()
            page.on("request", lambda request: asked.append(request.url))
            page.on("console", lambda message: said.append(message.text))
            page.on("pageerror", lambda error: said.append(str(error)))
            page.goto(file.as_uri() + at)
        elif at:
            pages[key].evaluate(f"history.replaceState(null, '', '#'), location.hash = '{at}'")
            settled(pages[key])
        return pages[key]

    yield open_
    assert {url.partition("#")[0] for url in asked} == {file.as_uri()}
    assert said == []


def seconds(page):
    minutes, rest = re.match(r"(\d+):([\d.]+)", page.inner_text("#clock")).groups()
    return 60 * int(minutes) + float(rest)


def settled(page):
    """After what was asked for has been drawn."""
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    return seconds(page)


def test_the_player_begins_at_arming_and_a_link_leads_to_a_moment(opened):
    assert seconds(opened()) == pytest.approx(1.0, abs=0.01)
    page = opened("#t=3.9")
    assert seconds(page) == pytest.approx(3.9, abs=0.01)
    assert page.inner_text("#now").startswith("armed")
    assert "goal 3: y -0.42, z 0.68 m, running" in page.inner_text("#now")
    page = opened("#t=0.6.3", viewport={"width": 800, "height": 600})
    assert seconds(page) == pytest.approx(0.6, abs=0.01)
    assert not [text for text in page.locator("#charts output").all_inner_texts() if re.fullmatch(r"−[0.]+", text)]


def rgb(page, colour):
    text = page.evaluate("(name) => getComputedStyle(document.documentElement).getPropertyValue(name)", colour).strip()
    return np.array([int(text[k : k + 2], 16) for k in (1, 3, 5)]) / 255


def inked(picture, colour):
    """How many pixels of each column have a colour."""
    return (np.abs(picture[..., :3] - colour).sum(axis=2) < 0.05).sum(axis=0)


@pytest.mark.parametrize("at_s", [1.2, 3.9, 6.0])
def test_the_cart_is_drawn_at_its_measured_position(opened, ticks, at_s):
    """Found in the picture's pixels, with the rail's ends as the ruler."""
    page = opened(f"#t={at_s}")
    settled(page)
    picture = imread(BytesIO(page.locator("#scene").screenshot()))
    rail = inked(picture.swapaxes(0, 1), rgb(page, "--soft")).argmax()
    ink = np.flatnonzero(inked(picture[: rail - 3], rgb(page, "--ink")))
    first, cart, last = np.split(ink, np.flatnonzero(np.diff(ink) > 1) + 1)
    left, right = first.mean(), last.mean()
    assert right - left > 200
    middle_m = ((cart[0] + cart[-1]) / 2 - (left + right) / 2) / (right - left) * 2 * RAIL_TRAVEL_M
    seen = [inputs.mocap[-1].bodies[0].y_m for t, inputs, _ in ticks if t <= at_s + 1e-6][-1]
    assert middle_m == pytest.approx(seen, abs=0.003)


def test_the_arm_moves_between_two_ticks(opened, ticks):
    page = opened()
    flown = next(t for t, _, outputs in ticks if outputs.goal.state == "running") + 0.3
    before = max(t for t, _, _ in ticks if t <= flown)
    drawn = set()
    for after_s in (0.005, 0.015, 0.025):
        page.evaluate(f"location.hash = 't={before + after_s:.4f}'")
        settled(page)
        picture = imread(BytesIO(page.locator("#scene").screenshot()))
        drawn.add(tuple(inked(picture, rgb(page, "--arm"))))
    assert len(drawn) == 3


def test_the_player_states_the_tips_error_at_every_moment(opened, ticks):
    page = opened()
    for t, inputs, outputs in ticks[130:200:23]:
        page.evaluate(f"location.hash = 't={t + 0.001:.3f}'")
        assert settled(page) == pytest.approx(t, abs=0.01)
        tip, goal = inputs.mocap[-1].bodies[-1], outputs.goal.goal
        off_cm = 100 * ((tip.y_m - goal.y_m) ** 2 + (tip.z_m - goal.z_m) ** 2) ** 0.5
        said = float(re.search(r"tip ([\d.]+) cm off", page.inner_text("#now"))[1])
        assert said == pytest.approx(off_cm, abs=0.06)


def test_the_player_works_by_keyboard_alone(opened, ticks):
    page = opened("#t=3")
    page.keyboard.press("ArrowRight")
    assert settled(page) == pytest.approx(3.033, abs=0.006)
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("ArrowLeft")
    assert settled(page) == pytest.approx(2.967, abs=0.006)
    page.keyboard.press("Shift+ArrowRight")
    assert settled(page) == pytest.approx(3.967, abs=0.006)
    page.keyboard.press("n")
    assert settled(page) == pytest.approx(4.1, abs=0.01)
    assert page.inner_text("#events [aria-current]").endswith("goal 3 reached after 0.6 s")
    page.keyboard.press("p")
    assert settled(page) == pytest.approx(3.533, abs=0.01)
    page.keyboard.press("End")
    assert settled(page) == pytest.approx(ticks[-1][0], abs=0.006)
    page.keyboard.press("Home")
    assert settled(page) == 0
    page.keyboard.press("Space")
    until(lambda: float(page.input_value("#time")) > 0.3)
    page.keyboard.press("Space")
    assert page.get_attribute("[data-do=play]", "aria-pressed") == "false"


def test_the_player_has_the_chosen_speed_and_stops_at_the_end(opened, ticks):
    page = opened()
    page.select_option("#speed", "20")
    page.click("[data-do=play]")
    until(lambda: page.get_attribute("[data-do=play]", "aria-pressed") == "false")
    assert seconds(page) == pytest.approx(ticks[-1][0], abs=0.006)
    page.select_option("#speed", "0.5")
    took_ms = page.evaluate(
        """async () => {
          const frame = () => new Promise(requestAnimationFrame);
          const time = document.getElementById("time"), began = performance.now();
          document.querySelector("[data-do=play]").click();
          while (time.value > 5 || time.value < 0.4) await frame();
          return performance.now() - began;
        }"""
    )
    page.click("[data-do=play]")
    assert took_ms > 750


def test_events_slider_and_charts_lead_to_their_moments(opened):
    page = opened()
    page.click("#events button:has-text('goal 1 reached')")
    assert settled(page) == pytest.approx(1.533, abs=0.01)
    page.fill("#time", "5.5")
    assert settled(page) == pytest.approx(5.5, abs=0.01)
    box = page.locator("#charts").bounding_box()
    page.mouse.move(box["x"] + box["width"] * 0.5, box["y"] + 100)
    page.mouse.down()
    middle_s = settled(page)
    page.mouse.move(box["x"] + box["width"] * 0.75, box["y"] + 100)
    page.mouse.up()
    assert 4.8 < middle_s < 6.0
    assert 7.2 < settled(page) < 8.6
    page.select_option("#window", "5")
    assert 7.2 < settled(page) < 8.6


def test_the_page_fits_a_phone_in_both_colour_schemes(opened):
    page = opened("#t=4", viewport={"width": 360, "height": 740}, has_touch=True, is_mobile=True)
    for button in page.locator("[data-do]").all():
        box = button.bounding_box()
        assert min(box["width"], box["height"]) >= 36
        assert box["x"] + box["width"] <= 360
    page.tap("[data-do=on]")
    assert settled(page) == pytest.approx(4.033, abs=0.04)
    for colours in ("light", "dark"):
        page.emulate_media(color_scheme=colours)
        paper = page.evaluate("getComputedStyle(document.body).backgroundColor")
        assert (sum(map(int, re.findall(r"\d+", paper))) < 200) == (colours == "dark")
        assert page.evaluate("document.documentElement.scrollWidth") <= 360
