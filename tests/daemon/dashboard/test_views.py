"""Drawing of the arm, which moves to clicked targets, its picture in perspective, the charts, and the last swing."""

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


def test_a_target_is_sent_by_a_click_or_two_numbers_and_its_result_shown(page, robot, press):
    page.locator("#drawing svg").hover(position={"x": 220, "y": 150})
    aim = page.locator("#drawing .preview")
    assert aim.get_attribute("visibility") == "visible"
    assert re.fullmatch(r"y −?0\.\d{3}  z 0\.\d{3} m", aim.locator("text").text_content())
    page.locator("#drawing svg").hover(position={"x": 20, "y": 200})
    assert aim.get_attribute("data-state") == "out"
    page.mouse.move(1200, 700)
    assert aim.get_attribute("visibility") == "hidden"

    robot.arm()
    press(page, -0.2, 0.65)
    page.locator("#said .notice.done").wait_for()
    goal = robot.status["goal"]["goal"]
    assert (goal["y_m"], goal["z_m"]) == pytest.approx((-0.2, 0.65), abs=0.003)
    assert re.search(r"Target y −0\.\d+, z 0\.6\d+ m: accepted", result(page))
    page.locator("#drawing .goal:not([data-state=running])").wait_for()
    assert page.locator("#drawing .goal").get_attribute("data-state") == robot.status["goal"]["state"]
    assert page.locator("#drawing .trail.t5").get_attribute("d").count("L") >= 5  # the last positions of the tip

    press(page, *REFUSED)
    page.locator("#said .notice.refused").wait_for()
    y_m, z_m = (float(page.locator(f"#target-{name}").input_value()) for name in "yz")
    answer = robot.ask("/api/goal", {"kind": "reach", "y_m": y_m, "z_m": z_m})
    assert answer.status_code == 422
    shown = page.locator("#said li").all_inner_texts()
    assert [one.lower() for one in shown] == [one.lower() for one in answer.json()["reasons"]]

    press(page, 0.3, 0.6)
    page.locator("#said .notice.warned").wait_for()
    assert "outside the training range of the policy 'reach'" in result(page)

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


def test_charts_share_window_zoom_and_cursor_and_stand_beside_the_drawing(page, robot):
    bodies = {}

    def keep(frame: str) -> None:
        status = json.loads(frame)
        bodies[str(status["tick"])] = status["bodies"]

    page.locator(".plot .u-over").nth(5).wait_for()
    page.wait_for_function("() => Number(document.querySelector('#plots').dataset.seconds) > 4")
    page.get_by_role("button", name="3 s", exact=True).click()
    assert page.locator("#charts-title").inner_text() == "Last 3 s"
    assert seconds(page) <= 3
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

    page.locator(".plot .u-over").nth(1).hover(position={"x": 60, "y": 30})
    cursors = "() => [...document.querySelectorAll('.plot .u-cursor-x')].map((line) => line.style.transform)"
    page.wait_for_function(f"() => new Set(({cursors})()).size === 1 && !({cursors})()[0].includes('-10px')")
    assert len(page.evaluate(cursors)) == 6

    page.locator("#pause").click()  # a paused chart loads older ticks, too
    long = page.get_by_role("button", name="10 min")
    with page.expect_request("**/api/recent?seconds=600"):
        long.click()
    assert long.get_attribute("aria-pressed") == "true"
    page.wait_for_function("() => Number(document.querySelector('#plots').dataset.seconds) > 3.1")
    page.locator("#pause").click()

    check_places(page, **page.viewport_size)
    page.set_viewport_size({"width": 1920, "height": 1080})
    page.wait_for_function(f"() => Math.max(...({PLACES})()[2].map((card) => card.right)) > 1880")
    check_places(page, 1920, 1080)

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

    held = []
    page.route("**/api/recent?seconds=60", lambda route: held.append(route))  # an answer that comes too late
    page.reload()
    page.locator("#drawing svg[data-tick]").wait_for()
    with page.expect_response("**/api/recent?seconds=600"):
        page.get_by_role("button", name="10 min").click()
    page.wait_for_function("() => Number(document.querySelector('#plots').dataset.seconds) > 4")
    with page.expect_response("**/api/recent?seconds=60"):
        held[0].fulfill(json={"tick": [1], "time": [1]})
    page.wait_for_timeout(300)
    assert seconds(page) > 4


