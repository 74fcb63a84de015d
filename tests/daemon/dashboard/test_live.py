"""Every button works or explains why it is disabled; the page shows live data or states that it is stale."""

import re
import threading
from dataclasses import replace

import pytest

pytestmark = pytest.mark.slow


def can(page, button: str) -> bool:
    return page.locator(f"#do-{button}").get_attribute("aria-disabled") == "false"


def why(page, button: str) -> str:
    """Return the explanation after pressing a disabled button."""
    page.locator(f"#do-{button}").click(force=True)
    return page.locator("#why-not").inner_text()


def in_mode(page, mode: str) -> None:
    page.locator(f"#mode[data-mode={mode}]").wait_for()


def test_the_buttons_arm_and_disarm(page, robot):
    assert page.locator("#reasons .ready").inner_text() == "Ready to arm."
    page.locator("#do-arm").click()
    in_mode(page, "armed")
    assert robot.status["mode"] == "armed"
    assert page.locator("#mode-title").inner_text() == "Armed"
    page.locator("#do-disarm").click()
    page.locator("#mode:is([data-mode=stopping], [data-mode=disarmed])").wait_for()
    assert robot.status["mode"] in ("stopping", "disarmed")


def test_the_button_acknowledges_a_stop(page, robot):
    robot.ask("/api/stop")
    page.locator("#reasons .reason.refusal", has_text="latched").wait_for()
    assert "The emergency stop is latched" in page.locator("#reasons").inner_text()
    assert "POST" not in page.locator("main").inner_text()
    page.locator("#do-acknowledge").click()
    in_mode(page, "disarmed")
    assert robot.status["estop"] == "clear"


def test_the_button_resets_a_drive_in_fault_and_then_acknowledges(page, robot, daemon, monkeypatch):
    """The daemon resets a drive only on request, so the button works while the cause is present."""
    robot.arm()
    rail = daemon.loop._devices.rail
    read, reset = rail.read, threading.Event()
    monkeypatch.setattr(rail, "read", lambda: replace(read(), faults=() if reset.is_set() else ("E11",)))
    monkeypatch.setattr(type(rail), "reset_fault", lambda self: reset.set())
    robot.until(lambda status: status["estop"] == "engaged")
    page.locator("#do-acknowledge[aria-disabled=false]").click()
    page.locator("#said .refused", has_text="a fault reset was sent").wait_for()
    robot.until(lambda status: status["estop"] == "latched")
    page.locator("#do-acknowledge[aria-disabled=false]").click()
    in_mode(page, "disarmed")


def test_the_buttons_hold_and_cancel(page, robot):
    robot.arm()
    in_mode(page, "armed")
    page.locator("#do-hold").click()
    page.wait_for_function("() => document.querySelector('#goal').textContent.includes('hold')")
    assert robot.status["goal"]["goal"]["kind"] == "hold"
    robot.ask("/api/goal", {"kind": "reach", "y_m": 0.55, "z_m": 0.84})  # out of the policy's range
    page.locator("#do-cancel[aria-disabled=false]").dispatch_event("click")
    page.locator("#goal dd", has_text="cancelled,").wait_for()
    assert robot.status["goal"]["state"] == "cancelled"


def test_run_is_offered_for_a_policy_without_target(page, robot):
    assert page.locator("#do-run").is_hidden()
    page.get_by_role("button", name="Use hold").click()
    page.locator("#said >> text=Policy hold in use").wait_for()
    page.locator("#do-run").wait_for()
    robot.arm()
    page.locator("#do-run[aria-disabled=false]").click()
    page.wait_for_function("() => document.querySelector('#goal dd').textContent === 'run'")
    assert robot.status["goal"]["goal"]["kind"] == "run"
    robot.calm()
    assert robot.client.put("/api/policy", json={"name": "reach"}, timeout=60).status_code == 200  # of another client
    page.locator("#panel-policies li", has_text="in use").locator("b", has_text="reach").wait_for()
    page.locator("#do-run").wait_for(state="hidden")


def test_a_disabled_button_explains_why(page, robot):
    page.locator("#do-arm[aria-disabled=false]").wait_for()
    assert not any(can(page, name) for name in ("disarm", "acknowledge", "hold", "cancel"))
    assert why(page, "disarm") == "Disarm: The robot is not armed."
    assert why(page, "acknowledge") == "Acknowledge: No emergency stop is latched."
    assert why(page, "hold") == "Hold: Arm the robot first."
    assert robot.status["mode"] == "disarmed"
    robot.arm()
    in_mode(page, "armed")
    assert why(page, "arm") == "Arm: The robot is already armed."
    assert why(page, "cancel") == "Cancel goal: No goal is running."


def test_reasons_against_arming_are_shown_with_the_next_step(page, robot, daemon, monkeypatch):
    cameras = daemon.loop._devices.mocap
    real = cameras.read
    monkeypatch.setattr(cameras, "read", lambda now_ns: real(now_ns)[:0])  # the cameras are covered
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


DRAWN_TICK = "(tick) => Number(document.querySelector('#drawing svg').dataset.tick) >= tick"


def greyed(page) -> bool:
    return all(
        float(page.locator(place).evaluate("(node) => getComputedStyle(node).opacity")) < 0.5
        for place in ("#arm", "#plots", "#goal")
    )


