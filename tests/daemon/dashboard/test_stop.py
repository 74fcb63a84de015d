"""The stop button: always visible, independent of the API, with a report of what confirmed it."""

import re
import time
from urllib.parse import urlsplit

import pytest

pytestmark = pytest.mark.slow


@pytest.fixture
def armed(page, robot):
    robot.arm()
    page.locator("#mode[data-mode=armed]").wait_for()
    return page


def banner(page) -> str:
    return page.locator("#stopped").inner_text()


def requests(robot, until: str) -> list[str]:
    """Return the kinds of all requests once the recorder's thread has added this one."""
    deadline = time.monotonic() + 30
    while time.monotonic() < deadline:
        events = robot.client.get("/api/events").json()["events"]
        kinds = [one["what"] for one in events if one["kind"] == "request"]
        if kinds[-1] == until:
            return kinds
    raise AssertionError(kinds)


def cut(page, daemon, stop_too: bool = False, hang: bool = False) -> None:
    """Let the API fail, or hang; with stop_too let the dedicated stop port fail as well."""
    page.route(
        lambda url: urlsplit(url).port == daemon.port or (stop_too and urlsplit(url).port == daemon.stop_port),
        lambda route: None if hang else route.abort(),
    )
    if not hang:  # a key press can reach the page before the route does
        page.evaluate("async () => { while (await fetch('api/robot').then(() => true, () => false)); }")


def test_the_button_stops_and_names_the_port_that_confirmed(armed, robot):
    armed.locator("#stop").click()
    armed.locator("#stopped[data-state=stopped]").wait_for()
    assert re.match(
        r"Stopped at [0-9:]{8}: confirmed (via the (dedicated stop port|API) in \d+ ms|by the robot's status)",
        banner(armed),
    )
    assert robot.status["mode"] == "stopped"
    armed.locator("#mode[data-mode=stopped]").wait_for()


@pytest.mark.parametrize("focus", ["body", "#do-disarm", "#drawing", "#target-y", "#panel-events-tab", "#pause"])
def test_space_stops_wherever_the_focus_is_and_presses_no_button(armed, robot, focus):
    if focus != "body":
        armed.locator(focus).focus()
    armed.keyboard.press("Space")
    armed.locator("#stopped[data-state=stopped]").wait_for()
    assert robot.status["mode"] == "stopped"
    assert armed.locator("#pause").get_attribute("aria-pressed") == "false"
    assert armed.locator("#panel-events-tab").get_attribute("aria-selected") == "false"
    assert requests(robot, until="stop")[-1] == "stop"  # no disarm follows


def test_a_space_in_a_text_field_does_not_stop(armed, robot):
    armed.evaluate("document.body.append(Object.assign(document.createElement('textarea'), {id: 'note'}))")
    armed.locator("#note").focus()
    armed.keyboard.type("a b")
    assert armed.locator("#note").input_value() == "a b"
    assert robot.status["mode"] == "armed"


def test_the_button_works_when_the_api_hangs(armed, robot, daemon):
    cut(armed, daemon, hang=True)
    armed.keyboard.press("Space")
    armed.locator("#stopped[data-state=stopped]").wait_for()
    assert robot.status["mode"] == "stopped"


def test_the_button_uses_the_dedicated_port_if_api_and_stream_fail(robot, opened, daemon):
    robot.arm()
    page = opened()
    cut(page, daemon)
    page.locator("#stop").click()
    page.locator("#stopped[data-state=stopped]").wait_for()
    assert robot.status["mode"] == "stopped"


def test_the_button_uses_the_api_if_the_dedicated_port_fails(armed, robot, daemon):
    armed.route(lambda url: urlsplit(url).port == daemon.stop_port, lambda route: route.abort())
    armed.locator("#stop").click()
    armed.locator("#stopped[data-state=stopped]").wait_for()
    assert robot.status["mode"] == "stopped"
    # The text may be of the first press, and a stop on its way would stop the arm in the next test.
    with armed.expect_response(lambda answer: answer.url.endswith("/api/stop") and answer.ok):
        armed.locator("#stop").click()
    armed.locator("#stopped >> text=confirmed via the API").wait_for()


def test_without_any_answer_the_button_reports_not_confirmed_and_retries(armed, robot, daemon):
    cut(armed, daemon, stop_too=True)
    armed.keyboard.press("Space")
    armed.locator("#stopped[data-state=unconfirmed]").wait_for()
    assert "NOT confirmed. Use the emergency-stop button" in banner(armed)
    assert robot.status["mode"] == "armed"
    assert armed.locator("#stop-text").inner_text() == "Not confirmed"
    armed.unroute_all()
    armed.locator("#stopped[data-state=stopped]").wait_for()
    assert robot.status["mode"] == "stopped"


def test_the_button_is_visible_and_uncovered_on_every_screen(opened, robot):
    sizes = ((360, 640), (390, 844), (768, 1024), (1280, 720))
    page = opened(apart=True)
    for size in sizes:
        page.set_viewport_size(dict(zip(("width", "height"), size, strict=True)))
        page.evaluate("scrollTo(0, document.body.scrollHeight)")
        button = page.locator("#stop")
        box = button.bounding_box()
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= size[0]
        assert box["y"] >= 0
        assert box["y"] + box["height"] <= size[1]
        top = page.evaluate(
            "([x, y]) => document.elementFromPoint(x, y).closest('button')?.id",
            [box["x"] + box["width"] / 2, box["y"] + box["height"] / 2],
        )
        assert top == "stop"
