"""Every control works by mouse, finger and keyboard, and is readable; the page shows live data or says why not."""

import re
import threading
from dataclasses import replace

import pytest

pytestmark = pytest.mark.slow


def why(page, button: str) -> str:
    """Return the explanation after pressing a disabled button."""
    page.locator(f"#do-{button}").click(force=True)
    return page.locator("#why-not").inner_text()


def in_mode(page, mode: str) -> None:
    page.locator(f"#mode[data-mode={mode}]").wait_for()


def spoken(page, words: str) -> None:
    """Wait until screen readers get a text that starts with these words."""
    page.wait_for_function("(words) => document.querySelector('#spoken').textContent.startsWith(words)", arg=words)


DRAWN_TICK = "(tick) => Number(document.querySelector('#drawing svg').dataset.tick) >= tick"


# Over 3 s: a flight, and four seconds of data.
def test_the_charts_show_values_pause_and_survive_a_reload(page, robot, press):
    page.locator("#pause").click()
    assert page.locator("#pause").get_attribute("aria-pressed") == "true"
    held = page.locator("#plots").get_attribute("data-seconds")
    tick = page.locator("#drawing svg").get_attribute("data-tick")
    page.wait_for_function(DRAWN_TICK, arg=int(tick) + 21)
    assert page.locator("#plots").get_attribute("data-seconds") == held
    page.locator("#pause").click()
    page.wait_for_function("(was) => document.querySelector('#plots').dataset.seconds !== was", arg=held)

    robot.arm()
    number = robot.status["goal"]["number"]
    press(page, -0.25, 0.62)
    ended = robot.until(lambda now: now["goal"]["number"] > number and now["goal"]["state"] != "running")
    page.wait_for_function(DRAWN_TICK, arg=ended["tick"])
    pressure = page.locator(".plot", has_text="Pressure").locator("output")
    page.wait_for_function("() => document.querySelectorAll('.plot output').length === 14")
    page.get_by_role("button", name="10 s", exact=True).click()
    page.locator("#pause").click()
    over = page.locator(".plot", has_text="Cart velocity").locator(".u-over")
    over.hover(position={"x": over.bounding_box()["width"] - 6, "y": 40})
    page.locator("#charts-note", has_text=re.compile(r"\d+\.\d s before the pause")).wait_for()
    box = over.bounding_box()
    seen = {tuple(pressure.all_inner_texts())}
    for eighths_s in range(1, 80):  # the pressure changed within these seconds
        page.mouse.move(box["x"] + box["width"] * (1 - eighths_s / 80), box["y"] + 40)
        page.evaluate("() => new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(drawn)))")
        seen.add(tuple(pressure.all_inner_texts()))
        if len(seen) > 2:
            break
    assert len(seen) > 2

    robot.until(lambda status: status["uptime_s"] > 4)
    page.reload()
    shown = "() => Number(document.querySelector('#plots').dataset.seconds) > performance.now() / 1000 + 2"
    page.wait_for_function(shown)  # data from before the reload
    assert page.locator("#plots canvas").count() == 6


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