def check_places(page, width: int, height: int) -> None:
    # In one evaluation, since a swing that arrives changes the layout.
    arm, charts, cards = page.evaluate(PLACES)
    assert charts["left"] >= arm["right"]
    assert charts["top"] == arm["top"]
    assert charts["bottom"] <= height
    assert max(card["right"] for card in cards) > width - 40  # no unused column


# An arm that hangs bent, drawn by the page's own modules; the picture's colours at the tip and at the middle of a link.
DRAWN = """
async () => {
  const { Arm } = await import("/dashboard/view/arm.js");
  const robot = await (await fetch("/api/robot")).json();
  const place = Object.assign(document.createElement("div"), { className: "drawing" });
  place.style.width = "400px";
  document.body.append(place);
  const arm = new Arm(place, robot);
  const z = robot.hinge_z_m;
  const bodies = [[0.05, z], [0.05, z], [0.04, z - 0.1], [0.02, z - 0.2], [-0.02, z - 0.3], [-0.08, z - 0.38]];
  const button = arm.solidButton();
  button.click(); // before the first status
  arm.draw({ tick: 1, bodies, goal: null });
  const { solid } = arm;
  const { data } = solid.ink.getImageData(0, 0, solid.canvas.width, solid.canvas.height);
  const colour = (point) => {
    const [column, row] = solid.place(point).map((px) => Math.round(px * solid.canvas.width / arm.plane.width));
    const from = 4 * (row * solid.canvas.width + column);
    return [...data.slice(from, from + 3)];
  };
  const hidden = arm.drawn.hasAttribute("hidden");
  const tip = colour([0, -0.08, z - 0.38]);
  const link = colour([0, 0.045, z - 0.05]);
  const beside = colour([0, 0.25, z - 0.155]);
  solid.look({ turn: 0, tilt: 0 });
  const flat = [solid.place([0, 0.1, 0.8]), [arm.plane.h(0.1), arm.plane.v(0.8), arm.plane.scale]];
  const sizes = [0.2, -0.2].map((x) => solid.place([x, 0, 0.8])[2] / arm.plane.scale);
  button.click();
  const shown = !arm.drawn.hasAttribute("hidden") && arm.solid === null;
  place.remove();
  return { hidden, tip, link, beside, flat, sizes, shown, pressed: button.getAttribute("aria-pressed") };
}
"""
SHAPE = """
async () => {
  const { revolved, rotate } = await import("/dashboard/view/solid.js");
  const outline = armOutline([[0, 1], [0.02, 0.9], [0.1, 0.8]], [0.03, 0.02], 6);
  const faces = revolved(outline);
  const corners = faces.flatMap((face) => face.corners);
  const depth = Math.max(...corners.map(([x]) => x));
  const outwards = faces.every(({ centre: [x], normal }) => Math.abs(x) < 1e-9 || x * normal[0] >= 0);
  const low = Math.min(...corners.map(([, , z]) => z)), lowest = Math.min(...outline.map(([, z]) => z));
  const turned = rotate({ turn: 0.7, tilt: 0.4 }, [0.1, -0.2, 0.3]);
  return { depth, outwards, low, lowest, length: Math.hypot(...turned) / Math.hypot(0.1, -0.2, 0.3) };
}
"""
PICTURE = "document.querySelector('#drawing canvas').toDataURL()"


def held(page) -> str:
    """Return the picture once the daemon can no longer change it."""
    page.context.set_offline(True)
    page.locator("#link[data-link=lost]").wait_for()
    return page.evaluate(PICTURE)


