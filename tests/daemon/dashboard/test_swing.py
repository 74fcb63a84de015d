"""The panel "Last swing": the replay of an ended goal, also after a reload, from the list and in a saved file."""

import re

import pytest

pytestmark = pytest.mark.slow

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


def test_a_swing_contains_the_ticks_of_its_goal_and_its_closest_moment(page):
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


@pytest.fixture
def ended(page, robot):
    """Return the status of a reached or missed goal that the page shows; it is flown once for several tests."""
    goal = robot.status["goal"]
    if goal["state"] not in ("reached", "failed"):
        robot.arm()
        goal = fly(robot)
    shown(page, goal)
    return goal


def test_the_swing_of_an_ended_goal_is_replayed_in_slow_motion_and_survives_a_reload(page, ended):
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
    page.reload()
    shown(page, ended)
    assert page.locator("#replay .result").inner_text() == result


def test_a_missed_and_a_cancelled_goal_are_explained(page, robot):
    robot.arm()
    missed = fly(robot, 0.25, 0.75)
    shown(page, missed)
    assert "passing through counts" in page.locator("#replay .result").inner_text()
    robot.ask("/api/goal", {"kind": "reach", "y_m": 0.26, "z_m": 0.75})
    robot.client.delete("/api/goal")
    shown(page, robot.until(lambda now: now["goal"]["state"] != "running")["goal"])
    assert "ended before a result" in page.locator("#replay .result").inner_text()


def test_a_goal_of_the_list_is_shown_with_its_closest_distance(page, robot):
    robot.arm()
    first, second = fly(robot, -0.25, 0.6), fly(robot, -0.2, 0.66)
    shown(page, second)
    page.locator("#panel-goals-tab").click()
    row = page.locator("#panel-goals li", has_text="y -0.25, z 0.6 m").first
    if first["state"] == "reached":  # on a busy machine the arm may miss
        row.locator("text=/Closest \\d+\\.\\d cm/").wait_for()
    assert re.search(r"\d+ of \d+ reached \(\d+ %\)", page.locator("#panel-goals .hint").inner_text())
    row.get_by_role("button", name="Show the swing").click()
    shown(page, first)
    page.locator("#swing-title", has_text="Swing of").wait_for()


@pytest.mark.usefixtures("ended")
def test_a_swing_that_is_no_longer_stored_says_so(page):
    page.route("**/api/recent**", lambda route: route.fulfill(json={"tick": [10**9], "time": [0.0]}))
    page.locator("#panel-goals-tab").click()
    page.locator("#panel-goals li:first-child button").click()
    page.locator("#swing-note", has_text="The daemon keeps the last ten minutes").wait_for()


@pytest.mark.usefixtures("ended")
def test_a_saved_swing_moves_without_the_daemon(page, browser, tmp_path):
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


def test_reduced_motion_shows_the_closest_moment_and_moves_nothing(page, ended):
    page.emulate_media(reduced_motion="reduce")
    page.reload()
    shown(page, ended)
    assert page.evaluate("getComputedStyle(document.querySelector('#arm')).transitionProperty") == "none"
    held = page.evaluate(OUTLINE)
    assert held
    page.wait_for_timeout(200)
    assert page.evaluate(OUTLINE) == held
    assert page.locator("#replay .play").inner_text() == "Play"