def test_every_button_works_or_explains_why_it_is_disabled_and_text_has_contrast_in_both_schemes(page, robot, flown):
    page.locator("#do-arm[aria-disabled=false]").wait_for()
    assert page.locator("#reasons .ready").inner_text() == "Ready to arm."
    for button in ("disarm", "acknowledge", "hold", "cancel"):
        assert page.locator(f"#do-{button}").get_attribute("aria-disabled") == "true"
    assert why(page, "disarm") == "Disarm: The robot is not armed."
    assert why(page, "acknowledge") == "Acknowledge: No emergency stop is latched, and no device reports a fault."
    assert why(page, "hold") == "Hold: Arm the robot first."
    assert robot.status["mode"] == "disarmed"
    page.locator("#do-arm").click()
    in_mode(page, "armed")
    assert robot.status["mode"] == "armed"
    assert page.locator("#mode-title").inner_text() == "Armed"
    spoken(page, "Armed.")
    assert why(page, "arm") == "Arm: The robot is already armed."
    assert why(page, "cancel") == "Cancel goal: No goal is running."
    page.locator("#do-hold").click()
    page.wait_for_function("() => document.querySelector('#goal').textContent.includes('hold')")
    assert robot.status["goal"]["goal"]["kind"] == "hold"
    robot.ask("/api/goal", {"kind": "reach", "y_m": 0.55, "z_m": 0.84})  # out of the policy's range
    page.locator("#do-cancel[aria-disabled=false]").dispatch_event("click")
    page.locator("#goal dd", has_text="cancelled,").wait_for()
    assert robot.status["goal"]["state"] == "cancelled"
    page.locator("#do-disarm").click()
    page.locator("#mode:is([data-mode=stopping], [data-mode=disarmed])").wait_for()
    assert robot.status["mode"] in ("stopping", "disarmed")
    robot.ask("/api/stop")
    page.locator("#reasons .reason.refusal", has_text="latched").wait_for()
    assert "The emergency stop is latched" in page.locator("#reasons").inner_text()
    assert "POST" not in page.locator("main").inner_text()
    spoken(page, "Emergency stop.")
    page.locator("#do-acknowledge").click()
    in_mode(page, "disarmed")
    assert robot.status["estop"] == "clear"

    flown(page)
    robot.ask("/api/stop")
    page.locator("#reasons .reason").first.wait_for()
    page.locator("#panel-events-tab").click()
    page.locator("#panel-events li").first.wait_for()
    colours = "() => [...document.querySelectorAll('.plot output')].map((value) => getComputedStyle(value).color)"
    page.wait_for_function("() => document.querySelectorAll('#plots canvas').length === 6")
    shown = {}
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        paper = page.evaluate("getComputedStyle(document.body).backgroundColor.match(/[0-9.]+/g).map(Number)")
        assert (sum(paper) < 150) == (scheme == "dark")
        assert [(text, round(ratio, 1)) for text, ratio in page.evaluate(CONTRAST, READ) if ratio < 4.5] == []
        page.wait_for_function("() => document.querySelectorAll('#plots canvas').length === 6")
        shown[scheme] = page.evaluate(colours)
    assert set(shown["dark"]).isdisjoint(shown["light"])


def test_a_fault_is_shown_with_the_next_step_and_reset_by_a_button(page, robot, daemon, monkeypatch):
    cameras, rail = daemon.loop._devices.mocap, daemon.loop._devices.rail
    with monkeypatch.context() as covered:
        real = cameras.read
        covered.setattr(cameras, "read", lambda now_ns: real(now_ns)[:0])
        page.locator("#reasons .reason").first.wait_for()
        page.wait_for_function("() => document.querySelector('#reasons').textContent.includes('Cannot be armed')")
        refused = robot.ask("/api/arm")
        assert refused.status_code == 409
        shown = page.locator("#reasons").inner_text().lower()
        for reason in refused.json()["reasons"]:
            wrong = re.split(r"[(:]", reason)[0].strip().lower()
            assert wrong in shown
        assert "next: " in shown
        page.locator("#do-arm").click()
        page.locator("#said .notice.refused li").first.wait_for()
        assert robot.status["mode"] == "disarmed"
        assert page.locator("#drawing .links").get_attribute("points")  # the last pose stays

    robot.until(lambda status: status["arming_refusals"] == [])
    robot.arm()
    read, reset = rail.read, threading.Event()
    monkeypatch.setattr(rail, "read", lambda: replace(read(), faults=() if reset.is_set() else ("E11",)))
    monkeypatch.setattr(type(rail), "reset_fault", lambda self: reset.set())
    robot.until(lambda status: status["estop"] == "engaged")
    # The daemon resets a drive only on request, so the button works while the cause is present.
    page.locator("#do-acknowledge[aria-disabled=false]").click()
    page.locator("#said .refused", has_text="a fault reset was sent").wait_for()
    robot.until(lambda status: status["estop"] == "latched")
    page.locator("#do-acknowledge[aria-disabled=false]").click()
    in_mode(page, "disarmed")
    reset.clear()  # a fault of a disarmed robot latches no stop
    page.locator("#do-acknowledge[aria-disabled=false]").click()
    robot.until(lambda status: reset.is_set() and status["arming_refusals"] == [])