def test_the_solid_arm_is_turned_by_a_drag_and_neither_drag_nor_click_sends_a_target(page, robot):
    shape = page.evaluate(SHAPE)  # the outline revolved
    assert shape["depth"] == pytest.approx(0.03, rel=0.03)
    assert shape["outwards"]
    assert shape["low"] == pytest.approx(shape["lowest"], abs=1e-3)
    assert shape["length"] == pytest.approx(1)

    page.emulate_media(color_scheme="light")
    drawn = page.evaluate(DRAWN)
    assert drawn["hidden"]
    assert drawn["tip"] == [0x35, 0x33, 0x2F]  # --measured
    arm = (0xEF, 0xE6, 0xCF)  # --arm
    assert all(0.55 * full < value <= full for value, full in zip(drawn["link"], arm, strict=True))
    assert drawn["beside"] == [0, 0, 0]  # nothing is drawn
    seen, from_the_side = drawn["flat"]
    assert seen == pytest.approx(from_the_side, rel=1e-6)
    assert drawn["sizes"][0] > 1 > drawn["sizes"][1]  # what is nearer looks larger
    assert drawn["shown"]
    assert drawn["pressed"] == "false"

    posted = []
    page.on("request", lambda request: posted.append(request.url) if request.method == "POST" else None)
    page.locator("#drawing-row button").click()
    canvas = page.locator("#drawing canvas")
    canvas.wait_for()
    assert "Drag to turn" in page.locator("#drawing-help").inner_text()
    box = canvas.bounding_box()
    before = held(page)
    page.mouse.move(box["x"] + 150, box["y"] + 100)
    page.mouse.down()
    page.mouse.move(box["x"] + 60, box["y"] + 140, steps=4)
    page.mouse.up()
    turned = page.evaluate(PICTURE)
    assert turned != before
    canvas.click(position={"x": 200, "y": 120})
    assert page.evaluate(PICTURE) == turned
    canvas.dblclick(position={"x": 200, "y": 120})
    assert page.evaluate(PICTURE) == before
    assert [url for url in posted if not url.endswith("/api/ticket")] == []  # a stream that was lost asks for a ticket
    page.locator("#drawing-row button").click()
    page.locator("#drawing svg").wait_for()
    assert canvas.count() == 0


OUTCOMES = {"reached": "✓ Reached", "failed": "✕ Missed", "cancelled": "– Cancelled"}
OUTLINE = "document.querySelector('#replay .links').getAttribute('points')"
MOVES = f"(was) => {OUTLINE} !== was"
SOURCE = "/dashboard/swing/cut.js"
# A cart at rest; the tip moves at 1 m/s past a target at y = 0.02 m, 1 cm away from it between two ticks.
CUT = f"""
async () => {{
  const {{ cutSwing, bodyColumns }} = await import("{SOURCE}");
  const rows = Array.from({{ length: 200 }}, (_, k) => k);
  const bodies = rows.map((k) => [[0, 1], [0.1, 0.9], null, [k / 30 - 3, 0.7], [0, 0.6], [k / 30 - 3, 0.61]]);
  const names = ["cart_m", "action_velocity_m_s", "sent_velocity_m_s", "cart_velocity_m_s",
    "action_pressure_kpa", "sent_pressure_kpa", "pressure_kpa"];
  const recent = {{
    tick: rows.map((k) => 1000 + k), time: rows.map((k) => 5000 + k / 30), bodies,
    tip_y_m: rows.map((k) => k / 30 - 3), tip_z_m: rows.map(() => 0.61),
    ...Object.fromEntries(names.map((name) => [name, rows.map(() => 0)])),
  }};
  const at = (tick, more) => ({{ tick, time: new Date(1e6 * 5 + (tick - 1000) / 0.03).toISOString(), ...more }});
  const goal = {{ goal: {{ kind: "reach", y_m: 0.02, z_m: 0.6 }}, request: at(1060, {{ who: "x" }}), next: null,
    end: at(1088, {{ what: "reached", text: "goal 1 reached" }}) }};
  const robot = {{ success_radius_m: 0.04 }};
  const reached = cutSwing(goal, recent, robot);
  const missed = cutSwing({{ ...goal, end: {{ ...goal.end, what: "failed" }} }}, recent, robot);
  const replaced = cutSwing({{ ...goal, next: 1091 }}, recent, robot);
  const far = cutSwing({{ ...goal, goal: {{ ...goal.goal, z_m: 0.7 }} }}, recent, robot);
  const older = cutSwing({{ ...goal, request: at(999) }}, recent, robot);
  const between = bodyColumns(reached).map((one) => spotBetween(reached.t, one, 1 / 60));
  return {{ reached, missed, replaced, older, far, between }};
}}
"""


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


