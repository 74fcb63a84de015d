"""The arm in perspective, which a drag turns; it never sends a target."""

import pytest

pytestmark = pytest.mark.slow

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


def test_the_solid_arm_is_the_outline_revolved(page):
    shape = page.evaluate(SHAPE)
    assert shape["depth"] == pytest.approx(0.03, rel=0.03)
    assert shape["outwards"]
    assert shape["low"] == pytest.approx(shape["lowest"], abs=1e-3)
    assert shape["length"] == pytest.approx(1)


def test_the_picture_has_the_arm_where_the_bodies_are(page):
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


def held(page) -> str:
    """Return the picture once the daemon can no longer change it."""
    page.context.set_offline(True)
    page.locator("#link[data-link=lost]").wait_for()
    return page.evaluate(PICTURE)


def test_a_drag_turns_the_view_and_neither_drag_nor_click_sends_a_target(page, robot):
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