def test_a_failed_control_loop_keeps_the_charts_and_an_armed_robot_has_notices(page, robot):
    status = robot.status
    ticks = """async (status) => {
        const { History } = await import("/dashboard/link/history.js");
        const history = new History();
        for (const tick of [1000, -1]) history.add({ ...status, tick });
        return history.columns.tick;
    }"""
    assert page.evaluate(ticks, status) == [1000]
    heading = """async (status) => {
        const { ModeView } = await import("/dashboard/view/mode.js");
        new ModeView().draw(status);
        return document.querySelector("#reasons h3").textContent;
    }"""
    events = [{"name": "not_recorded", "response": "warn", "text": "the flight is not recorded: free the disk"}]
    refusing = status | {"events": events, "arming_refusals": ["the flight is not recorded: free the disk"]}
    assert page.evaluate(heading, refusing | {"mode": "disarmed"}) == "Cannot be armed"
    for mode in ("armed", "stopping"):
        assert page.evaluate(heading, refusing | {"mode": mode}) == "Notices"


def test_a_fault_of_a_device_is_listed_once_with_its_next_step(page, robot):
    rail = "127.0.0.1:502: connect: Connection refused; switch on the gateway"
    refusal = f"the axis has not answered (none since the start; {rail}): check the drive's address"
    mocap = "tcp/127.0.0.1:7447 softarm/mocap: read: no frame yet; start the bridge"
    status = robot.status | {"mode": "disarmed", "events": [], "arming_refusals": [refusal]}
    drawn = """async (status) => {
        const { ModeView } = await import("/dashboard/view/mode.js");
        new ModeView().draw(status);
        return [...document.querySelectorAll("#reasons li")].map((reason) => reason.innerText.trim().split("\\n"));
    }"""
    assert page.evaluate(drawn, status | {"problems": {"mocap": mocap, "regulator": None, "rail": rail}}) == [
        [f"The axis has not answered (none since the start; {rail})", "Next: check the drive's address"],
        ["Device mocap: tcp/127.0.0.1:7447 softarm/mocap: read: no frame yet", "Next: start the bridge"],
    ]


def greyed(page) -> bool:
    return all(
        float(page.locator(place).evaluate("(node) => getComputedStyle(node).opacity")) < 0.5
        for place in ("#arm", "#plots", "#goal")
    )


def age(page) -> float:
    return float(re.search(r"is ([0-9.]+) s old", page.locator("#lost-age").inner_text())[1])