def fly(robot, y_m: float = -0.2, z_m: float = 0.65) -> dict:
    """Fly to a target and return the status of the ended goal."""
    before = robot.status["goal"]["number"]
    robot.ask("/api/goal", {"kind": "reach", "y_m": y_m, "z_m": z_m})
    return robot.until(lambda now: now["goal"]["number"] > before and now["goal"]["state"] != "running")["goal"]


def shown(page, goal: dict) -> None:
    """Wait until the panel shows this goal and its result."""
    target = f"Reach y {goal['goal']['y_m']:g}, z {goal['goal']['z_m']:g} m"
    page.locator("#swing-note", has_text=target).wait_for()
    assert page.locator("#replay .result b").inner_text() == OUTCOMES[goal["state"]]


# Over 3 s: two flights and their replay in slow motion.
def test_an_ended_goal_is_replayed_saved_and_shown_after_a_reload(page, robot, browser, tmp_path):
    robot.arm()
    first, ended = fly(robot, -0.25, 0.6), fly(robot)
    shown(page, ended)
    result = page.locator("#replay .result").inner_text()
    assert "within 4 cm" in result
    assert page.locator("#replay polygon.ghost").get_attribute("points")
    near = re.search(r"Closest: (\d+\.\d) cm", result)[1]
    assert page.locator("#replay text.ghost").text_content() == f"closest {near} cm"
    page.locator("#replay .transport").scroll_into_view_if_needed()
    page.wait_for_function(MOVES, arg=page.evaluate(OUTLINE))
    # By keyboard: a click misses a button that moves while the page around it still changes.
    page.get_by_role("button", name="Pause", exact=True).and_(page.locator(".play")).press("Enter")
    page.get_by_role("button", name="Play", exact=True).and_(page.locator(".play")).wait_for()
    held = page.evaluate(OUTLINE)
    page.wait_for_timeout(200)
    assert page.evaluate(OUTLINE) == held
    slider = page.locator("#replay input[type=range]")
    slider.focus()
    page.keyboard.press("ArrowRight")
    stepped = page.locator("#replay .clock").inner_text()
    page.keyboard.press("End")  # a single step may not move an arm at rest by a tenth of a pixel
    assert page.evaluate(OUTLINE) != held
    assert page.locator("#replay .clock").inner_text() != stepped
    assert slider.get_attribute("aria-valuetext") == page.locator("#replay .clock").inner_text()
    options = page.locator("#replay option").all_inner_texts()
    assert [option.removesuffix(" ×") for option in options] == ["1", "1/2", "1/4", "1/10"]
    titles = page.locator(".curve b").all_inner_texts()
    assert titles == ["Distance of the tip to the target", "Tip", "Cart position", "Cart velocity", "Pressure"]
    assert page.locator(".curve canvas").count() == 5

    with page.expect_download() as download:
        page.get_by_role("button", name="Save this swing").click()
    assert re.fullmatch(r"softarm-swing-\d{8}T\d{6}\.html", download.value.suggested_filename)
    file = tmp_path / "swing.html"
    download.value.save_as(file)
    said, asked = [], []
    context = browser.new_context(offline=True)
    saved = context.new_page()
    saved.on("console", lambda message: said.append(message.text))
    saved.on("pageerror", lambda error: said.append(str(error)))
    saved.on("request", lambda request: asked.append(request.url))
    saved.goto(file.as_uri())
    saved.wait_for_function(MOVES, arg=saved.evaluate(OUTLINE))
    assert saved.locator("#replay .result").inner_text() == page.locator("#replay .result").inner_text()
    assert saved.locator(".curve canvas").count() == 5
    context.close()
    assert said == []
    assert [url for url in asked if not url.startswith(("file:", "data:"))] == []

    page.emulate_media(reduced_motion="reduce")
    page.reload()
    shown(page, ended)
    assert page.locator("#replay .result").inner_text() == result
    assert page.evaluate("getComputedStyle(document.querySelector('#arm')).transitionProperty") == "none"
    held = page.evaluate(OUTLINE)
    assert held
    page.wait_for_timeout(200)
    assert page.evaluate(OUTLINE) == held
    assert page.locator("#replay .play").inner_text() == "Play"

    page.locator("#panel-goals-tab").click()
    row = page.locator("#panel-goals li", has_text="y -0.25, z 0.6 m").first
    if first["state"] == "reached":  # on a busy machine the arm may miss
        row.locator("text=/Closest \\d+\\.\\d cm/").wait_for()
    assert re.search(r"\d+ of \d+ reached \(\d+ %\)", page.locator("#panel-goals .hint").inner_text())
    busy = {"status": 503, "json": {"reasons": ["the daemon is busy"]}}
    page.route("**/api/recent**", lambda route: route.fulfill(**busy), times=1)
    row.get_by_role("button", name="Show the swing").click()
    page.locator("#swing-note", has_text="The daemon is busy").wait_for()
    shown(page, first)  # a refused request is repeated
    page.locator("#swing-title", has_text="Swing of").wait_for()
    page.route("**/api/recent**", lambda route: route.fulfill(json={"tick": [10**9], "time": [0.0]}))
    page.locator("#panel-goals li:first-child button").click()
    page.locator("#swing-note", has_text="The daemon keeps the last ten minutes").wait_for()


