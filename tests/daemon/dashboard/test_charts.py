"""The charts: windows, zoom, one cursor, marks of goals, and a layout that shows them beside the arm."""

import pytest

pytestmark = pytest.mark.slow

INK = """(colour) => {
  const canvas = document.querySelector("#plots canvas");
  const probe = Object.assign(document.createElement("i"), { style: `color: var(--${colour})` });
  document.body.append(probe);
  const wanted = getComputedStyle(probe).color.match(/[0-9]+/g).map(Number);
  probe.remove();
  const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d", { willReadFrequently: true });
  copy.drawImage(canvas, 0, 0);
  const { data } = copy.getImageData(0, 0, canvas.width, canvas.height);
  let count = 0;
  for (let k = 0; k < data.length; k += 4) if (wanted.every((v, c) => Math.abs(data[k + c] - v) < 12)) count++;
  return count;
}"""

PLACES = """() => {
  const box = (node) => node.getBoundingClientRect().toJSON();
  const cards = [...document.querySelectorAll("main .card")].map(box);
  return [box(document.querySelector("#arm")), box(document.querySelector("#charts")), cards];
}"""


def seconds(page) -> float:
    return float(page.locator("#plots").get_attribute("data-seconds"))


def test_a_window_is_chosen(page, robot):
    page.wait_for_function("() => Number(document.querySelector('#plots').dataset.seconds) > 4")
    page.get_by_role("button", name="3 s", exact=True).click()
    assert page.locator("#charts-title").inner_text() == "Last 3 s"
    assert seconds(page) <= 3
    long = page.get_by_role("button", name="10 min")
    with page.expect_request("**/api/recent?seconds=600"):
        long.click()
    assert long.get_attribute("aria-pressed") == "true"
    page.wait_for_function("() => Number(document.querySelector('#plots').dataset.seconds) > 3.1")


def test_dragging_zooms_all_charts_and_a_double_click_resets(page, robot):
    page.locator(".plot .u-over").nth(5).wait_for()
    page.wait_for_function("() => Number(document.querySelector('#plots').dataset.seconds) > 3")
    page.get_by_role("button", name="3 s", exact=True).click()
    over = page.locator(".plot .u-over").nth(2)
    box = over.bounding_box()
    for x in (0.5, 0.75):
        page.mouse.move(box["x"] + x * box["width"], box["y"] + 40)
        page.mouse.down() if x == 0.5 else page.mouse.up()
    page.locator("#charts-note", has_text="Zoomed").wait_for()
    held = seconds(page)
    over.hover(position={"x": 2, "y": 30})
    assert "1.5 s before the zoom" in page.locator("#charts-note").inner_text()
    page.wait_for_timeout(300)
    assert seconds(page) == held
    over.dblclick(position={"x": 5, "y": 30})
    page.wait_for_function("() => !document.querySelector('#charts-note').textContent.includes('Zoomed')")


def test_one_cursor_is_shown_in_all_charts(page, robot):
    page.locator(".plot .u-over").nth(5).wait_for()
    page.locator(".plot .u-over").nth(1).hover(position={"x": 60, "y": 30})
    places = "() => [...document.querySelectorAll('.plot .u-cursor-x')].map((line) => line.style.transform)"
    page.wait_for_function(f"() => new Set(({places})()).size === 1 && !({places})()[0].includes('-10px')")
    assert len(page.evaluate(places)) == 6


def test_the_charts_mark_where_goals_began_and_ended(page, robot):
    robot.arm()
    page.get_by_role("button", name="10 s", exact=True).click()
    before = page.evaluate(INK, "stop-text")
    number = robot.status["goal"]["number"]
    robot.ask("/api/goal", {"kind": "reach", "y_m": 0.25, "z_m": 0.75})
    robot.until(lambda now: now["goal"]["number"] > number and now["goal"]["state"] == "failed")
    page.wait_for_function(f"(was) => ({INK})('stop-text') > was + 20", arg=before)
    assert page.evaluate(INK, "accent") > 10
    assert page.locator(".marks li").all_inner_texts() == ["▸goal began", "✓reached", "✕missed", "–cancelled"]


@pytest.mark.parametrize("size", [(1280, 860), (1920, 1080)])
def test_the_charts_stand_beside_the_arm_without_scrolling(opened, robot, size):
    width, height = size
    page = opened(viewport={"width": width, "height": height})
    page.locator("#plots canvas").nth(5).wait_for()
    # In one evaluation, since a swing that arrives changes the layout.
    arm, charts, cards = page.evaluate(PLACES)
    assert charts["left"] >= arm["right"]
    assert charts["top"] == arm["top"]
    assert charts["bottom"] <= height
    assert max(card["right"] for card in cards) > width - 40  # no unused column