# Over 3 s: two daemons, one after the other.
def test_a_lost_daemon_is_reported_and_reconnected(tmp_path, browser, opened, started, asking):
    with started(tmp_path) as first:
        port = first.port
        page = opened(url=f"{first.url}/")
        page.locator("#mode[data-mode=disarmed]").wait_for()
        assert not greyed(page)
    page.locator("#link[data-link=lost]").wait_for()
    page.wait_for_function("() => getComputedStyle(document.querySelector('#arm')).opacity < 0.5")
    assert greyed(page)
    assert "Connection lost" in page.locator("#lost").inner_text()
    assert page.locator("#do-arm").get_attribute("aria-disabled") == "true"
    before = age(page)
    page.wait_for_function(
        "(was) => parseFloat(document.querySelector('#lost-age').textContent.match(/[0-9.]+/)[0]) > was + 0.3",
        arg=before,
    )
    with started(tmp_path, port) as second:
        page.locator("#link[data-link=live]").wait_for()
        page.locator("#lost").wait_for(state="hidden")
        asking(second.url).until(lambda status: not status["arming_refusals"])
        page.locator("#reasons .ready").wait_for()


def age(page) -> float:
    return float(re.search(r"is ([0-9.]+) s old", page.locator("#lost-age").inner_text())[1])


def test_a_stalled_control_loop_is_not_shown_as_live(page, robot, daemon, monkeypatch):
    old = replace(daemon.loop.snapshot)
    monkeypatch.setattr(type(daemon.loop), "snapshot", property(lambda _: old, lambda _, value: None), raising=False)
    page.locator("#link[data-link=stalled]").wait_for()
    assert "control loop does not tick" in page.locator("#lost").inner_text()
    page.wait_for_function("() => getComputedStyle(document.querySelector('#arm')).opacity < 0.5")
    assert greyed(page)
    page.wait_for_timeout(1200)  # longer than the allowed silence
    assert page.locator("#link").get_attribute("data-link") == "stalled"
    monkeypatch.undo()
    page.locator("#link[data-link=live]").wait_for()


def test_the_charts_survive_a_reload(page, robot):
    robot.arm()
    robot.until(lambda status: status["uptime_s"] > 4)
    page.reload()
    shown = "() => Number(document.querySelector('#plots').dataset.seconds) > performance.now() / 1000 + 2"
    page.wait_for_function(shown)  # data from before the reload
    assert page.locator("#plots canvas").count() == 6


def test_a_chart_shows_its_newest_value_and_the_one_under_the_pointer(page, robot, press):
    robot.arm()
    number = robot.status["goal"]["number"]
    press(page, -0.25, 0.62)
    ended = robot.until(lambda now: now["goal"]["number"] > number and now["goal"]["state"] != "running")
    page.wait_for_function(DRAWN_TICK, arg=ended["tick"])
    pressure = page.locator(".plot", has_text="Pressure").locator("output")
    page.wait_for_function("() => document.querySelectorAll('.plot output').length === 14")
    page.get_by_role("button", name="10 s", exact=True).click()
    page.locator("#pause").click()
    newest = pressure.all_inner_texts()
    over = page.locator(".plot", has_text="Cart velocity").locator(".u-over")
    over.hover(position={"x": over.bounding_box()["width"] - 6, "y": 40})
    page.locator("#charts-note", has_text=re.compile(r"\d+\.\d s before the pause")).wait_for()
    box = over.bounding_box()
    seen = set()
    for quarters_s in range(1, 40):  # the pressure changed within these seconds
        page.mouse.move(box["x"] + box["width"] * quarters_s / 40, box["y"] + 40)
        page.evaluate("() => new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(drawn)))")
        seen.add(tuple(pressure.all_inner_texts()))
    assert len(seen | {tuple(newest)}) > 2


def test_pause_freezes_the_charts_but_not_the_drawing(page, robot):
    page.locator("#pause").click()
    assert page.locator("#pause").get_attribute("aria-pressed") == "true"
    held = page.locator("#plots").get_attribute("data-seconds")
    tick = page.locator("#drawing svg").get_attribute("data-tick")
    page.wait_for_function(
        "(was) => Number(document.querySelector('#drawing svg').dataset.tick) > Number(was) + 20", arg=tick
    )
    assert page.locator("#plots").get_attribute("data-seconds") == held
    page.locator("#pause").click()
    page.wait_for_function("(was) => document.querySelector('#plots').dataset.seconds !== was", arg=held)


def test_screen_readers_get_each_mode(page, robot):
    robot.arm()
    page.wait_for_function("() => document.querySelector('#spoken').textContent.startsWith('Armed.')")
    robot.ask("/api/stop")
    page.wait_for_function("() => document.querySelector('#spoken').textContent.startsWith('Emergency stop.')")


@pytest.mark.prove
def test_without_a_stream_the_page_polls_the_status(robot, opened):
    """Some proxies block WebSockets."""
    page = opened(look=False, closed_streams=True)
    page.locator("#link[data-link=live]").wait_for()
    robot.arm()
    page.locator("#mode[data-mode=armed]").wait_for()
    page.wait_for_function(
        "(was) => document.querySelector('#drawing svg').dataset.tick > was", arg=robot.status["tick"]
    )
    assert page.locator("#link").get_attribute("data-link") == "live"


def test_a_refused_page_shows_the_reason(opened):
    page = opened()
    refused = {"status": 403, "json": {"detail": "no", "reasons": ["a page of 'x' may not command this robot"]}}
    page.route(re.compile("/api/(ticket|status)"), lambda route: route.fulfill(**refused))
    page.reload()
    page.locator("#lost", has_text="A page of 'x' may not command this robot").wait_for()