# Over 3 s: a missed goal lasts that long.
def test_a_missed_and_a_cancelled_goal_are_explained_and_marked_in_the_charts(page, robot):
    cut = page.evaluate(CUT)
    swing = cut["reached"]
    assert swing["ended"] == pytest.approx(28 / 30, abs=1e-3)
    assert (swing["from"], swing["to"]) == (pytest.approx(-0.1), pytest.approx(28 / 30 + 0.5, abs=1e-3))
    assert swing["charts"][0] == pytest.approx(swing["to"] - 3)
    assert len(swing["t"]) == len(swing["bodies"]) == len(swing["curves"]["tip_y_m"]) == 90 + 1
    assert swing["closest"] == {"at": pytest.approx(1.02, abs=0.005), "m": pytest.approx(0.01, abs=1e-3)}
    assert cut["far"]["closest"] is None  # a reached target whose frame is between two late ticks
    assert cut["missed"]["closest"]["m"] == pytest.approx(0.087, abs=2e-3)  # what follows its end does not count
    assert cut["replaced"]["to"] == pytest.approx(31 / 30, abs=1e-3)
    assert cut["older"] is None
    seen = [body for body in cut["between"] if body]
    assert cut["between"][2] is None
    assert [y for y, _ in seen] == pytest.approx([0, 0.1, -59 / 60, 0, -59 / 60], abs=1e-3)

    robot.arm()
    page.get_by_role("button", name="10 s", exact=True).click()
    page.locator("#plots canvas").nth(5).wait_for()
    page.wait_for_function(f"() => ({INK})('stop-text') === 0")
    missed = fly(robot, 0.25, 0.75)
    shown(page, missed)
    assert "passing through counts" in page.locator("#replay .result").inner_text()
    page.wait_for_function(f"() => ({INK})('stop-text') > 20")
    assert page.evaluate(INK, "accent") > 10
    assert page.locator(".marks li").all_inner_texts() == ["▸goal began", "✓reached", "✕missed", "–cancelled"]
    robot.ask("/api/goal", {"kind": "reach", "y_m": 0.26, "z_m": 0.75})
    robot.client.delete("/api/goal")
    shown(page, robot.until(lambda now: now["goal"]["state"] != "running")["goal"])
    assert "ended before a result" in page.locator("#replay .result").inner_text()
