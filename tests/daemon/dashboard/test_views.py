"""Drawing of the arm, which moves to clicked targets, and the charts beside it."""

import json
import re

import pytest

pytestmark = pytest.mark.slow


REFUSED = (0.55, 0.52)  # in the drawing, and beyond the arm's reach

DRAWN_POINTS = """() => {
  const [left, right] = [...document.querySelectorAll("#drawing .hard-limit")].map((end) => end.getBBox());
  const scale = (right.x - left.x - left.width) / 0.6, middle = (right.x + left.x + left.width) / 2;
  const rail = left.y + left.height / 2;
  const drawn = document.querySelectorAll("#drawing :is(.joint[visibility=visible], .tip)");
  const points = [...drawn].map((point) => {
    const [x, y] = ["cx", "cy"].map((name) => Number(point.getAttribute(name)));
    return [(x - middle) / scale, 0.965 - (y - rail) / scale];
  });
  return [document.querySelector("#drawing svg").dataset.tick, points];
}"""


def result(page) -> str:
    return page.locator("#said").inner_text()


def test_the_drawing_shows_the_bodies_where_the_status_has_them(page):
    bodies = {}

    def keep(frame: str) -> None:
        status = json.loads(frame)
        bodies[str(status["tick"])] = status["bodies"]

    page.on("websocket", lambda socket: socket.on("framereceived", keep))
    page.reload()
    page.locator("#drawing svg[data-tick]").wait_for()
    tick, drawn = None, ()
    while tick not in bodies:  # the browser may report a frame of the stream after the page has drawn it, or never
        page.wait_for_timeout(10)
        tick, drawn = page.evaluate(DRAWN_POINTS)
    for (y, z), body in zip(drawn, bodies[tick][1:], strict=True):
        assert (y, z) == pytest.approx(body, abs=0.001)
    counts = {part: page.locator(f"#drawing .{part}").count() for part in ("trained", "within-reach", "soft-limit")}
    assert counts == {"trained": 1, "within-reach": 1, "soft-limit": 2}


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


def test_the_charts_mark_where_goals_began_and_ended(page, robot):
    robot.arm()
    page.get_by_role("button", name="10 s", exact=True).click()
    page.locator("#plots canvas").nth(5).wait_for()
    page.wait_for_function(f"() => ({INK})('stop-text') === 0")  # marks of earlier tests have left the window
    number = robot.status["goal"]["number"]
    robot.ask("/api/goal", {"kind": "reach", "y_m": 0.25, "z_m": 0.75})
    robot.until(lambda now: now["goal"]["number"] > number and now["goal"]["state"] == "failed")
    page.wait_for_function(f"() => ({INK})('stop-text') > 20")
    assert page.evaluate(INK, "accent") > 10
    assert page.locator(".marks li").all_inner_texts() == ["▸goal began", "✓reached", "✕missed", "–cancelled"]


def test_a_click_sends_a_target_and_shows_the_result(page, robot, press):
    robot.arm()
    press(page, -0.2, 0.65)
    page.locator("#said .notice.done").wait_for()
    goal = robot.status["goal"]["goal"]
    assert (goal["y_m"], goal["z_m"]) == pytest.approx((-0.2, 0.65), abs=0.003)
    assert re.search(r"Target y −0\.\d+, z 0\.6\d+ m: accepted", result(page))
    page.locator("#drawing .goal:not([data-state=running])").wait_for()
    assert page.locator("#drawing .goal").get_attribute("data-state") == robot.status["goal"]["state"]
    assert page.locator("#drawing .trail.t5").get_attribute("d").count("L") >= 5  # the last positions of the tip


def test_a_target_out_of_reach_is_refused_with_the_daemons_reason(page, robot, press):
    robot.arm()
    press(page, *REFUSED)
    page.locator("#said .notice.refused").wait_for()
    y_m, z_m = (float(page.locator(f"#target-{name}").input_value()) for name in "yz")
    answer = robot.ask("/api/goal", {"kind": "reach", "y_m": y_m, "z_m": z_m})
    assert answer.status_code == 422
    shown = page.locator("#said li").all_inner_texts()
    assert [one.lower() for one in shown] == [one.lower() for one in answer.json()["reasons"]]


def test_a_doubtful_target_is_accepted_with_a_warning(page, robot, press):
    robot.arm()
    press(page, 0.3, 0.6)
    page.locator("#said .notice.warned").wait_for()
    assert "outside the training range of the policy 'reach'" in result(page)


def test_the_point_under_the_pointer_is_shown_before_the_click(page):
    page.locator("#drawing svg").hover(position={"x": 220, "y": 150})
    aim = page.locator("#drawing .preview")
    assert aim.get_attribute("visibility") == "visible"
    assert re.fullmatch(r"y −?0\.\d{3}  z 0\.\d{3} m", aim.locator("text").text_content())
    page.locator("#drawing svg").hover(position={"x": 20, "y": 200})
    assert aim.get_attribute("data-state") == "out"
    page.mouse.move(1200, 700)
    assert aim.get_attribute("visibility") == "hidden"


def test_a_finger_taps_a_target(robot, opened, press):
    robot.arm()
    page = opened(has_touch=True, viewport={"width": 390, "height": 780})
    press(page, -0.2, 0.65, tap=True)
    page.locator("#said .notice.done").wait_for()
    goal = robot.status["goal"]["goal"]
    assert (goal["y_m"], goal["z_m"]) == pytest.approx((-0.2, 0.65), abs=0.005)


def test_two_numbers_send_a_target(page, robot):
    robot.arm()
    page.locator("#target-y").fill("-0.31")
    page.locator("#target-z").fill("0.6")
    assert page.locator("#drawing .preview text").text_content() == "y −0.310  z 0.600 m"
    page.locator("#do-reach[aria-disabled=false]").click()
    page.locator("#said .notice.done").wait_for()
    assert robot.status["goal"]["goal"] == {"kind": "reach", "y_m": -0.31, "z_m": 0.6}
    page.locator("#target-y").fill("")
    page.locator("#do-reach").click()
    page.locator("#said .notice.refused").wait_for()
    assert "must be numbers" in result(page)


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


def test_the_charts_stand_beside_the_arm_without_scrolling(page, robot):
    page.locator("#plots canvas").nth(5).wait_for()
    usual = page.viewport_size
    check_places(page, **usual)
    page.set_viewport_size({"width": 1920, "height": 1080})
    page.wait_for_function(f"() => Math.max(...({PLACES})()[2].map((card) => card.right)) > 1880")
    check_places(page, 1920, 1080)
    page.set_viewport_size(usual)


def check_places(page, width: int, height: int) -> None:
    # In one evaluation, since a swing that arrives changes the layout.
    arm, charts, cards = page.evaluate(PLACES)
    assert charts["left"] >= arm["right"]
    assert charts["top"] == arm["top"]
    assert charts["bottom"] <= height
    assert max(card["right"] for card in cards) > width - 40  # no unused column
