"""Small screens, keyboard use and both colour schemes: everything is visible, reachable and readable."""

import pytest

pytestmark = pytest.mark.slow

PHONE = {"viewport": {"width": 360, "height": 740}, "has_touch": True, "is_mobile": True}
TABS = ("policies", "goals", "events", "logs", "incidents", "reports")
# Contrast of a text with what it stands on, as WCAG 2 defines it.
CONTRAST = """(place) => {
  const parts = (text) => text.match(/[0-9.]+/g).map(Number);
  const linear = (v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
  const light = ([r, g, b]) => 0.2126 * linear(r / 255) + 0.7152 * linear(g / 255) + 0.0722 * linear(b / 255);
  const under = (node) => {
    for (let at = node; at; at = at.parentElement) {
      const colour = parts(getComputedStyle(at).backgroundColor);
      if (colour.length === 3 || colour[3] === 1) return colour;
    }
    return [255, 255, 255];
  };
  const shown = (node) => node.checkVisibility() && node.textContent.trim();
  return [...document.querySelectorAll(place)].filter(shown).map((node) => {
    const style = getComputedStyle(node);
    const ink = node instanceof SVGElement ? style.fill : style.color;
    const [a, b] = [light(parts(ink)), light(under(node))].sort((x, y) => y - x);
    return [node.textContent.trim().slice(0, 30), (a + 0.05) / (b + 0.05)];
  });
}"""
READ = (
    "h2, h3, p, dt, dd, li b, li span, .mode span, .chip span, figcaption b, button:not([aria-disabled=true]), "
    "#drawing text, .banner"
)


@pytest.fixture
def flown(robot, press):
    """Return flown(page), which puts a target, a refusal and a warning on the page."""

    def fly(page):
        robot.arm()
        press(page, 0.3, 0.6)
        page.locator("#said .notice.warned").wait_for()
        return page

    return fly


def test_on_a_phone_the_page_fits_and_the_stop_is_visible(robot, opened, flown):
    page = flown(opened(**PHONE))
    for name in TABS:
        page.locator(f"#panel-{name}-tab").click()
        page.locator(f"#panel-{name} :is(li, .hint)").first.wait_for()
        assert page.evaluate("document.documentElement.scrollWidth") <= 360
    robot.ask("/api/stop")
    page.locator("#mode[data-mode=stopped]").wait_for()
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
    page.evaluate("scrollTo(0, 0)")
    box = page.locator("#stop").bounding_box()
    assert box["height"] >= 60
    assert box["y"] + box["height"] <= 740
    small = page.evaluate(
        """() => [...document.querySelectorAll("button, a.button, input")].filter((node) => node.checkVisibility())
          .filter((node) => node.getBoundingClientRect().height < 30).map((node) => node.textContent)"""
    )
    assert small == []  # large enough for a finger


def test_all_text_has_enough_contrast_in_both_schemes(page, flown, robot):
    flown(page)
    robot.ask("/api/stop")
    page.locator("#reasons .reason").first.wait_for()
    page.locator("#panel-events-tab").click()
    page.locator("#panel-events li").first.wait_for()
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        paper = page.evaluate("getComputedStyle(document.body).backgroundColor.match(/[0-9.]+/g).map(Number)")
        assert (sum(paper) < 150) == (scheme == "dark")
        assert [(text, round(ratio, 1)) for text, ratio in page.evaluate(CONTRAST, READ) if ratio < 4.5] == []


def test_the_charts_follow_the_colour_scheme(page):
    colours = "() => [...document.querySelectorAll('.plot output')].map((value) => getComputedStyle(value).color)"
    page.wait_for_function("() => document.querySelectorAll('#plots canvas').length === 6")
    light = page.evaluate(colours)
    page.emulate_media(color_scheme="dark")
    page.wait_for_function("() => document.querySelectorAll('#plots canvas').length === 6")
    assert set(page.evaluate(colours)).isdisjoint(light)


@pytest.mark.prove
def test_a_browser_without_a_locale_draws_the_charts(opened, robot):
    """WebKit with LANG=C has no locale for the chart library's formatter."""
    page = opened()
    page.add_init_script("Object.defineProperty(Navigator.prototype, 'language', {get: () => 'C'})")
    page.reload()
    page.wait_for_function("() => document.querySelectorAll('#plots canvas').length === 6")
    page.locator("#link[data-link=live]").wait_for()


@pytest.mark.prove
def test_without_the_chart_library_the_rest_of_the_page_works(opened, robot):
    page = opened()
    page.route("**/uPlot.iife.min.js", lambda route: route.abort())
    page.reload()
    page.locator("#link[data-link=live]").wait_for()
    page.locator("#drawing svg").wait_for()
    page.locator("#charts-note", has_text="Reload the page").wait_for()
    page.locator("#do-arm").click()
    robot.until(lambda status: status["mode"] == "armed")


def test_the_keyboard_reaches_every_control_in_order(page, robot):
    page.locator("#panel-policies li").first.wait_for()
    page.evaluate("document.activeElement.blur()")
    reached, unseen = [], []
    for _ in range(40):
        page.keyboard.press("Tab")
        name, outlined = page.evaluate(
            """() => {
              const style = getComputedStyle(document.activeElement);
              return [document.activeElement.id, style.outlineStyle !== "none" && parseFloat(style.outlineWidth) >= 2];
            }"""
        )
        if name in reached:
            break
        if name:
            reached.append(name)
            if not outlined:
                unseen.append(name)
    wanted = [
        "stop",
        "drawing",
        "do-arm",
        "do-disarm",
        "do-acknowledge",
        "do-hold",
        "do-cancel",
        "target-y",
        "target-z",
        "do-reach",
    ]
    assert reached == [*wanted, "panel-policies-tab", "panel-policies", "pause"]
    assert unseen == []


def test_the_arm_is_operated_by_keyboard(page, robot):
    page.locator("#do-arm").focus()
    page.keyboard.press("Enter")
    page.locator("#mode[data-mode=armed]").wait_for()
    page.locator("#target-y").fill("-0.20")
    page.locator("#target-z").fill("0.65")
    page.locator("#drawing").focus()
    for key in ("ArrowLeft", "ArrowLeft", "ArrowDown", "Shift+ArrowLeft"):
        page.keyboard.press(key)
    assert page.locator("#drawing .preview text").text_content() == "y −0.270  z 0.640 m"
    page.keyboard.press("Enter")
    page.locator("#said .notice", has_text="Target y −0.270, z 0.640 m: accepted").wait_for()
    assert not page.locator("#drawing .preview").is_visible()
    assert robot.status["goal"]["goal"] == pytest.approx({"kind": "reach", "y_m": -0.27, "z_m": 0.64})


def test_every_control_has_a_name(page):
    page.locator("#panel-policies li").first.wait_for()
    nameless = page.evaluate(
        """() => [...document.querySelectorAll("button, a, input, [role=tabpanel], [role=application]")]
          .filter((node) => !(node.textContent.trim() || node.labels?.length))
          .filter((node) => !(node.getAttribute("aria-label") || node.getAttribute("aria-labelledby")))
          .map((node) => node.outerHTML)"""
    )
    assert nameless == []