# Over 3 s: two daemons, one after the other.
def test_without_live_data_the_page_says_why_and_reconnects(tmp_path, opened, started, monkeypatch):
    fades = "() => getComputedStyle(document.querySelector('#arm')).opacity < 0.5"
    with started(tmp_path) as first:
        port = first.port
        page = opened(url=f"{first.url}/")
        page.locator("#mode[data-mode=disarmed]").wait_for()
        assert not greyed(page)
        with monkeypatch.context() as stall:
            old = replace(first.loop.snapshot)
            stall.setattr(type(first.loop), "snapshot", property(lambda _: old, lambda _, value: None), raising=False)
            page.locator("#link[data-link=stalled]").wait_for()
            assert "control loop does not tick" in page.locator("#lost").inner_text()
            page.wait_for_function(fades)
            assert greyed(page)
            page.wait_for_timeout(1200)  # longer than the allowed silence
            assert page.locator("#link").get_attribute("data-link") == "stalled"
            assert page.title() == "Control loop stalled · softarm"
        page.locator("#link[data-link=live]").wait_for()
    page.locator("#link[data-link=lost]").wait_for()
    page.wait_for_function(fades)
    assert greyed(page)
    assert "Connection lost" in page.locator("#lost").inner_text()
    assert page.locator("#do-arm").get_attribute("aria-disabled") == "true"
    before = age(page)
    page.wait_for_function(
        "(was) => parseFloat(document.querySelector('#lost-age').textContent.match(/[0-9.]+/)[0]) > was + 0.3",
        arg=before,
    )
    with started(tmp_path, port):
        page.locator("#link[data-link=live]").wait_for()
        page.locator("#lost").wait_for(state="hidden")
        page.locator("#reasons .ready").wait_for()
        refused = {"status": 403, "json": {"detail": "no", "reasons": ["a page of 'x' may not command this robot"]}}
        page.route(re.compile("/api/(ticket|status)"), lambda route: route.fulfill(**refused))
        page.reload()
        page.locator("#lost", has_text="A page of 'x' may not command this robot").wait_for()


@pytest.mark.prove
def test_without_a_stream_the_page_polls_the_status(robot, opened):
    """Some proxies block WebSockets."""
    page = opened()
    page.route_web_socket("**/api/stream**", lambda socket: socket.close())
    page.reload()
    page.locator("#link[data-link=live]").wait_for()
    robot.arm()
    page.locator("#mode[data-mode=armed]").wait_for()
    page.wait_for_function(
        "(was) => document.querySelector('#drawing svg').dataset.tick > was", arg=robot.status["tick"]
    )
    assert page.locator("#link").get_attribute("data-link") == "live"


PHONE = {"viewport": {"width": 360, "height": 740}, "has_touch": True, "is_mobile": True}
TABS = ("policies", "goals", "events", "logs", "incidents", "reports")


def test_on_a_phone_the_page_fits_takes_taps_and_shows_the_stop(robot, opened, press, flown):
    page = opened(**PHONE)
    robot.arm()
    press(page, -0.2, 0.65, tap=True)
    page.locator("#said .notice.done").wait_for()
    goal = robot.status["goal"]["goal"]
    assert (goal["y_m"], goal["z_m"]) == pytest.approx((-0.2, 0.65), abs=0.005)
    flown(page)
    for name in TABS:
        page.locator(f"#panel-{name}-tab").click()
        page.locator(f"#panel-{name} :is(li, .hint)").first.wait_for()
        assert page.evaluate("document.documentElement.scrollWidth") <= 360
    page.route("**/api/goal", lambda route: route.fulfill(status=409, json={"reasons": [60 * "long"]}))
    page.locator("#do-reach").tap()
    page.locator("#said", has_text="longlong").wait_for()
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


def test_the_keyboard_reaches_every_control_and_operates_the_arm(page, robot):
    page.locator("#panel-policies li").first.wait_for()
    nameless = page.evaluate(
        """() => [...document.querySelectorAll("button, a, input, [role=tabpanel], [role=application]")]
          .filter((node) => !(node.textContent.trim() || node.labels?.length))
          .filter((node) => !(node.getAttribute("aria-label") || node.getAttribute("aria-labelledby")))
          .map((node) => node.outerHTML)"""
    )
    assert nameless == []
    page.evaluate("document.activeElement.blur()")
    page.evaluate(
        """() => {
          window.reached = [];
          document.addEventListener("focusin", ({ target }) => {
            const style = getComputedStyle(target);
            window.reached.push([target.id, style.outlineStyle !== "none" && parseFloat(style.outlineWidth) >= 2]);
          });
        }"""
    )
    for _ in range(40):
        page.keyboard.press("Tab")
    reached = [(name, outlined) for name, outlined in page.evaluate("reached") if name]
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
    assert list(dict(reached)) == [*wanted, "panel-policies-tab", "panel-policies", "pause"]
    assert all(outlined for _, outlined in reached)

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
