"""The page shows live data or reports that it is stale; the charts survive a reload."""

import re
from dataclasses import replace

import pytest

pytestmark = pytest.mark.slow

ENDED = re.compile("reached|missed|cancelled")  # on a busy machine the arm may miss


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
        assert page.locator("#lost").is_hidden()
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
    press(page, -0.25, 0.62)
    page.locator("#goal dd", has_text=ENDED).wait_for()
    pressure = page.locator(".plot", has_text="Pressure").locator("output")
    page.wait_for_function("() => document.querySelectorAll('.plot output').length === 14")
    page.locator("#pause").click()
    newest = pressure.all_inner_texts()
    over = page.locator(".plot", has_text="Cart velocity").locator(".u-over")
    over.hover(position={"x": over.bounding_box()["width"] - 6, "y": 40})
    page.locator("#charts-note", has_text=re.compile(r"\d+\.\d s before the pause")).wait_for()
    box = over.bounding_box()
    seen = set()
    for back in range(2, 12):  # the pressure changed within the last seconds
        page.mouse.move(box["x"] + box["width"] - back, box["y"] + 40)
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


def test_a_policy_chosen_by_another_client_is_shown(page, robot):
    assert page.locator("#panel-policies li", has_text="in use").locator("b").inner_text() == "reach"
    assert robot.client.put("/api/policy", json={"name": "hold"}, timeout=60).status_code == 200
    page.locator("#panel-policies li", has_text="in use").locator("b", has_text="hold").wait_for()
    assert robot.client.put("/api/policy", json={"name": "reach"}, timeout=60).status_code == 200
